"""Conventions of motion vectors: each is told apart in words, and converts to what nte means."""

import pytest
import torch
from torch import Tensor

from nte.motion.conventions import CONVENTIONS, UNITS, Convention
from tests.synthetic import disc_frame

SIZE = (40, 56)


def stored(motion: Tensor, convention: Convention) -> Tensor:
    """Pixel vectors as a producer of this convention writes them: the other way round than `convert`."""
    height, width = SIZE
    steps = {"pixels": (1.0, 1.0), "uv": (1 / width, 1 / height), "NDC": (2 / width, 2 / height)}
    x, y = (motion[:, i] * steps[convention.unit.split(",")[0]][i] * convention.signs[i] for i in range(2))
    return torch.stack([y, x] if convention.swapped else [x, y], 1)


@pytest.mark.parametrize("convention", CONVENTIONS, ids=str)
def test_vectors_of_every_convention_become_ours(convention: Convention) -> None:
    """Two speeds, slanted, in an image that is no square: no two conventions agree."""
    how = {"velocity": (4.0, -3.0), "wall_velocity": (-2.0, 1.0), "size": SIZE}
    before, now = ({k: torch.as_tensor(v)[None] for k, v in disc_frame(i, **how).items()} for i in range(2))  # type: ignore[arg-type]
    nothing = torch.full_like(now["motion"], torch.nan)  # whatever the convention does not read
    if convention.forward:
        found = convention.convert(nothing, stored(before["forward_motion"], convention), before["depth"])
    else:
        found = convention.convert(stored(now["motion"], convention), nothing, before["depth"])
    known = found.isfinite().all(1)
    assert known.float().mean() > (0.8 if convention.forward else 0.99)
    apart = (found - now["motion"]).abs().amax(1)
    assert (apart[known] < 1e-4).float().mean() > 0.99


def test_words_tell_every_convention_from_every_other() -> None:
    assert len(CONVENTIONS) == 2 * len(UNITS) * 2 * 4 == len({str(convention) for convention in CONVENTIONS})
    assert str(Convention()) == "ours"
    assert str(Convention((-1, -1))) == "sign (they are negated, on the current frame's pixels)"
    forward = "direction (they are stored on the previous frame's pixels and point to the current one)"
    assert str(Convention(forward=True)) == forward
    assert str(Convention((1, -1), forward=True)) == f"{forward}, sign of y (y counts upwards)"
