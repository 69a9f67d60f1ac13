"""Choice of the parts and views of a foreign EXR file that hold a channel."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.frames.exr import Part, merge_parts, split_views
from nte.frames.exr_copy import Place
from nte.importing.layers import Found, Stored
from nte.importing.source import Source


def choose(path: Path, parts: Sequence[Part], source: Source) -> Stored:
    """Choose the channels of the part and view that `source` names: full layered name → (H, W).

    Without a name all parts, or all views, are merged. Raises NteError for a part or view that the file does not have,
    and for a name that two of the merged parts have.
    """
    chosen = _chosen(path, parts, source)
    if source.part:
        return merge_parts(path, [part._replace(name="") for part in chosen])
    try:
        return merge_parts(path, chosen)
    except NteError as error:
        key = "view=NAME" if any(part.view for part in chosen) else "part=NAME"
        raise NteError(f"{error} in the channel map, or with {key}") from error


def without_view(parts: Sequence[Part], source: Source) -> Source:
    """Return `source` without its view if a file has no views at all: there is nothing to choose."""
    return source if any(part.view or part.views for part in parts) else replace(source, view="")


def part_name(path: Path, parts: Sequence[Part], source: Source) -> str:
    """Name the part that `source` chooses, perhaps by its number; empty if it chooses none. Raises as `choose` does."""
    return _chosen(path, parts, source)[0].name if source.part else ""


def _chosen(path: Path, parts: Sequence[Part], source: Source) -> list[Part]:
    """The parts, or their views, that `source` names. A number is that of a part in the file, of whatever view."""
    cut = (split_views(path, [part]) if source.view else [part] for part in parts)
    chosen = [(number, part) for number, of_part in enumerate(cut) for part in of_part]
    if source.view:
        views = sorted({part.view for _, part in chosen} - {""})
        if source.view not in views:
            raise NteError(f"{path}: no view '{source.view}'; the file has {', '.join(views) or 'no views'}")
        chosen = [(number, part) for number, part in chosen if part.view in ("", source.view)]
    if not source.part:
        return [part for _, part in chosen]
    index = int(source.part) if source.part.isdecimal() else None
    named = [part for _, part in chosen if part.name == source.part]
    if found := named or [part for number, part in chosen if number == index]:
        return found
    names = ", ".join(part.name for _, part in chosen if part.name) or "one part"
    of_view = f" of view '{source.view}'" if source.view else ""
    raise NteError(f"{path}: no part '{source.part}'{of_view}; the file has {names}")


def places(path: Path, parts: Sequence[Part], source: Source) -> Mapping[str, Place]:
    """Locate each channel that `choose` returns: full layered name → number of its part, and its name in that part.

    Raises NteError as `choose` does.
    """
    numbered: list[Any] = [part._replace(layers={n: (i, n) for n in part.layers}) for i, part in enumerate(parts)]  # type: ignore[misc]
    return choose(path, numbered, source)  # type: ignore[return-value]  # looks at no pixels


def outside(path: Path, parts: Sequence[Part], source: Source, found: Found) -> npt.NDArray[np.bool_] | None:
    """Mark the pixels (H, W) of a channel that lie outside the data windows of its layers; None if there are none.

    Nothing is stored there: the layers' zeros are no values, and must not be decoded.
    """
    if all(part.outside is None for part in parts):
        return None

    def mask(part: Part, pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.bool_]:
        return np.zeros(pixels.shape, np.bool_) if part.outside is None else part.outside

    marked = [part._replace(layers={name: mask(part, p) for name, p in part.layers.items()}) for part in parts]
    masks = choose(path, marked, source)
    empty = [np.any([masks[name] for name in names], axis=0) for names in found.names]
    return np.asarray(np.all(empty, axis=0))
