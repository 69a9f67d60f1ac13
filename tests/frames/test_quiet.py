"""A library is silenced, and nobody else."""

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from nte.frames.quiet import quiet


def test_only_the_thread_that_reads_is_silenced(capfd: pytest.CaptureFixture[str]) -> None:
    # A training prints its steps while another thread reads its clips.
    inside, printed, bar = threading.Event(), threading.Event(), sys.stderr

    def reads() -> None:
        with quiet():
            inside.set()
            printed.wait(60)
            print("Warning: the library's")

    reader = threading.Thread(target=reads)
    reader.start()
    assert inside.wait(60)
    print("step 1: loss 0.5", flush=True)
    print("warning: of ours", file=sys.stderr, flush=True)
    print("a bar", file=bar, flush=True)  # that has begun before
    os.write(1, b"a program's\n")
    printed.set()
    reader.join()
    assert capfd.readouterr() == ("step 1: loss 0.5\na program's\n", "warning: of ours\na bar\n")
    print("afterwards")
    assert capfd.readouterr() == ("afterwards\n", "")


def test_several_threads_are_silenced_at_once_until_the_last_leaves(capfd: pytest.CaptureFixture[str]) -> None:
    both, first_left = threading.Barrier(2, timeout=60), threading.Event()

    def reads(first: bool) -> None:
        with quiet():
            both.wait()
            print("Warning: the library's")
            if not first:
                first_left.wait(60)
                print("Warning: the library's, later")
        if first:
            print("the first has left")
            first_left.set()

    with ThreadPoolExecutor(2) as threads:
        list(threads.map(reads, (True, False)))
    print("afterwards")
    assert capfd.readouterr() == ("the first has left\nafterwards\n", "")


def test_a_process_without_stdout_can_be_silenced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    with quiet(), ThreadPoolExecutor(1) as thread:
        thread.submit(print, "nobody hears this", flush=True).result()
    assert sys.stdout is None
