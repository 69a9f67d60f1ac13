"""Which of the channel maps that ship fits a file of another renderer?"""

from pathlib import Path

from nte.errors import NteError
from nte.frames.exr import read_parts
from nte.importing.channel_map import MAPS, load_channel_map
from nte.importing.layers import choose, find, find_prefix

_TELLING = 2  # channels besides color, at least, that a map must find: `R G B` alone is every picture


def recognise(path: Path) -> str:
    """The name of the map that finds most channels in a file; raises NteError where none does, or several do alike."""
    fitting: dict[str, int] = {}
    parts = read_parts(path)
    for file in sorted(MAPS.glob("*.yaml")):
        how = load_channel_map(file)
        try:
            stored = choose(path, parts, how.channels["color"])
            prefix = how.prefix
            if prefix == "*":
                prefix = find_prefix(path, stored, "color", how.channels["color"], how.prefix_not)
        except NteError:
            continue
        sources = {name: source for name, source in how.channels.items() if not source.file}
        found = [name for name, source in sources.items() if find(stored, name, source, prefix)]
        if "color" in found and len(found) > _TELLING:
            fitting[file.stem] = len(found)
    best = [name for name, count in fitting.items() if count == max(fitting.values())]
    if len(best) == 1:
        return best[0]
    have = sorted({name.rpartition(".")[0] or name for part in parts for name in part.layers})
    what = f"fits the maps {' and '.join(best)} alike" if best else "has no channel of ours, such as color.R"
    known = ", ".join(sorted(file.stem for file in MAPS.glob("*.yaml")))
    raise NteError(f"{path}: {what}; it has {', '.join(have)[:200]}: say how to read it with --map, a file or {known}")
