"""Depth and cameras predict the vectors of what stands still, unless one of them has another unit or convention."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from nte.checking.cameras import Prediction, judge_cameras, prediction
from nte.frames.frame import Frame
from tests.checking.room import Floats
from tests.checking.test_geometry import FRAMES, cameras


def predictions(
    scale: float = 1.0, change: Floats | None = None, longer: tuple[float, float] = (1, 1)
) -> list[Prediction]:
    """Of the room with its depth times `scale`, views that `change` is applied to, and vectors times `longer`."""
    turned = np.eye(4) if change is None else change
    times = torch.tensor(longer).view(1, 2, 1, 1)
    given = cameras(lambda view, projection: (turned @ view, projection))
    frames = [
        Frame(
            {"depth": torch.tensor(scale * f["depth"])[None], "motion": torch.tensor(f["motion"])[None] * times},
            i,
            **{name: torch.tensor(matrix, dtype=torch.float64)[None] for name, matrix in given[i].items()},  # type: ignore[arg-type]
        )
        for i, f in enumerate(FRAMES)
    ]
    return [found for pair in pairwise(frames) if (found := prediction(*pair)) is not None]


def test_right_cameras_predict_what_stands_still() -> None:
    found = predictions()
    assert len(found) == len(FRAMES) - 1
    assert all(pair.agree > 0.8 for pair in found)  # the ball moves
    assert not list(judge_cameras(found))


@pytest.mark.parametrize(("scale", "change"), [(30.0, None), (1 / 30, None), (1.0, np.diag([-1.0, 1, 1, 1]))])
def test_another_unit_or_axis_is_a_doubt(scale: float, change: Floats | None) -> None:
    (finding,) = judge_cameras(predictions(scale, change))
    assert finding.doubt
    assert not finding.fault
    assert "wrong" in finding.found


@pytest.mark.parametrize("longer", [(1.3, 1.3), (0.5, 0.5), (1.0, 0.0), (0.0, 1.0), (1.78, 1.0), (1.0, -1.0)])
def test_vectors_of_another_length_or_without_an_axis_are_a_doubt(longer: tuple[float, float]) -> None:
    (finding,) = judge_cameras(predictions(longer=longer))
    assert (finding.channel, finding.doubt, finding.fault) == ("motion", True, False)
    x, y = longer
    assert finding.found.startswith(f"{x:.3g} times as long in x and {y:.3g} times in y as depth and cameras show")


def test_a_camera_at_rest_predicts_nothing() -> None:
    depth, motion = torch.full((1, 1, 40, 60), 5.0), torch.full((1, 2, 40, 60), 3.0)
    eye = torch.eye(4, dtype=torch.float64)[None]
    frames = [Frame({"depth": depth, "motion": motion}, i, view=eye, projection=eye) for i in range(2)]
    assert prediction(*frames) is None
    assert not list(judge_cameras([]))


def test_cameras_far_from_the_origin_accuse_no_vectors() -> None:
    """Places are kept as 32-bit floats: a thousand kilometres away they have steps of 6 cm, and more."""
    place = np.array([1e6, -7e5, 3e5])

    def predicted(given: list[dict[str, object]]) -> list[Prediction]:
        frames = [
            Frame(
                {name: torch.tensor(f[name])[None] for name in ("depth", "motion")},
                i,
                **{name: torch.tensor(matrix).float()[None] for name, matrix in given[i].items()},  # type: ignore[arg-type]
            )
            for i, f in enumerate(FRAMES)
        ]
        return [found for pair in pairwise(frames) if (found := prediction(*pair)) is not None]

    def moved(view: Floats, projection: Floats) -> tuple[Floats, Floats]:
        away = view.copy()
        away[:3, 3] -= view[:3, :3] @ place
        return away, projection

    assert len(predicted(cameras(lambda view, projection: (view, projection)))) == len(FRAMES) - 1
    assert not list(judge_cameras(predicted(cameras(moved))))
