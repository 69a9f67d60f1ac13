"""Imports run one way: the layers of nte, bottom to top, and those of nte.render. Imports inside functions count."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import nte

ROOT = Path(nte.__file__).parent

# A module may import what stands in rows above its own here, and what is in its own package; not its neighbours in a
# row. A package stands for all of its modules. Rows may name what is not there yet.
LAYERS = (
    "memory version",
    "errors shipped released",
    "files",
    "config console elsewhere interrupt machine options overlap progress text_table writers",
    "frames jobs unfinished",
    "cluster color motion",
    "denoiser viewer",
    "session",
    "recurrence",
    "filters models",
    "training",
    "runtime",
    "burst checking estimation info render",
    "importing",
    "sequences",
    "registry",
    "evaluation",
    "cli",
    "__main__",
)

RENDER_LAYERS = ("world", "engine scenes", "passes", "components", "recipes")
MOST_FILES = 12  # in a folder of nte.render

# They offer what users need from above, and import it when it is asked for.
FACADE = ("nte", "nte.render")


def module_of(path: Path) -> str:
    parts = ("nte", *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in sorted(ROOT.rglob("*.py"))}


def imported(module: str) -> Iterator[tuple[str, int]]:
    """The modules of nte that a module imports, anywhere in its text, with the line."""
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}:{node.lineno}: a relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in MODULES else str(node.module) for name in names]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.count("."):
            names = [
                name for name in [node.value.partition(":")[0]] if name in MODULES
            ]  # to be imported when asked for
        else:
            continue
        yield from ((name, node.lineno) for name in names if name.partition(".")[0] == "nte")


IMPORTS = {module: [*imported(module)] for module in MODULES}


def below(prefix: str, module: str) -> str:
    """The part of nte, or of another package, that a module belongs to: motion of nte.motion.warp; '' of nte itself."""
    return module.removeprefix(prefix).removeprefix(".").partition(".")[0]


def upward(prefix: str, layers: tuple[str, ...], exempt: tuple[str, ...] = ()) -> list[str]:
    """Imports between parts of a package that do not lead to a lower layer."""
    rank = {name: number for number, names in enumerate(layers) for name in names.split()}
    wrong = []
    for module, targets in IMPORTS.items():
        if not module.startswith(f"{prefix}.") or module in exempt:
            continue
        here = below(prefix, module)
        for target, line in targets:
            there = below(prefix, target) if target == prefix or target.startswith(f"{prefix}.") else here
            if here != there and not rank.get(there, len(layers)) < rank.get(here, -1):
                wrong.append(f"{module}:{line} imports {target}")
    return wrong


def test_every_part_has_a_layer():
    """A new package or module of nte, or folder of nte.render, has to be put into the tables above."""
    known = {name for names in LAYERS for name in names.split()}
    assert {below("nte", module) for module in MODULES} - {""} <= known
    known = {name for names in RENDER_LAYERS for name in names.split()}
    assert {below("nte.render", module) for module in MODULES if module.startswith("nte.render.")} <= known


def test_nothing_imports_upwards():
    assert not upward("nte", LAYERS, FACADE)


def test_the_layers_of_render():
    assert not upward("nte.render", RENDER_LAYERS)
    assert not [name for name, _ in IMPORTS["nte.render"] if name not in ("nte.errors", "nte.render.recipes.clips")]


def test_there_is_no_circle():
    """Modules that wait for each other; a package's __init__ waits for those that it imports as any module does."""
    ahead = {module: {target for target, _ in targets if target in MODULES} for module, targets in IMPORTS.items()}
    for module in FACADE:
        ahead[module] = set()
    while free := {module for module, targets in ahead.items() if not targets}:
        ahead = {module: targets - free for module, targets in ahead.items() if module not in free}
    assert not ahead, f"a circle is among {sorted(ahead)}"


def test_only_the_backend_imports_mitsuba():
    for module in MODULES:
        for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [str(node.module)]
                assert not {"mitsuba", "drjit"} & {name.partition(".")[0] for name in names}, module


@pytest.mark.parametrize("layer", ["world", "scenes"])
def test_worlds_need_no_mitsuba(layer: str):
    for module, targets in IMPORTS.items():
        if module.startswith(f"nte.render.{layer}"):
            assert not [name for name, _ in targets if name.startswith("nte.render.engine")], module


def test_folders_of_render_are_short():
    folders = [ROOT / "render", *(path for path in (ROOT / "render").rglob("*") if path.is_dir())]
    counts = {folder.relative_to(ROOT).as_posix(): len(list(folder.glob("*.py"))) for folder in folders}
    assert max(counts.values()) <= MOST_FILES, counts
