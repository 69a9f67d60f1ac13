"""Camera jitter condemns no vectors; vectors that are as much wrong, alike in all pairs of frames, are still told."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
import torch

from nte.checking.cells import cell_votes
from nte.checking.judge import judge_votes
from nte.checking.votes import Against, Vector, Votes
from nte.frames.frame import Frame
from nte.motion.conventions import Convention

Y_UP = Convention((1, -1))
Jitters = list[tuple[float, float]]


def pair(given: list[Vector], seen: list[Vector], good: int = 0, rival: Convention | None = None) -> Votes:
    explained = frozenset([rival] if rival else [])
    against = [Against(explained, g, s) for g, s in zip(given, seen, strict=True)]
    return Votes(good, Counter({rival: good} if rival else {}), against, float(len(against)))


def shifted(given: list[Vector], by: Vector) -> list[Vector]:
    return [(x + by[0], y + by[1]) for x, y in given]


PAN = [(3.0, 0.5)] * 12
TURN = [(2.4 * float(np.cos(k)), 2.4 * float(np.sin(k))) for k in range(12)]


@pytest.mark.parametrize("given", [PAN, TURN])
def test_shifts_that_differ_from_pair_to_pair_are_jitter(given: list[Vector]) -> None:
    shifts = [(1.0, 1.0), (-1.0, 1.2), (0.9, -1.1), (-1.3, -0.8)]
    judgement = judge_votes([pair(given, shifted(given, shift)) for shift in shifts])
    assert judgement.verdict == "undecidable"
    assert "camera jitter" in judgement.reason


def test_one_shift_of_a_picture_that_turns_is_jitter() -> None:
    """In a clip of two frames there is one pair, but what wrong vectors lack would turn with them."""
    assert judge_votes([pair(TURN, shifted(TURN, (1.0, -1.0)))]).verdict == "undecidable"


def test_shifts_of_one_pair_among_many_are_no_evidence() -> None:
    """The convention explains these shifts by chance: half of the pairs that vote show them, and hardly any others."""
    pairs = [pair(PAN, shifted(PAN, (0.0, -1.5)), 20, Y_UP), Votes(good=8, good_by=Counter({Y_UP: 8}))]
    assert judge_votes(pairs).verdict == "undecidable"


def test_a_few_small_contradictions_do_not_excuse_many_large_ones() -> None:
    found = [pair(PAN, shifted(PAN, shift), 10) for shift in ((9.0, -7.0), (-8.0, 11.0), (1.0, -1.0))]
    assert judge_votes(found).verdict == "implausible"


@pytest.mark.parametrize("given", [PAN, TURN])
@pytest.mark.parametrize("pairs", [1, 2, 5])
def test_short_vectors_of_half_their_length_fail(given: list[Vector], pairs: int) -> None:
    """What they lack is as short as jitter, but follows from them, and in all pairs alike: also if a camera shakes."""
    turns = [given, [(-y, x) for x, y in given], [(-x, -y) for x, y in given], given, given][:pairs]
    found = [pair([(x / 2, y / 2) for x, y in true], true) for true in turns]
    judgement = judge_votes(found)
    assert judgement.verdict == "implausible"
    assert "2 times too short" in judgement.reason


def test_another_sign_of_a_short_component_is_named() -> None:
    true = [(3.0, 0.9)] * 12
    found = [pair([(x, -y) for x, y in true], true, rival=Y_UP)] * 3
    assert "sign of y" in judge_votes(found).reason


def wave_frame(index: int, jitter: Vector, factor: float = 1.0) -> Frame:
    """A fine texture that a camera pans along, sampled `jitter` beside the centres of its pixels."""
    y, x = np.mgrid[:48, :64] + 0.5
    u, v = x + jitter[0] - 3.6 * index, y + jitter[1] + 1.2 * index
    waves = [np.sin(1.1 * u + 0.3 * v), np.sin(1.2 * v - 0.4 * u), np.sin(0.9 * (u + v))]
    broad = np.stack([np.sin(0.31 * u), np.sin(0.23 * v), np.sin(0.19 * (u - v))])
    channels = {
        "albedo": torch.tensor(0.5 + 0.2 * np.stack(waves) + 0.2 * broad, dtype=torch.float32),
        "motion": factor * torch.tensor([-3.6, 1.2]).view(2, 1, 1).expand(2, 48, 64),
    }
    return Frame({name: values[None] for name, values in channels.items()}, index)


@pytest.mark.parametrize(
    ("jitters", "factor", "verdict"),
    [
        ([(-0.45, 0.45), (0.45, -0.45), (-0.4, 0.45)], 1.0, "undecidable"),
        ([(0.0, 0.0)] * 3, 1.0, "plausible"),
        ([(0.0, 0.0)] * 3, 0.5, "implausible"),
        ([(0.2, -0.1), (-0.1, 0.3), (0.1, 0.0)], 0.5, "implausible"),
    ],
)
def test_pictures_of_a_camera_with_jitter(jitters: Jitters, factor: float, verdict: str) -> None:
    frames = [wave_frame(i, jitter, factor) for i, jitter in enumerate(jitters)]
    pairs = [cell_votes(before, now) for before, now in pairwise(frames)]
    assert judge_votes(pairs).verdict == verdict


def test_votes_against_count_alike_in_large_pictures() -> None:
    """Only a sample of the cells is searched: 40 contradictions found in it stand for hundreds."""
    true = [(4.0, 5.0)] * 40
    small = pair([(4.0, -5.0)] * 40, true, good=80, rival=Y_UP)
    large = pair([(4.0, -5.0)] * 40, true, good=800, rival=Y_UP)
    large.weight_against = 400.0
    for votes in (small, large):
        judgement = judge_votes([votes] * 3)
        assert judgement.verdict == "implausible"
        assert "sign of y" in judgement.reason
    rare = pair([(4.0, -5.0)] * 40, true, good=800, rival=Y_UP)
    assert judge_votes([rare] * 3).verdict == "plausible"
