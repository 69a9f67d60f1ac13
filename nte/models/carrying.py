"""What a network carries from frame to frame, brought to the exposure of the frame that it comes to.

Networks carry light as they see it, exposed, because exposed light has a scale of about 1 whatever the scene's unit is.
So they carry the exposure that belongs to it as well. Where the exposure stays, what is carried stays, bit for bit.
"""

from collections.abc import Callable, Iterable, Mapping

import torch
from torch import Tensor, nn

from nte.color import compress, per_sequence
from nte.recurrence import Recurrent

Conversion = Callable[[Tensor, Tensor], Tensor]  # image, factor of the exposure (N, 1, 1, 1) → image


class Carrying(nn.Module):
    """The step that gathers what is carried, at the exposure of this frame.

    names: recurrent images, in order. converted: how those of them that depend on the exposure follow it. recurrent:
    what the step carries for itself. Features that a network has learned have no unit, and stay as they are. Costs a
    product per component of light.
    """

    def __init__(self, names: Iterable[str], converted: Mapping[str, Conversion]) -> None:
        super().__init__()
        self.names, self.converted = tuple(names), dict(converted)
        self.recurrent = {"previous_exposure": Recurrent("exposure", 0)} if converted else {}

    def forward(self, given: Mapping[str, Tensor]) -> Tensor | None:
        """Return the images of `names` together, (N, C, H, W), or None if there are none.

        given: the network's inputs by name: the images as the previous frame left them, and, if any of them is
        converted, exposure, previous_exposure and reset (N,). Where reset is 1, any values are allowed.
        """
        images = {name: given[name] for name in self.names}
        if self.converted:
            change = torch.where(given["reset"] == 0, given["exposure"] / given["previous_exposure"], 1.0)
            converted = self.converted.items()
            images |= {name: convert(images[name], per_sequence(change)) for name, convert in converted}
        return torch.cat(list(images.values()), 1) if images else None


def scaled(light: Tensor, change: Tensor) -> Tensor:
    """Convert exposed light (N, C, H, W) to another exposure. change (N, 1, 1, 1): its factor."""
    return light * change


def compressed_moments(moments: Tensor, change: Tensor) -> Tensor:
    """Convert the means (N, 2, H, W) of y = log(1 + x) and of y², for exposed x, to another exposure.

    change (N, 1, 1, 1): its factor k. The mean becomes log(1 + k·(exp(y) − 1)), and the deviation is multiplied by the
    derivative of that. This is exact for values that do not vary, and of first order in their deviation.
    """
    mean, square = moments[:, :1], moments[:, 1:]
    exposed = (mean.exp() - 1) * change  # ONNX has no expm1
    slope = mean.exp() * change / (1 + exposed)
    mean, variance = compress(exposed), (square - mean.square()) * slope.square()
    return torch.cat([mean, mean.square() + variance], 1)
