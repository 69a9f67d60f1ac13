"""Loading of a user's own scene as it is: the XML needs no names and no changes for nte."""

import os
import re
from itertools import chain, count
from pathlib import Path

import numpy as np

from nte.errors import NteError
from nte.render.engine.backend import load_mitsuba
from nte.render.engine.types import MitsubaScene, Struct
from nte.render.world.keyframes import Animation

_DEEPEST = 100  # elements within each other: from some thousand on Mitsuba's parser ends the process
_TAG = re.compile(rb"""<(/?)[^\s<>/!?](?:"[^"]*"|'[^']*'|[^"'<>/]|/(?!>))*(/?)>""")
_NO_TAGS = re.compile(rb"<!--.*?(?:-->|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|<\?.*?(?:\?>|\Z)", re.DOTALL)
_ADDED = re.compile(rb"""<path\b[^<>]*?\bvalue\s*=\s*["']([^"'$]+)["']""")
_INCLUDED = re.compile(rb"""<include\b[^<>]*?\bfilename\s*=\s*["']([^"'$]+)["']""")
_Loaded = tuple[MitsubaScene, bool]
_kept: dict[str, _Loaded] = {}  # at most one scene: the one that was loaded for a check, until it is rendered


def load_xml(animation: Animation, keep: bool = False) -> _Loaded:
    """Load the mi.Scene of an animation's XML, and say whether it contains media.

    keep: keep the scene for the next call, which reuses it if the XML and its values are the same. Raises NteError,
    in Mitsuba's own words, for what Mitsuba cannot load.
    """
    key = repr((animation.xml, os.stat(animation.xml).st_mtime_ns, sorted(animation.values.items())))
    loaded = _kept.pop(key, None) or _load(animation)
    forget_scene()
    if keep:
        _kept[key] = loaded
    return loaded


def forget_scene() -> None:
    """Let go of a scene that was kept: beside it, other scenes could not be recorded (see Scenery.frozen)."""
    _kept.clear()


def _load(animation: Animation) -> _Loaded:
    mi = load_mitsuba()
    config = mi.parser.ParserConfig(mi.variant())
    # Merging shapes of one material would lose their names.
    config.merge_meshes = config.merge_equivalent = False
    # Serially: when a plugin fails, what other threads are still building outlives the failure, and a later rendering
    # of a medium in the same process crashed.
    config.parallel = False
    usual = mi.file_resolver()
    beside = mi.FileResolver(usual)  # the XML's own folder first; a <path> in it adds others
    beside.prepend(str(Path(animation.xml).parent.absolute()))
    mi.set_file_resolver(beside)
    try:
        _require_shallow(animation.xml, beside)
        state = mi.parser.parse_file(config, animation.xml, **animation.values)
        mi.parser.transform_all(config, state)
        _drop_unused(state)
        _name_all(state)
        _require_transforms(animation.xml, state)
        _require_files(animation.xml, state, beside)
        media = any(node.type == mi.ObjectType.Medium for node in _used(state))
        made = mi.parser.instantiate(config, state)
    except UnicodeDecodeError as error:
        raise NteError(f"{animation.xml}: holds a name that is not UTF-8: save it in UTF-8") from error
    except (RuntimeError, TypeError) as error:  # Mitsuba's exceptions for a faulty scene
        # Where the first line ends in a colon, the second line names the subject.
        first, *more = (line.strip() for line in str(error).strip().splitlines())
        text = f"{first} {more[0]}" if more and first.endswith(":") else first
        raise NteError(f"{animation.xml}: {text.partition('] ')[2] if text.startswith('[') else text}") from error
    finally:
        mi.set_file_resolver(usual)
    scene = made[0] if isinstance(made, list) else made
    if not isinstance(scene, mi.Scene):
        raise NteError(f"{animation.xml}: holds no <scene>: expected a Mitsuba scene")
    return scene, media


def _require_shallow(xml: str, resolver: Struct) -> None:
    """Raise NteError for elements that are nested too deeply, also in a file that this one includes.

    Only tags are looked at: all else is for Mitsuba to judge.
    """
    ahead, seen = [Path(xml)], set[Path]()
    looking = load_mitsuba().FileResolver(resolver)  # as Mitsuba's parser does, in the folders of each <path>, too
    while ahead:
        path = ahead.pop()
        if path in seen or not path.is_file():
            continue
        seen.add(path)
        content = _NO_TAGS.sub(b"", path.read_bytes().replace(b"\0", b""))  # as a text of 16 bits has between letters
        depth = 0
        for end, empty in _TAG.findall(content):
            depth += 0 if empty else -1 if end else 1
            if depth > _DEEPEST:
                raise NteError(f"{path}: nested too deeply: expected fewer than {_DEEPEST} elements within each other")
        for folder in _ADDED.findall(content):
            looking.prepend(str(looking.resolve(os.fsdecode(folder))))
        ahead += [Path(str(looking.resolve(os.fsdecode(name)))) for name in _INCLUDED.findall(content)]


def _require_files(xml: str, state: Struct, resolver: Struct) -> None:
    """Raise NteError for a mesh or texture that is no file: a device or a pipe is read without end."""
    for node in _used(state):
        if "filename" in node.props:
            path = Path(str(resolver.resolve(str(node.props["filename"]))))
            if path.exists() and not path.is_file():
                raise NteError(f"{xml}: filename {path} is no file: expected a mesh, a texture or the like")


def _drop_unused(state: Struct) -> None:
    """Remove from the parsed XML what nte does not use, so that plugins which this Mitsuba lacks do no harm there.

    Removed are integrators, samplers, everything of films except the size (a field of view may depend on it),
    sensors after the first, sensors that are shapes, and materials, textures and media that no shape or light uses.
    """
    kinds = load_mitsuba().ObjectType
    sensors = 0
    for node in state.nodes:
        for key, child in _children(state, node):
            unused = child.type in (kinds.Integrator, kinds.Sampler)
            if node.type == kinds.Shape:
                unused = child.type == kinds.Sensor
            elif node.type == kinds.Scene:
                sensors += child.type == kinds.Sensor
                unused = child.type not in (kinds.Shape, kinds.Emitter, kinds.Sensor)
                unused |= child.type == kinds.Sensor and sensors > 1
            if unused:
                del node.props[key]
            elif child.type == kinds.Film:
                _plain_film(child)


def _plain_film(film: Struct) -> None:
    """Replace a film of any kind by an hdrfilm of the same size."""
    film.props.set_plugin_name("hdrfilm")
    for key in [key for key in film.props.keys() if key not in ("width", "height")]:  # noqa: SIM118
        del film.props[key]


def _used(state: Struct) -> list[Struct]:
    """The nodes that the scene still refers to, directly or through others."""
    found: dict[int, Struct] = {}
    ahead = [state.root]
    while ahead:
        fresh = {id(child): child for _, child in _children(state, ahead.pop()) if id(child) not in found}
        found |= fresh
        ahead += fresh.values()
    return list(found.values())


def _name_all(state: Struct) -> None:
    """Name the shapes and lights that have no id, so that the XML needs no editing.

    The name is that of the shape's file, else its kind; the second of a name gets _2.
    """
    mi = load_mitsuba()
    taken = {node.props.id() for node in state.nodes}
    for _, node in _children(state, state.root):
        if node.type in (mi.ObjectType.Shape, mi.ObjectType.Emitter) and not node.props.id():
            is_file = node.type == mi.ObjectType.Shape and "filename" in node.props
            name = Path(node.props["filename"]).stem if is_file else str(node.props.plugin_name())
            name = name.replace(".", "_")  # dots separate the names of Mitsuba's parameters
            chosen = next(n for n in chain([name], (f"{name}_{i}" for i in count(2))) if n not in taken)
            node.props.set_id(chosen)
            taken.add(chosen)


def _require_transforms(xml: str, state: Struct) -> None:
    """Raise NteError for a shape or camera with a singular transform, from which Mitsuba would compute NaN."""
    mi = load_mitsuba()
    for node in state.nodes:
        if node.type in (mi.ObjectType.Shape, mi.ObjectType.Sensor) and "to_world" in node.props:
            turn = np.array(node.props["to_world"].matrix, float).reshape(4, 4)[:3, :3]
            if not np.isfinite(turn).all() or abs(np.linalg.det(turn)) <= 1e-9 * np.linalg.norm(turn) ** 3:
                name = node.props.id() or node.props.plugin_name()
                raise NteError(f"{xml}: the to_world of '{name}' is singular: expected no scale of 0")


def _children(state: Struct, node: Struct) -> list[tuple[str, Struct]]:
    """The nodes that a node of the parsed XML refers to, by the names of its properties.

    Reads references only: Mitsuba treats a property that was read as known, and would no longer report a misspelt one.
    """
    reference = load_mitsuba().Properties.Type.ResolvedReference
    keys = [key for key in node.props.keys() if node.props.type(key) == reference]  # noqa: SIM118
    return [(key, state.nodes[node.props[key].index()]) for key in keys]
