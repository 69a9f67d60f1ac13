"""A texture that repeats, sampled anew in every frame, contradicts no vectors; wrong ones over it are still told."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.checking import check
from nte.checking.cells import cell_votes
from nte.checking.judge import Judgement, judge_votes
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from tests.checking.tiles import tiled_frame
from tests.synthetic import Pixels, write_clip


def judged(frames: list[dict[str, Pixels]], without: tuple[str, ...] = ()) -> Judgement:
    kept = [{name: torch.tensor(v)[None] for name, v in frame.items() if name not in without} for frame in frames]
    return judge_votes([cell_votes(Frame(a, 0), Frame(b, 1)) for a, b in pairwise(kept)])


@pytest.mark.parametrize(
    ("kind", "scale", "ball"),
    [("checkers", 0.5, True), ("checkers", 1, False), ("checkers", 1, True), ("bricks", 1, True), ("photo", 2, True)],
)
@pytest.mark.parametrize("without", [(), ("instance", "depth")])
def test_tiles_at_rest_accuse_no_vectors(kind: str, scale: float, ball: bool, without: tuple[str, ...]) -> None:
    """Near the horizon the tiles are so fine that any pixel is found among them: that is no displacement."""
    frames = [tiled_frame(i, kind, scale, ball=ball) for i in range(3)]
    assert judged(frames, without).verdict != "implausible"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 4))
@pytest.mark.parametrize("kind", ["checkers", "bricks", "photo"])
@pytest.mark.parametrize("scale", [0.5, 1, 2])
def test_more_tiles_at_rest(kind: str, scale: float, seed: int) -> None:
    for without in ((), ("instance", "depth")):
        frames = [tiled_frame(i, kind, scale, seed) for i in range(4)]
        assert judged(frames, without).verdict != "implausible"


@pytest.mark.parametrize("by", [(6.0, 0.0), (0.0, -5.0)])
def test_vectors_that_lead_over_tiles_at_rest_are_not_plausible(tmp_path: Path, by: tuple[float, float]) -> None:
    frames = [tiled_frame(i, "photo", 1) for i in range(3)]
    for frame in frames:
        frame["motion"] = frame["motion"] + np.float32(by).reshape(2, 1, 1)
    assert check(Clip(write_clip(tmp_path / "clip", frames))).verdict != "plausible"
