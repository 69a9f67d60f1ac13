"""What every test may rely on: one thread for PyTorch, also in processes it starts, and random numbers of its own."""

import gc
import os
import random
import secrets
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small tensors: more threads only wait for each other

import numpy as np
import pytest
import torch
from hypothesis import settings

from tests.shared import made_once
from tests.synthetic import disc_clip

torch.set_num_threads(1)

# The same examples in every run: what passed once passes again. To look for new ones: --hypothesis-profile=explore
settings.register_profile("nte", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None, max_examples=1000)
settings.load_profile("nte")


Rounds = Callable[[str, int, int], int]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--torture", action="store_true", help="only tests that torture, with long rounds; for make torture"
    )
    parser.addoption("--seed", type=int, help="of random moments, as a test that failed has said it")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Every day's tests are all but those marked `torture`; with --torture only those, and all that have rounds."""
    long = config.getoption("torture")
    marked = {item: item.get_closest_marker("torture") is not None for item in items}
    left = [item for item in items if not (marked[item] or has_rounds(item) if long else not marked[item])]
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if item not in set(left)]


def has_rounds(item: pytest.Item) -> bool:
    return "rounds" in getattr(item, "fixturenames", ())


@pytest.fixture
def rounds(pytestconfig: pytest.Config, record_property: Callable[[str, object], None]) -> Rounds:
    """Tell how often a test does something, and count it for the summary: `rounds("kills", 2, 50)`, short and long."""

    def of(what: str, short: int, long: int) -> int:
        count = long if pytestconfig.getoption("torture") else short
        record_property(what, count)
        return count

    return of


@pytest.fixture
def moments(pytestconfig: pytest.Config) -> random.Random:
    """Draw moments at which a test kills: others in every run, as each must do. A test that fails says their seed."""
    given: int | None = pytestconfig.getoption("seed")
    seed = secrets.randbits(32) if given is None else given
    print(f"random moments: --seed {seed} draws the same again")
    return random.Random(seed)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print what was done to nte, and how often."""
    if config.getoption("torture"):
        done, failed = Counter[str](), Counter[str]()
        for outcome, counter in (("passed", done), ("failed", failed)):
            for report in terminalreporter.getreports(outcome):
                for what, count in report.user_properties:
                    counter[what] += count
        terminalreporter.section("torture")
        for what in sorted({*done, *failed}):
            terminalreporter.line(f"{what}: {done[what]:,} withstood, {failed[what]:,} in tests that failed")


@pytest.fixture(autouse=True)
def _the_same_random_numbers_in_any_order() -> None:
    """What a test draws must not depend on which tests its worker process ran before."""
    torch.manual_seed(0)
    np.random.seed(0)


@pytest.fixture(autouse=True)
def _deterministic_setting_stays_local() -> Iterator[None]:
    """Training switches deterministic algorithms on for its process; the next test starts without."""
    yield
    if torch.are_deterministic_algorithms_enabled():
        torch.use_deterministic_algorithms(False)


def pytest_collection_finish() -> None:
    """What was imported to collect the tests stays for good: no garbage collection looks through it again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def _no_scene_outlives_its_test() -> Iterator[None]:
    """A scene that is still alive in a reference cycle is compiled into the kernels of those that come after it.

    Without it the same scene is the same kernel, which Dr.Jit has: in memory, or on disk from another process.
    """
    yield
    if "mitsuba" in sys.modules:
        gc.collect()


@pytest.fixture(scope="session")
def noisy_disc(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip of four noisy frames of 40×24 in which a disc moves to the right. Only to be read."""

    def make(folder: Path) -> None:
        disc_clip(folder / "disc", frames=4, seed=1, size=(24, 40), start=(10.0, 12.0), radius=6.0)

    return made_once(tmp_path_factory, "noisy_disc", make) / "disc"


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """An empty folder that is a read-only file system."""
    folder = tmp_path / "locked"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("this machine lets us mount nothing")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)
