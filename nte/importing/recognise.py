"""Choice of the shipped channel map that fits a file of another renderer."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from nte.errors import NteError
from nte.frames.exr import merge_parts, read_parts, split_views
from nte.importing.channel_map import MAPS, ChannelMap, load_channel_map
from nte.importing.layers import Stored, find, prefixes

_TELLING = 2  # least number of channels besides color that a map must find: every picture has `R G B`
# Names in maps that many engines give to channels of any convention: alone they tell no renderer.
_COMMON = {
    *"RGBZNP", "RGBA", "rgba", "rgb", "beauty", "image", "albedo", "basecolor", "emission", "normal", "normals",
    "depth", "position", "ID", "objectid", "velocity", "motionvector", "motionvectors", "MV",
}  # fmt: skip


def recognise(path: Path) -> str:
    """Name the shipped channel map that finds most channels in a file.

    Of several views or view layers only the first is looked at. Raises NteError for a file that cannot be read, that
    no map fits, that has only names which many engines use, or that several maps fit equally well.
    """
    fitting: dict[str, int] = {}
    common = False
    stored = _first_view(path)
    for map_name, how in _shipped_maps().items():
        prefix = how.prefix
        if prefix == "*":
            prefix = next(iter(prefixes(stored, "color", how.channels["color"], how.prefix_not)), "")
        sources = {name: source for name, source in how.channels.items() if not source.file}
        found = {name: place for name, source in sources.items() if (place := find(stored, name, source, prefix))}
        layers = {
            full.rpartition(".")[0] or full for place in found.values() for names in place.names for full in names
        }
        # A layer below a layer, as in ViewLayer.Combined.R, is evidence enough.
        if "color" in found and (prefix or len(found) > _TELLING):
            if layers <= _COMMON:
                common = True
            else:
                fitting[map_name] = len(found)
    best = [name for name, count in fitting.items() if count == max(fitting.values())]
    if len(best) == 1:
        return best[0]
    have = sorted({name.rpartition(".")[0] or name for name in stored})
    nothing = "has names that many engines use" if common else "has no channel of ours, such as color.R"
    what = f"fits the maps {' and '.join(best)} alike" if best else nothing
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
