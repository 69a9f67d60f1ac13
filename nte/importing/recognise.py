"""Choice of the shipped channel map that fits a file of another renderer."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from nte.errors import NteError
from nte.frames.exr import merge_parts, read_parts, split_views
from nte.importing.channel_map import MAPS, ChannelMap, load_channel_map
from nte.importing.layers import Stored, find, prefixes

_TELLING = 2  # least number of channels besides color that a map must find: every picture has `R G B`


def recognise(path: Path) -> str:
    """Name the shipped channel map that finds most channels in a file.

    Of several views or view layers only the first is looked at. Raises NteError for a file that cannot be read, that
    no map fits, or that several maps fit equally well.
    """
    fitting: dict[str, int] = {}
    stored = _first_view(path)
    for map_name, how in _shipped_maps().items():
        prefix = how.prefix
        if prefix == "*":
            prefix = next(iter(prefixes(stored, "color", how.channels["color"], how.prefix_not)), "")
        sources = {name: source for name, source in how.channels.items() if not source.file}
        found = [name for name, source in sources.items() if find(stored, name, source, prefix)]
        # A layer below a layer, as in ViewLayer.Combined.R, is evidence enough.
        if "color" in found and (prefix or len(found) > _TELLING):
            fitting[map_name] = len(found)
    best = [name for name, count in fitting.items() if count == max(fitting.values())]
    if len(best) == 1:
        return best[0]
    have = sorted({name.rpartition(".")[0] or name for name in stored})
    what = f"fits the maps {' and '.join(best)} alike" if best else "has no channel of ours, such as color.R"
    known = ", ".join(_shipped_maps())
    plain = "; of R, G and B a file with the line 'channels: {color: .}' is enough" if {*"RGB"} <= {*have} else ""
    has = ", ".join(have)[:200]
    raise NteError(f"{path}: {what}; it has {has}: say how to read it with --map, a file or {known}{plain}")


@cache
def _shipped_maps() -> Mapping[str, ChannelMap]:
    """The maps that ship, by name; parsing them takes longer than looking into a file, so they are kept."""
    return {file.stem: load_channel_map(file) for file in sorted(MAPS.glob("*.yaml"))}


def _first_view(path: Path) -> Stored:
    parts = split_views(path, read_parts(path))
    first = next((part.view for part in parts if part.view), "")
    return merge_parts(path, [part for part in parts if part.view in ("", first)])
