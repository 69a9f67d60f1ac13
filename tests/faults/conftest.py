"""Every denoiser, each in its turn."""

from collections.abc import Callable
from pathlib import Path

import pytest

from nte import Denoiser, load_denoiser, released
from nte.filters.named import NAMES
from nte.filters.prior import complete
from nte.training.run import load_run
from tests.models.lights import NETWORKS, light_network
from tests.shared import made_once
from tests.training.runs import tiny_config

FILTERS = (
    *NAMES, "taa:clamp=none", "trmv:target=visibility", "svgf:target=components", "estimate+taa",
    "align_accumulate:motion=geometric", *released.names(),
)  # fmt: skip


def maker(name: str) -> Callable[[], Denoiser]:
    """Make new denoisers of the kind that is called so in FILTERS or NETWORKS."""
    return lambda: complete(light_network(name)) if name in NETWORKS else load_denoiser(name)


@pytest.fixture(params=[*FILTERS, *NETWORKS])
def make(request: pytest.FixtureRequest) -> Callable[[], Denoiser]:
    """Make a new denoiser of the kind that is this test's turn."""
    name: str = request.param
    if "oidn" in name or name in released.names():
        pytest.importorskip("pyoidn")
    return maker(name)


@pytest.fixture
def denoiser(make: Callable[[], Denoiser]) -> Denoiser:
    return make()


@pytest.fixture(scope="session")
def run(noisy_disc: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with a network of a few hundred weights. Only to be read."""

    def train_two_steps(folder: Path) -> None:
        from nte.training.loop import train

        train(tiny_config(folder, noisy_disc, "phases=[{steps: 2}]"), device="cpu")

    folder = made_once(tmp_path_factory, "disturbed_run", train_two_steps) / "runs" / "tiny"
    load_run(folder)
    return folder
