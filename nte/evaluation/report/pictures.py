"""Clips of which only pictures of 8 bits are kept, such as those of `nte compare`, for the viewer."""

from collections.abc import Sequence
from pathlib import Path

from nte.evaluation.metric_table import Row
from nte.evaluation.score_clip import Shown
from nte.viewer.recorder import FOLDER, Layer, Recorder, Recording

NOTE = (
    "Only one frame of this clip is kept, as a picture of 8 bits: exposure does not change it. "
    "nte view CLIP --denoiser SPEC … shows every frame in linear light."
)


def picture_clips(shown: Sequence[Shown], out: Path) -> list[Row]:
    """Write the pictures of an evaluation to `out`/layers, and describe the clips that they are of."""
    recorders: dict[str, Recorder] = {}
    for one in shown:
        height, width = next(iter(one.images.values())).shape[:2]
        recorder = recorders.get(one.clip)
        if recorder is None:
            recorder = Recorder(Recording(out / FOLDER), one.clip, (height, width), one.frame + 1, 1.0, [NOTE])
            recorders[one.clip] = recorder
        for name, pixels in one.images.items():
            recorder.add(one.frame, Layer("image", name, one.target), pixels.transpose(2, 0, 1))
        for name, pixels in one.flip.items():
            recorder.add(one.frame, Layer("flip", name, one.target), pixels.transpose(2, 0, 1))
    return [recorder.entry() for recorder in recorders.values()]
