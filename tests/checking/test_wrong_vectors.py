"""Wrong vectors accuse no other channel, and of several faults the cause is told first."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.checking import check
from nte.checking.forward import Returns, judge_returns, returns
from nte.checking.judge import Judgement
from nte.checking.order import Order, depth_order, judge_order
from nte.checking.report import _judge
from nte.checking.values import Finding
from nte.checking.votes import Votes
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from tests.checking.test_late import SHOTS, noisy
from tests.synthetic import Pixels, disc_frame, write_clip

PASSING = {"velocity": (4.0, 0.0), "wall_velocity": (6.0, 0.0), "size": (64, 96), "start": (30.0, 32.0), "radius": 14.0}
Shot = dict[str, Pixels]


def frames_of(shots: list[Shot], without: tuple[str, ...] = ()) -> list[Frame]:
    return [
        Frame({n: torch.tensor(v)[None] for n, v in shot.items() if n not in without}, i)
        for i, shot in enumerate(shots)
    ]


def orders(shots: list[Shot], without: tuple[str, ...]) -> list[Order]:
    frames = frames_of(shots, without)
    return [depth_order(before, now) for before, now in pairwise(frames)]


@pytest.mark.parametrize("without", [(), ("instance",)])
def test_lost_vectors_of_one_object_do_not_accuse_depth(tmp_path: Path, without: tuple[str, ...]) -> None:
    """The wall leads to where the disc seems to have been, and it was the wall that was seen there."""
    shots = [disc_frame(i, **PASSING) for i in range(4)]  # type: ignore[arg-type]
    inverse = [shot | {"depth": 1 / shot["depth"]} for shot in shots]
    assert list(judge_order(orders(inverse, without)))
    for shot in shots:
        shot["motion"] = np.where(shot["instance"] == 2, 0, shot["motion"]).astype(np.float32)
    found = orders(shots, without)
    assert all(order.farther > order.nearer for order in found)
    assert not list(judge_order(found))


def told(shots: list[Shot]) -> list[Finding]:
    pairs: list[Returns] = []
    for i in range(1, len(shots)):
        before, now = frames_of(shots[i - 1 : i + 1])
        now = now.with_channels(previous_forward_motion=before["forward_motion"])
        pair = returns(before, now)
        assert pair is not None
        pairs.append(pair)
    return list(judge_returns(pairs, Votes()))


def test_motion_is_blamed_if_only_forward_vectors_find_their_albedo() -> None:
    shots = [disc_frame(i, **PASSING) for i in range(3)]  # type: ignore[arg-type]
    assert not told(shots)
    wrong = [shot | {"motion": shot["motion"] * np.float32(1.5)} for shot in shots]
    assert [(f.channel, f.fault, f.doubt) for f in told(wrong)] == [("motion", False, True)]
    late = [shot | {"forward_motion": shot["forward_motion"] * np.float32(1.5)} for shot in shots]
    assert [(f.channel, f.fault, f.doubt) for f in told(late)] == [("forward_motion", True, False)]


def test_where_nothing_tells_who_is_wrong_nobody_is() -> None:
    """Flat colours are found along any vectors."""
    shots = [disc_frame(i, **PASSING) for i in range(3)]  # type: ignore[arg-type]
    flat = [s | {"albedo": 0 * s["albedo"] + 0.5, "motion": s["motion"] * np.float32(1.5)} for s in shots]
    (finding,) = told(flat)
    assert (finding.channel, finding.fault, finding.doubt) == ("forward_motion", False, True)
    assert finding.found.endswith("; or motion is wrong")


@pytest.mark.parametrize(("name", "light"), [("reference", "color"), ("depth", "reference")])
def test_a_late_channel_is_only_called_late(tmp_path: Path, name: str, light: str) -> None:
    """Beside the right ones a late reference looks as if it had gone through a curve, and a late depth inverse."""
    frames = [SHOTS[i] | {"color": noisy(SHOTS[i]["color"], i), name: SHOTS[i - 1][name]} for i in range(1, 7)]
    bare = [{n: v for n, v in frame.items() if n != "position"} for frame in frames]
    report = check(Clip(write_clip(tmp_path / "clip", bare)))
    assert report.reason.startswith(f"{name}: shows what {light} shows one frame earlier")
    assert [f.found for f in report.findings if f.channel == name and f.fault] == [
        f"shows what {light} shows one frame earlier"
    ]


@pytest.mark.parametrize("verdict", ["undecidable", "implausible"])
def test_doubts_about_depth_come_before_vectors_that_are_judged_by_it(verdict: str) -> None:
    doubt = Finding("depth", "it may be inverse", "the distance", False, True)
    judged = _judge(Judgement(verdict, "votes disagree"), [doubt])  # type: ignore[arg-type]
    assert (judged.verdict, judged.reason) == (verdict, "depth: it may be inverse; votes disagree")
