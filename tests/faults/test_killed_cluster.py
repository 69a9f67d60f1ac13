"""Workers, schedulers and clients of a Dask cluster that are killed: the same command then ends as if undisturbed.

They are real processes, killed at any moment. A command whose scheduler is killed ends by itself, in a line.
"""

import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from nte import cluster as clusters
from nte.cli import main
from nte.errors import NteError
from tests.cluster import COUNTING, Cluster, wait_for
from tests.conftest import Rounds
from tests.faults.commands import command, contents, differing
from tests.synthetic import disc_clip

pytest.importorskip("distributed")
pytestmark = pytest.mark.slow
BOUND = 30  # seconds within which a command without its scheduler ends
VICTIMS = ("worker", "scheduler", "client")


class Restarted:
    """A cluster that begins anew at the same address, as somebody starts it again."""

    def __init__(self, folder: Path, open_ones: ExitStack) -> None:
        self._folder, self._open = folder, open_ones
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port: int = free.getsockname()[1]
        self.begin()

    def begin(self) -> None:
        self._open.close()
        self.cluster = self._open.enter_context(Cluster(self._folder, port=self._port))

    def kill(self, victim: str, client: "subprocess.Popen[str]") -> None:
        kill = {"worker": self.cluster.workers[0].kill, "scheduler": self.cluster.scheduler.kill, "client": client.kill}
        kill[victim]()

    def mend(self, victim: str) -> None:
        """Start again what was killed."""
        if victim == "scheduler":
            self.begin()
        elif victim == "worker":
            self.cluster.workers.pop(0).wait()
            self.cluster.add_worker()
            self.cluster.wait()


@pytest.fixture
def restarted(tmp_path: Path) -> Iterator[Restarted]:
    with ExitStack() as open_ones:
        yield Restarted(tmp_path / "cluster", open_ones)


@pytest.fixture(scope="session")
def discs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of four clips. Only to be read."""
    folder = tmp_path_factory.mktemp("discs")
    for seed in range(4):
        disc_clip(folder / f"disc_{seed}", frames=4, seed=seed, size=(24, 40))
    return folder


def started(words: list[str]) -> "subprocess.Popen[str]":
    return subprocess.Popen([sys.executable, "-m", "nte", *words], stderr=subprocess.PIPE, text=True)


def whole_files(out: Path) -> int:
    with suppress(FileNotFoundError):  # a folder that was removed meanwhile
        return sum(path.is_file() and path.suffix != ".tmp" for path in out.rglob("*"))
    return 0


@pytest.mark.parametrize("victim", VICTIMS)
@pytest.mark.parametrize("name", ["render", "evaluate"])
def test_the_same_command_ends_as_undisturbed(
    name: str, victim: str, restarted: Restarted, discs: Path, tmp_path: Path, rounds: Rounds, moments: random.Random
) -> None:
    if name == "render" and find_spec("mitsuba") is None:  # not imported: nte.render must choose the LLVM first
        pytest.skip("mitsuba is not installed")

    def words(out: Path) -> list[str]:
        return command(name, out, discs, discs, tmp_path)

    assert main(words(tmp_path / "undisturbed")) == 0
    expected, files = contents(tmp_path / "undisturbed"), whole_files(tmp_path / "undisturbed")
    told_that_it_is_gone = 0
    for number in range(rounds(f"killed {victim}s of a cluster", 1, 10)):
        out = tmp_path / f"out {number}"
        arguments = [*words(out), "--scheduler", restarted.cluster.address]
        # Files that are there when it is killed.
        moment = moments.randint(1, files - 1) if number else files // 2
        with started(arguments) as client:
            wait_for(lambda: whole_files(out) >= moment or client.poll() is not None)  # noqa: B023
            restarted.kill(victim, client)
            killed = time.monotonic()
            said = [line for line in client.communicate(timeout=300)[1].splitlines() if line.startswith("nte: ")]
        if victim == "worker":
            assert (client.returncode, said) == (0, [])
        elif victim == "client":
            assert client.returncode in (-signal.SIGKILL, 0)
        elif client.returncode:  # it had not done everything
            assert client.returncode == 2
            assert time.monotonic() - killed < BOUND
            (line,) = said
            gone = f"the scheduler at {restarted.cluster.address} is gone: start it and {name} again"
            # The recipe is there before the client has found the scheduler.
            assert gone in line or f"no Dask scheduler answers at {restarted.cluster.address}" in line
            told_that_it_is_gone += gone in line
        finished = client.returncode == 0
        restarted.mend(victim)
        if not finished:
            with started(arguments) as again:
                assert again.communicate(timeout=300)[1].count("nte: ") == 0
            assert again.returncode == 0
        assert not differing(contents(out), expected), moment
    assert told_that_it_is_gone or victim != "scheduler"


@pytest.mark.parametrize("queued", [1, 500])
def test_work_without_its_scheduler_ends_in_a_line_in_bounded_time(
    queued: int, tmp_path: Path, rounds: Rounds, moments: random.Random, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where it is killed before the first unit is handed out, or while a result is on its way."""
    monkeypatch.setattr(clusters, "QUEUED", queued)
    units = {f"unit {number}": number for number in range(100_000)}
    for number in range(rounds("killed schedulers", 2, 20)):
        with Cluster(tmp_path / f"cluster {number}", workers=1) as cluster:
            killed = list[float]()

            def kill(cluster: Cluster = cluster, killed: list[float] = killed) -> None:
                killed.append(time.monotonic())
                cluster.scheduler.kill()

            def done(name: str, result: object, amid: bool = not number, kill: Callable[[], None] = kill) -> None:
                if amid:  # the first time it is gone for sure
                    kill()

            timer = threading.Timer(moments.uniform(0, 3), kill)
            work = COUNTING, partial(np.full, 1000), units, tmp_path, cluster.address
            gone = r"the scheduler at .* is gone: start it and count again, what is done"
            if number:
                timer.start()
                gone += "|no Dask scheduler answers"
            with pytest.raises(NteError, match=gone):
                clusters.on_cluster(*work, done)
            assert time.monotonic() - killed[0] < BOUND
            timer.cancel()


def test_a_receiver_that_takes_longer_than_the_client_waits_for_a_scheduler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clusters, "PATIENCE", 3)
    monkeypatch.setattr(clusters, "QUEUED", 10)
    units = {f"unit {number}": number for number in range(1000)}
    with Cluster(tmp_path / "cluster", workers=1) as cluster:

        def done(name: str, result: object) -> None:
            cluster.scheduler.kill()
            time.sleep(2 * clusters.PATIENCE)

        with pytest.raises(NteError, match=r"the scheduler at .* is gone"):
            clusters.on_cluster(COUNTING, partial(np.full, 1000), units, tmp_path, cluster.address, done)


def nap(value: int) -> int:
    time.sleep(0.05)
    return value


def test_work_whose_last_worker_is_killed_says_so_and_ends_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clusters, "RETURN", 4)
    monkeypatch.setattr(clusters, "PATIENCE", 2)
    units = {f"unit {number}": number for number in range(1000)}
    with Cluster(tmp_path / "cluster", workers=1) as cluster:
        killed = list[float]()

        def done(name: str, result: object) -> None:
            killed.append(time.monotonic())
            cluster.workers[0].kill()

        with (
            pytest.warns(clusters.NoWorkersWarning, match=r"has no workers left: start some with: dask worker tcp://"),
            pytest.raises(NteError, match=r"has lost its last worker: start some with: .*, and count again, what is"),
        ):
            clusters.on_cluster(COUNTING, nap, units, tmp_path, cluster.address, done)
        assert time.monotonic() - killed[0] < BOUND
        assert [path.name for path in tmp_path.iterdir()] == ["cluster"]


def test_work_whose_last_worker_is_killed_goes_on_with_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "PATIENCE", 2)
    units, seen = {f"unit {number}": number for number in range(50)}, dict[str, object]()
    with Cluster(tmp_path / "cluster", workers=1) as cluster:

        def done(name: str, result: object) -> None:
            seen[name] = result
            if len(seen) == 3:
                cluster.workers[0].kill()
                threading.Timer(4, cluster.add_worker).start()

        with pytest.warns(clusters.NoWorkersWarning):
            clusters.on_cluster(COUNTING, nap, units, tmp_path, cluster.address, done)
    assert seen == units
