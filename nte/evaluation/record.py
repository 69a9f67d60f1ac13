"""What the viewer gets of a frame: its channels, the outputs of denoisers, their FLIP maps and kernels.

Needs NumPy only.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nte.frames.channels import CHANNELS, reference_of
from nte.frames.frame import Array, Frame
from nte.viewer.recorder import INPUT, REFERENCE, Layer, Recorder

if TYPE_CHECKING:
    from nte.models.applied import Application

DISOCCLUDED = "disoccluded"


def record_frame(recorder: Recorder, frame: Frame, targets: Sequence[str], disoccluded: Array | None = None) -> None:
    """Record the stored channels of a frame of batch 1, those that the recording wants.

    targets: what is denoised; their noisy input and reference are images, other channels are not compared. Without
    targets that is color. disoccluded: bool (1, 1, H, W), recorded as a channel.
    """
    images = {name: Layer("image", INPUT, name) for name in targets or ("color",)}
    images |= {reference_of(name): Layer("image", REFERENCE, name) for name in targets or ("color",)}
    wanted = recorder.recording.channels
    for name, values in frame.channels.items():
        layer = images.get(name, Layer("channel", name, name))
        if CHANNELS[name].storage != "derived" and (name in images or wanted is None or name in wanted):
            recorder.add(frame.index, layer, _image(values))
    if disoccluded is not None:
        recorder.add(frame.index, Layer("channel", DISOCCLUDED, DISOCCLUDED), _image(disoccluded * 1.0))


def record_output(
    recorder: Recorder, index: int, spec: str, target: str, output: Array, flip: Array | None = None
) -> None:
    """Record a denoiser's image (1, C, H, W) of a target, and its FLIP map (1, 1, H, W), in 256 levels."""
    recorder.add(index, Layer("image", spec, target), _image(output))
    if flip is not None:
        levels = np.rint(np.clip(_image(flip), 0, 1) * 255).astype(np.uint8)
        recorder.add(index, Layer("flip", spec, target), levels)


def record_extras(recorder: Recorder, index: int, spec: str, extras: Mapping[str, Array]) -> None:
    """Record what a denoiser gives besides its image, such as the length of its history: name → (1, C, H, W)."""
    for name, values in extras.items():
        image = _image(values * 1.0)  # masks become numbers
        if image.ndim == 3:
            recorder.add(index, Layer("extra", spec, name), image)


def record_kernels(
    recorder: Recorder, index: int, spec: str, components: Sequence[str], applications: "Sequence[Application]"
) -> None:
    """Record the kernels that a denoiser's networks applied to a frame, if those of this frame are kept.

    components: the light components that the denoiser has. applications: what `nte.models.applied.overheard` found.
    """
    size = sum(2 * one.number for one in applications)  # half floats
    if not size or not recorder.keeps_kernels(index, spec, size):
        return
    several = [""] if len(applications) == 1 else map(str, range(1, len(applications) + 1))
    lights = components if len(components) == len(applications) else several
    for light, application in zip(lights, applications, strict=True):
        for name, every, weights, further in application.applied(*recorder.size):
            layer = Layer("kernel", spec, f"{light} {name}".strip(), every, further)
            recorder.add(index, layer, weights.cpu().numpy())


def _image(values: Array) -> npt.NDArray[np.generic]:
    """Return the first image (C, H, W) of a batch, NumPy or PyTorch."""
    array: npt.NDArray[np.generic] = values[0].detach().cpu().numpy() if hasattr(values, "detach") else values[0]
    return array
