"""Work in other processes of this machine; nte.cluster does it on several.

Work is a list of units, such as the clips of a recipe. A unit depends on nothing but itself, and writes files that are
whole or absent, so nothing has to be locked: a unit whose worker dies is done again by another one.
"""

from collections.abc import Callable, Mapping, MutableSequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from multiprocessing import active_children, get_context
from typing import TypeVar

from nte.errors import NteError
from nte.interrupt import StoppedError, stop_when_told, stoppable, stopping_workers

Unit = TypeVar("Unit")
Result = TypeVar("Result")

LOOK = 1  # seconds without a result after which we look how far units are


@dataclass(frozen=True)
class Kind:
    """A kind of work, and what it asks of the processes that do it. The functions must be those of a module.

    verb: what is done, for messages. share_cores: limits the calling process to its share of the cores; its argument is
    the number of processes side by side. versions: what the results depend on besides nte, by name.
    """

    verb: str
    share_cores: Callable[[int], None]
    versions: Callable[[], dict[str, str]]


def require_jobs(jobs: int) -> None:
    """Raise NteError for a number of processes below 1."""
    if jobs < 1:
        raise NteError(f"--jobs {jobs}: expected a number of processes, 1 or more")


def in_processes(
    kind: Kind,
    work: Callable[[Unit], Result],
    units: Mapping[str, Unit],
    jobs: int,
    done: Callable[[str, Result], None],
    advance: Callable[[int], None] = lambda count: None,
) -> None:
    """Do all units in `jobs` processes; call done(name, result) as each ends.

    advance: called every LOOK seconds, and before `done`, with the pieces of work that units have told by `tick`.
    units: name → unit. Processes are spawned, because threads of Dr.Jit and PyTorch do not survive a fork. Raises what
    a unit raises, and NteError if a process is killed.
    """
    require_jobs(jobs)
    context = get_context("spawn")
    ticks = context.RawArray("q", len(units))  # a number for each unit, so that nobody needs a lock
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_worker, initargs=(kind, jobs, ticks))
    seen = 0
    try:
        with stopping_workers():
            left, running = iter(enumerate(units.items())), dict[Future[Result], str]()

            def begin(count: int) -> None:
                for number, (name, unit) in islice(left, count):
                    running[pool.submit(_do_here, work, unit, number)] = name

            begin(2 * jobs)  # not all at once: a result is in memory as long as its future
            while running:
                ended = wait(running, LOOK, FIRST_COMPLETED).done
                now = sum(ticks)
                advance(now - seen)
                seen = now
                for future in ended:
                    name = running.pop(future)
                    begin(1)
                    done(name, future.result())
    except (BrokenProcessPool, StoppedError) as error:
        raise NteError(
            f"a process that had to {kind.verb} was killed: if memory ran out, give fewer --jobs; what is done is kept"
        ) from error
    finally:
        _end(pool)


def _end(pool: ProcessPoolExecutor) -> None:
    """Wait for the processes of a pool to end; whoever interrupts that, too, kills them.

    Left alone, they would wait for a word that nobody sends, and Python for them when it exits.
    """
    try:
        pool.shutdown(wait=True, cancel_futures=True)
    except BaseException:
        for worker in active_children():
            worker.kill()
        raise


class _Ticks:
    """Where a process of a pool tells how far it is."""

    counts: MutableSequence[int] | None = None  # in memory that it shares with its parent
    unit = 0  # the number of the unit that it works on


def tick(count: int = 1) -> None:
    """Tell how many pieces of a unit are done now, in the process that works on it.

    It is heard by `in_processes`, and costs an addition; elsewhere nobody hears it.
    """
    if _Ticks.counts is not None:
        _Ticks.counts[_Ticks.unit] += count


def _begin_worker(kind: Kind, jobs: int, ticks: MutableSequence[int]) -> None:
    stop_when_told()
    _Ticks.counts = ticks
    kind.share_cores(jobs)


def _do_here(work: Callable[[Unit], Result], unit: Unit, number: int) -> Result:
    """Do one unit, in a process of the pool."""
    _Ticks.unit = number
    return stoppable(lambda: work(unit))
