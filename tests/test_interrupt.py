"""Interruptions: processes of a pool end with their parent's work."""

import os
import signal
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import pytest

from nte.files import write_whole
from nte.interrupt import InterruptFlag, stop_when_told, stoppable, stopping_workers, terminable
from nte.jobs import Kind, in_processes


def write_slowly(path: Path) -> None:
    """Write half a file, say so, and go on for a minute."""

    def write(temporary: Path) -> None:
        temporary.write_text("half")
        (path.parent / "begun").touch()
        time.sleep(60)

    write_whole(path, write)


def test_the_first_ctrl_c_sets_the_flag_and_the_second_one_interrupts() -> None:
    before = signal.getsignal(signal.SIGINT)
    with InterruptFlag() as interrupted:
        assert not interrupted()
        signal.raise_signal(signal.SIGINT)
        assert interrupted()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_may_enter_the_block_and_changes_nothing() -> None:
    """As of `nte.train` in a thread of a program with windows."""

    def look() -> tuple[object, bool]:
        with InterruptFlag() as interrupted:
            return signal.getsignal(signal.SIGINT), interrupted()

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(look).result() == (signal.getsignal(signal.SIGINT), False)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_of_which_a_library_makes_another_error_stays_one(number: signal.Signals) -> None:
    """OmegaConf has `finally` blocks that fail, and in which an interruption is lost."""
    outside = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    before = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]

    def library() -> None:
        try:
            signal.raise_signal(number)
        except BaseException:
            raise AttributeError from None

    with pytest.raises(KeyboardInterrupt), terminable():
        library()
    with pytest.raises(AttributeError), terminable():
        raise AttributeError
    assert [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)] == before
    signal.signal(signal.SIGINT, outside)


@pytest.mark.slow
def test_workers_stop_at_once_and_leave_nothing_half_written(tmp_path: Path) -> None:
    start = time.monotonic()
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=stop_when_told)

    def interrupted() -> None:
        with pool, stopping_workers():
            pool.submit(stoppable, partial(write_slowly, tmp_path / "a.txt"))
            while not (tmp_path / "begun").exists():
                assert time.monotonic() - start < 50
                time.sleep(0.05)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert time.monotonic() - start < 50
    assert [path.name for path in tmp_path.iterdir()] == ["begun"]


def write_or_be_done(path: Path) -> None:
    if path.name != "first":
        write_slowly(path)


@pytest.mark.slow
def test_workers_do_not_go_on_with_what_waits(tmp_path: Path) -> None:
    """A pool hands out more units than it has processes: those must not begin when the work is interrupted."""
    start = time.monotonic()

    def done(name: str, _: None) -> None:
        while not (tmp_path / "begun").exists():
            assert time.monotonic() - start < 50
            time.sleep(0.05)
        raise KeyboardInterrupt

    units = {name: tmp_path / name for name in ("first", "second", "third", "fourth", "fifth")}
    with pytest.raises(KeyboardInterrupt):
        in_processes(Kind("write", share_nothing, dict), write_or_be_done, units, 1, done)
    assert time.monotonic() - start < 50
    assert [path.name for path in tmp_path.iterdir()] == ["begun"]


def write_and_say_who(path: Path) -> None:
    (path.parent / "worker").write_text(str(os.getpid()))
    write_slowly(path)


def work_of_a_parent(folder: Path) -> None:
    units = {name: folder / name for name in ("first", "second")}
    in_processes(Kind("write", share_nothing, dict), write_and_say_who, units, 1, lambda name, result: None)


@pytest.mark.slow
def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    """Nobody could tell them to, and each would wait for its next unit forever."""
    parent = get_context("spawn").Process(target=work_of_a_parent, args=(tmp_path,))
    parent.start()
    end = time.monotonic() + 50
    while not (tmp_path / "begun").exists():
        assert time.monotonic() < end
        time.sleep(0.05)
    parent.kill()
    worker = int((tmp_path / "worker").read_text())
    while is_alive(worker):
        assert time.monotonic() < end
        time.sleep(0.05)
    parent.join()


def is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return "State:\tZ" not in Path(f"/proc/{process}/status").read_text()  # nobody may have asked how it ended


def share_nothing(jobs: int) -> None:
    """Do nothing."""
