"""What a page and its layers hold, read without a browser."""

import base64
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

_TYPES = {"byte": "u1", "half": "<f2", "float": "<f4"}


def data_of(html: str) -> dict[str, Any]:
    """The data that a page's script reads."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found
    data: dict[str, Any] = json.loads(found[1])
    return data


def read_script(text: str) -> tuple[str, npt.NDArray[np.generic]]:
    """The name and the values (C, H, W) of a layer's script."""
    found = re.fullmatch(r'nteLayer\((".*?"),(\{.*?\}),"([A-Za-z0-9+/=]*)"\);\n', text)
    assert found
    about = json.loads(found[2])
    kind = np.dtype(_TYPES[about["type"]])
    planes = np.frombuffer(zlib.decompress(base64.b64decode(found[3])), np.uint8).reshape(kind.itemsize, -1)
    values = np.ascontiguousarray(planes.T).reshape(-1).view(kind).reshape(about["shape"])
    return json.loads(found[1]), values.transpose(2, 0, 1)


def layer_of(data: dict[str, Any], group: str, of: str, channel: str = "color", clip: int = 0) -> dict[str, Any]:
    """The description of one layer of a clip."""
    (found,) = (
        layer
        for layer in data["clips"][clip]["layers"]
        if (layer["group"], layer["of"], layer["channel"]) == (group, of, channel)
    )
    return found


def pixels_of(page: Path, frame: int, group: str, of: str, channel: str = "color") -> npt.NDArray[np.generic]:
    """The values (C, H, W) of a layer in a frame of a page's first clip."""
    data = data_of(page.read_text("utf-8"))
    layer = layer_of(data, group, of, channel)
    folder = page.parent / data["folder"] / data["clips"][0]["folder"] / layer["key"]
    name, values = read_script((folder / f"{frame:04d}.js").read_text("ascii"))
    assert name == f"{data['clips'][0]['folder']}/{layer['key']}/{frame:04d}"
    return values
