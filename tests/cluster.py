"""A Dask cluster for tests: a real scheduler and real workers on loopback, which can be killed."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

from nte.jobs import Kind


def wait_for(found: Callable[[], object], seconds: float = 300) -> object:
    """Ask again and again until the answer is true, and return it."""
    end = time.monotonic() + seconds
    while not (value := found()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)
    return value


def share_nothing(jobs: int) -> None:
    """Do nothing."""


COUNTING = Kind("count", share_nothing, dict)  # work that needs nothing: a worker imports no PyTorch for it


class Cluster:
    """A scheduler with workers; all of them end with the block. folder: for their files. port: 0 takes any."""

    def __init__(self, folder: Path, workers: int = 2, port: int = 0) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.workers = folder, list[subprocess.Popen[bytes]]()
        file = folder / f"scheduler_{time.monotonic_ns()}.json"
        self.scheduler = self._start("scheduler", "--port", str(port), "--scheduler-file", str(file))
        wait_for(lambda: file.is_file() and file.stat().st_size)
        self.address: str = json.loads(file.read_text())["address"]
        for _ in range(workers):
            self.add_worker()
        self.wait()

    def add_worker(self, threads: int = 1) -> None:
        """Start another worker."""
        local = self.folder / f"worker_{time.monotonic_ns()}"
        options = ("--nthreads", str(threads), "--no-nanny", "--local-directory", str(local))
        self.workers.append(self._start("worker", self.address, *options))

    def wait(self) -> None:
        """Wait until all workers that live are known to the scheduler."""
        import distributed

        if alive := sum(worker.poll() is None for worker in self.workers):
            with distributed.Client(self.address, set_as_default=False) as client:
                client.wait_for_workers(alive, timeout=300)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()

    def _start(self, *arguments: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "dask", *arguments, "--host", "127.0.0.1", "--no-dashboard"]
        with (self.folder / "log").open("ab") as log:
            return subprocess.Popen(command, stdout=log, stderr=log)
