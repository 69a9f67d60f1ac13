"""Which of the channel maps that ship fits a file of another renderer?"""

from pathlib import Path

from nte.errors import NteError
from nte.frames.exr import merge_parts, read_parts, split_views
from nte.importing.channel_map import MAPS, load_channel_map
from nte.importing.layers import Stored, find, prefixes

_TELLING = 2  # channels besides color, at least, that a map must find: `R G B` alone is every picture


def recognise(path: Path) -> str:
    """The name of the map that finds most channels in a file; raises NteError where none does, or several do alike.

    Of several views or view layers the first one is looked at: which of them is meant is another question.
    """
    fitting: dict[str, int] = {}
    stored = _first_view(path)
    for file in sorted(MAPS.glob("*.yaml")):
        how = load_channel_map(file)
        prefix = how.prefix
        if prefix == "*":
            prefix = next(iter(prefixes(stored, "color", how.channels["color"], how.prefix_not)), "")
        sources = {name: source for name, source in how.channels.items() if not source.file}
        found = [name for name, source in sources.items() if find(stored, name, source, prefix)]
        # A layer below a layer, as in ViewLayer.Combined.R, tells enough by itself.
        if "color" in found and (prefix or len(found) > _TELLING):
            fitting[file.stem] = len(found)
    best = [name for name, count in fitting.items() if count == max(fitting.values())]
    if len(best) == 1:
        return best[0]
    have = sorted({name.rpartition(".")[0] or name for name in stored})
    what = f"fits the maps {' and '.join(best)} alike" if best else "has no channel of ours, such as color.R"
    known = ", ".join(sorted(file.stem for file in MAPS.glob("*.yaml")))
    raise NteError(f"{path}: {what}; it has {', '.join(have)[:200]}: say how to read it with --map, a file or {known}")


def _first_view(path: Path) -> Stored:
    parts = split_views(read_parts(path))
    first = next((part.view for part in parts if part.view), "")
    return merge_parts(path, [part for part in parts if part.view in ("", first)])
