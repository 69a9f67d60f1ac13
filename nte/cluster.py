"""Work on the workers of a Dask cluster: the units of nte.jobs, on other machines."""

import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import chdir, contextmanager, nullcontext
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from nte.errors import NteError, needs_extra
from nte.files import temporary_name
from nte.jobs import Kind, Result, Unit
from nte.version import __version__

if TYPE_CHECKING:
    import distributed
    from distributed import Client, Worker

QUEUED = 500  # units that a scheduler has at a time, more than a cluster has workers
PATIENCE = 10  # seconds within which a scheduler must answer and have a worker
RETURN = 300  # seconds within which workers must be back, once all have gone: a batch system may start others
LOOK = 1  # seconds without a result after which we look whether there are workers


class NoWorkersWarning(UserWarning):
    """Warning that a cluster has lost its last worker, and that its work waits for another."""


@dataclass(frozen=True)
class _Terms:
    """What a worker must have in common with this process."""

    kind: Kind
    token: Path  # a file in the output folder
    here: Path  # the working directory, from which relative paths of units start
    versions: dict[str, str]
    neighbours: dict[str, int]  # address of a worker → how many share its machine


def on_cluster(
    kind: Kind,
    work: Callable[[Unit], Result],
    units: Mapping[str, Unit],
    folder: Path,
    address: str,
    done: Callable[[str, Result], None],
) -> None:
    """Do all units on the workers of the Dask scheduler at `address`, tcp://host:port; call done(name, result).

    units: name → unit. Every worker must see `folder`, where the results go, and whatever files a unit names under the
    same paths, and have the same versions of nte and of what the work depends on. A unit whose worker dies is done
    again by another. Raises NteError where no scheduler answers, no worker is left for RETURN seconds, a worker does
    not fit, or a unit fails.
    """
    try:
        import dask

        with dask.config.set(logging={"distributed": "critical", "distributed.client": "critical"}):
            import distributed  # sets up its log on first import; anything that matters comes back as an error
    except ImportError as error:
        raise needs_extra("cluster", "--scheduler", error) from error
    lost = f"the scheduler at {address} is gone: start it and {kind.verb} again, what is done is kept"
    with _or(lost, distributed), _connected(distributed, address) as client, _token(folder.absolute(), kind) as token:
        terms = _Terms(kind, token, Path.cwd(), _versions(kind), _neighbours(client))
        for worker, fault in client.run(_fault, terms, on_error="return").items():
            if fault:
                raise NteError(f"worker {worker}: {fault}")
        left, running = iter(units.items()), dict[distributed.Future, str]()
        ended = distributed.as_completed(loop=client.loop)

        def begin(count: int) -> None:
            for name, unit in islice(left, count):
                future = client.submit(_do_there, work, unit, terms, key=f"{name} {token.name}")
                running[future] = name
                ended.add(future)

        name = ""
        try:
            begin(QUEUED)
            for future in _as_they_end(ended, client, kind, address):
                name = running.pop(future)
                begin(1)
                done(name, future.result())
        except distributed.KilledWorker as error:
            raise NteError(
                f"{name}: every worker that tried to {kind.verb} it has died: give them more memory"
            ) from error
        finally:
            client.cancel(list(running))


@contextmanager
def _connected(distributed: ModuleType, address: str) -> Iterator["Client"]:
    """A client of the scheduler, which has at least one worker."""
    try:
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise NteError(f"no Dask scheduler answers at {address}: start one with: dask scheduler") from error
    try:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise NteError(
                f"the scheduler at {address} has no workers: start some with: dask worker {address} --nthreads 1"
            ) from error
        yield client
    finally:
        try:
            client.close()
        except RuntimeError:  # of a race in Dask, where the scheduler has just gone: it must not hide that
            client.status = "closed"  # or Dask closes again at the end, and shows a traceback


def _as_they_end(
    ended: "distributed.as_completed", client: "Client", kind: Kind, address: str
) -> Iterator["distributed.Future"]:
    """Yield futures as they end. Raises NteError where there is nobody left to end them: Dask would wait forever."""
    start = f"start some with: dask worker {address} --nthreads 1"
    seen = looked = time.monotonic()  # when there were workers; when we looked
    told = False
    while not ended.is_empty():
        if ended.has_ready():
            yield next(ended)
            seen = time.monotonic()
            continue
        with ended.thread_condition:
            ended.thread_condition.wait(0.1)  # as its __next__ does
        if (now := time.monotonic()) < looked + LOOK:
            continue
        if _has_workers(client):
            seen, told = now, False
        elif now - seen > RETURN:
            again = f"{start}, and {kind.verb} again, what is done is kept"
            raise NteError(f"the scheduler at {address} has lost its last worker: {again}")
        elif now - seen > PATIENCE and not told:
            told = True
            text = f"the scheduler at {address} has no workers left: {start}; this waits for {RETURN} seconds"
            warnings.warn(text, NoWorkersWarning, stacklevel=2)
        looked = time.monotonic()


def _has_workers(client: "Client") -> bool:
    """Tell whether the scheduler has workers; true where it does not answer, which the client notices by itself."""
    try:
        return bool(client.sync(client.scheduler.ncores, callback_timeout=PATIENCE))
    except (OSError, TimeoutError):
        return True


@contextmanager
def _or(lost: str, distributed: ModuleType) -> Iterator[None]:
    """Raise NteError with the text `lost` if the scheduler goes away within the block."""
    try:
        yield
    except (CancelledError, distributed.comm.CommClosedError, distributed.client.ClosedClientError) as error:
        raise NteError(lost) from error


@contextmanager
def _token(folder: Path, kind: Kind) -> Iterator[Path]:
    """A file in the folder while it is written to; a worker that sees the file shares our file system."""
    token = temporary_name(folder / kind.verb)  # swept with other leftovers if this process is killed
    token.touch()
    try:
        yield token
    finally:
        token.unlink(missing_ok=True)


def _neighbours(client: "Client") -> dict[str, int]:
    hosts = {address: worker["host"] for address, worker in client.scheduler_info()["workers"].items()}
    return {address: list(hosts.values()).count(host) for address, host in hosts.items()}


def _versions(kind: Kind) -> dict[str, str]:
    return {"nte": __version__, **kind.versions()}


def _fault(terms: _Terms, dask_worker: "Worker") -> str | None:
    """Why this worker does not fit, or None. Runs on workers, and again for each unit, as workers come and go."""
    if not terms.token.is_file():
        return f"does not see {terms.token.parent}: the folder must be on a file system that all workers share"
    if dask_worker.state.nthreads != 1:
        return f"has {dask_worker.state.nthreads} threads, expected 1 (a unit uses all cores): give it --nthreads 1"
    here = _versions(terms.kind)
    for name, ours in terms.versions.items():
        if (theirs := here[name]) != ours:
            return f"{name} is {theirs} there and {ours} here: install the same on both"
    return None


def _do_there(work: Callable[[Unit], Result], unit: Unit, terms: _Terms) -> Result:
    """Do one unit, on a worker."""
    from distributed import get_worker

    worker = get_worker()
    if fault := _fault(terms, worker):
        raise NteError(f"worker {worker.address}: {fault}")
    terms.kind.share_cores(terms.neighbours.get(worker.address, 1))
    with chdir(terms.here) if terms.here.is_dir() else nullcontext():
        return work(unit)
