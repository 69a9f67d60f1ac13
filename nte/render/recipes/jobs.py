"""Rendering of clips in other processes: several on this machine, or the workers of a Dask cluster.

The unit of work is a clip. Its scene is built and its kernels are compiled once, and everything that it depends on is
in its plan. An interrupted clip keeps its whole frames, so a lost worker costs a frame and not a clip. Two workers that
are given the same clip write the same bytes, each frame whole, so nothing has to be locked.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from secrets import token_hex
from types import ModuleType
from typing import TYPE_CHECKING

from nte.errors import NteError, needs_extra
from nte.interrupt import end_when_told, ending_workers
from nte.render.engine.backend import load_mitsuba, share_cores
from nte.render.recipes.recipe import ClipPlan
from nte.version import __version__

if TYPE_CHECKING:
    from distributed import Client, Worker

Work = Callable[[ClipPlan, Path], None]  # renders a clip below a folder
Done = Callable[[ClipPlan], None]

PATIENCE = 10  # seconds within which a scheduler must answer and have a worker
_PACKAGES = ("mitsuba", "drjit", "numpy")  # the bytes of a frame depend on these and on nte


def in_processes(work: Work, units: list[ClipPlan], out: Path, jobs: int, done: Done) -> None:
    """Do all units in `jobs` processes. They are spawned, because Dr.Jit's threads do not survive a fork."""
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_begin_worker, initargs=(jobs,))
    try:
        with ending_workers():
            futures = {pool.submit(work, unit, out): unit for unit in units}
            for future in as_completed(futures):
                future.result()
                done(futures[future])
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin_worker(jobs: int) -> None:
    end_when_told()
    share_cores(jobs)


@dataclass(frozen=True)
class _Terms:
    """What a worker must have in common with this process."""

    token: Path  # a file in the output folder
    versions: dict[str, str]
    neighbours: dict[str, int]  # address of a worker → how many share its machine


def on_cluster(work: Work, units: list[ClipPlan], out: Path, address: str, done: Done) -> None:
    """Do all units on the workers of the Dask scheduler at `address`, tcp://host:port.

    Every worker must see `out` under the same path, and have the same versions of nte and its packages. A unit whose
    worker dies is done again by another. Raises NteError where no scheduler answers, a worker does not fit, or a unit
    fails.
    """
    try:
        import dask

        with dask.config.set(logging={"distributed": "critical", "distributed.client": "critical"}):
            import distributed  # sets up its log on first import; anything that matters comes back as an error
    except ImportError as error:
        raise needs_extra("cluster", "--scheduler", error) from error
    with _connected(distributed, address) as client, _token(out.absolute()) as token:
        terms = _Terms(token, _versions(), _neighbours(client))
        for worker, fault in client.run(_fault, terms, on_error="return").items():
            if fault:
                raise NteError(f"worker {worker}: {fault}")
        futures = {
            client.submit(_render_there, work, unit, out.absolute(), terms, key=f"{unit.folder} {token.name}"): unit
            for unit in units
        }
        try:
            for future in distributed.as_completed(futures, loop=client.loop):
                future.result()
                done(futures[future])
        except CancelledError as error:
            raise NteError(f"the scheduler at {address} is gone: start it and render again, frames are kept") from error
        except distributed.KilledWorker as error:
            what = futures[future].folder
            raise NteError(f"{what}: every worker that tried to render it has died: give them more memory") from error
        finally:
            client.cancel(list(futures))


@contextmanager
def _connected(distributed: ModuleType, address: str) -> Iterator["Client"]:
    """A client of the scheduler, which has at least one worker."""
    try:
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise NteError(f"no Dask scheduler answers at {address}: start one with: dask scheduler") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise NteError(
                f"the scheduler at {address} has no workers: start some with: dask worker {address} --nthreads 1"
            ) from error
        yield client


@contextmanager
def _token(out: Path) -> Iterator[Path]:
    """A file in the folder while it is rendered to; a worker that sees the file shares our file system."""
    token = out / f".rendering-{token_hex(8)}"
    token.touch()
    try:
        yield token
    finally:
        token.unlink(missing_ok=True)


def _neighbours(client: "Client") -> dict[str, int]:
    hosts = {address: worker["host"] for address, worker in client.scheduler_info()["workers"].items()}
    return {address: list(hosts.values()).count(host) for address, host in hosts.items()}


def _versions() -> dict[str, str]:
    packages = {name: version(name) for name in _PACKAGES}
    return {"nte": __version__, **packages, "Mitsuba's variant": str(load_mitsuba().variant())}


def _fault(terms: _Terms, dask_worker: "Worker") -> str | None:
    """Why this worker cannot render, or None. Runs on workers, and again for each unit, as workers come and go."""
    if not terms.token.is_file():
        return f"does not see {terms.token.parent}: the folder must be on a file system that all workers share"
    if dask_worker.state.nthreads != 1:
        return f"has {dask_worker.state.nthreads} threads, expected 1 (a clip uses all cores): give it --nthreads 1"
    for name, ours in terms.versions.items():
        if (theirs := _versions()[name]) != ours:
            return f"{name} is {theirs} there and {ours} here: install the same on both"
    return None


def _render_there(work: Work, unit: ClipPlan, out: Path, terms: _Terms) -> None:
    """Render one unit, on a worker."""
    from distributed import get_worker

    worker = get_worker()
    if fault := _fault(terms, worker):
        raise NteError(f"worker {worker.address}: {fault}")
    share_cores(terms.neighbours.get(worker.address, 1))
    work(unit, out)
