"""Loading somebody else's scene as it is: nothing in the XML needs a name or a change for nte's sake."""

from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from nte.errors import NteError
from nte.render.animation import Animation
from nte.render.backend import load_mitsuba


def load_xml(animation: Animation) -> tuple[Any, bool]:
    """The mi.Scene of an animation's XML, and whether there are media in it.

    Raises NteError for what Mitsuba does not load, in its own words.
    """
    mi = load_mitsuba()
    config = mi.parser.ParserConfig(mi.variant())
    # Merging shapes of one material would lose their names.
    config.merge_meshes = config.merge_equivalent = False
    # One after the other: what other threads still build when one fails outlived the failure, and a later rendering of
    # a medium in the same process died of it.
    config.parallel = False
    usual = mi.file_resolver()
    beside = mi.FileResolver(usual)  # the XML's own folder first; a <path> in it adds others
    beside.prepend(str(Path(animation.xml).parent.absolute()))
    mi.set_file_resolver(beside)
    try:
        state = mi.parser.parse_file(config, animation.xml, **animation.values)
        mi.parser.transform_all(config, state)
        _drop_unused(state)
        _name_all(state)
        _check_transforms(animation.xml, state)
        made = mi.parser.instantiate(config, state)
        media = any(node.type == mi.ObjectType.Medium for node in state.nodes)
    except (RuntimeError, TypeError) as error:  # how Mitsuba says that something is wrong with a scene
        # Where the first line ends in a colon, the second says what it is about.
        first, *more = (line.strip() for line in str(error).strip().splitlines())
        text = f"{first} {more[0]}" if more and first.endswith(":") else first
        raise NteError(f"{animation.xml}: {text.partition('] ')[2] if text.startswith('[') else text}") from error
    finally:
        mi.set_file_resolver(usual)
    scene = made[0] if isinstance(made, list) else made
    if not isinstance(scene, mi.Scene):
        raise NteError(f"{animation.xml}: holds no <scene>: expected a Mitsuba scene")
    return scene, media


def _drop_unused(state: Any) -> None:
    """Take the integrator and the samplers, which are nte's own, out of the parsed XML: plugins that this Mitsuba has
    not, or has no more, are no obstacle there."""
    mi = load_mitsuba()
    for node in state.nodes:
        if node.type in (mi.ObjectType.Scene, mi.ObjectType.Sensor):
            for key, child in _children(state, node):
                if child.type in (mi.ObjectType.Integrator, mi.ObjectType.Sampler):
                    del node.props[key]


def _name_all(state: Any) -> None:
    """Give shapes and lights of the scene that have no id one: the name of its file, else its kind; the second of
    a name gets _2. So the XML needs no editing."""
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


def _check_transforms(xml: str, state: Any) -> None:
    """Raise NteError for a shape or camera that is flattened to nothing, of which Mitsuba would make NaN."""
    mi = load_mitsuba()
    for node in state.nodes:
        if node.type in (mi.ObjectType.Shape, mi.ObjectType.Sensor) and "to_world" in node.props:
            turn = np.array(node.props["to_world"].matrix, float).reshape(4, 4)[:3, :3]
            if not np.isfinite(turn).all() or abs(np.linalg.det(turn)) <= 1e-9 * np.linalg.norm(turn) ** 3:
                name = node.props.id() or node.props.plugin_name()
                raise NteError(f"{xml}: the to_world of '{name}' is singular: expected no scale of 0")


def _children(state: Any, node: Any) -> list[tuple[str, Any]]:
    """The nodes that a node of the parsed XML refers to, by the names of its properties."""
    reference = load_mitsuba().Properties.ResolvedReference
    found = [(key, value) for key, value in node.props.items() if isinstance(value, reference)]
    return [(key, state.nodes[value.index()]) for key, value in found]
