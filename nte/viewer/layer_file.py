"""One image of one frame as a script, since a page that is opened from disk may load scripts and nothing else.

The script calls `nteLayer(name, {type, shape}, data)`. The data are the values (H, W, C), little-endian, taken apart
into their bytes (first the lowest byte of every value, then the next, …), compressed with zlib, and written in base64.
Bytes of one significance are alike, so that they compress to about half of what the values do.
"""

import base64
import json
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nte.files import make_folder, write_whole
from nte.frames.channels import CHANNELS
from nte.frames.clip import half_keeps

Values = npt.NDArray[np.generic]  # (C, H, W)

_TYPES = {"byte": "u1", "half": "<f2", "float": "<f4"}  # a byte stands for value / 255
_EXACT = ("depth", "point", "id", "motion", "covariance")  # kinds of channels that half floats are too coarse for
_LEVEL = 1  # of zlib: higher ones save a hundredth of noise and take ten times as long


def type_of(channel: str, values: Values) -> str:
    """Choose the type that an image (C, H, W) is stored in: byte for uint8, float where a half float loses something.

    channel: its name in the table of channels; a vector field of another name is stored as floats as well.
    """
    if values.dtype == np.uint8:
        return "byte"
    row = CHANNELS.get(channel)
    exact = len(values) == 2 if row is None else row.kind in _EXACT
    return "float" if exact or not half_keeps(np.asarray(values, np.float32), dark_counts=False) else "half"


def layer_script(name: str, values: Values, kind: str) -> str:
    """Make the script that hands an image (C, H, W) to the page. kind: byte, half or float."""
    pixels = np.ascontiguousarray(values.transpose(1, 2, 0), _TYPES[kind])
    apart = pixels.reshape(-1).view(np.uint8).reshape(-1, pixels.itemsize).T
    data = base64.b64encode(zlib.compress(apart.tobytes(), _LEVEL)).decode("ascii")
    about = json.dumps({"type": kind, "shape": pixels.shape})
    return f'nteLayer({json.dumps(name)},{about},"{data}");\n'


def write_layer(path: Path, name: str, values: Values, kind: str) -> None:
    """Write an image (C, H, W) as a script. Raises NteError if it cannot be written.

    A page may have ten thousand of them: with a wait for the disk and a look for leftovers each took 10 ms more on a
    busy machine, against 1 ms for its other name. `nte.viewer.page.clear` sweeps their folders.
    """
    make_folder(path.parent)
    script = layer_script(name, values, kind)
    write_whole(path, lambda temporary: temporary.write_text(script, encoding="ascii"), of_many=True)
