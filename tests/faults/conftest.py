"""Every denoiser, each in its turn."""

from collections.abc import Callable

import pytest

from nte import Denoiser, load_denoiser
from nte.filters.named import NAMES
from nte.filters.prior import complete
from tests.models.lights import NETWORKS, light_network

FILTERS = (
    *NAMES, "taa:clamp=none", "trmv:target=visibility", "svgf:target=components", "estimate+taa",
    "align_accumulate:motion=geometric",
)  # fmt: skip


def maker(name: str) -> Callable[[], Denoiser]:
    """Make new denoisers of the kind that is called so in FILTERS or NETWORKS."""
    return lambda: complete(light_network(name)) if name in NETWORKS else load_denoiser(name)


@pytest.fixture(params=[*FILTERS, *NETWORKS])
def make(request: pytest.FixtureRequest) -> Callable[[], Denoiser]:
    """Make a new denoiser of the kind that is this test's turn."""
    name: str = request.param
    if "oidn" in name:
        pytest.importorskip("pyoidn")
    return maker(name)


@pytest.fixture
def denoiser(make: Callable[[], Denoiser]) -> Denoiser:
    return make()
