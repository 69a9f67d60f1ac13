"""Recipes: YAML files that say which clips to render, and that derive everything random from one seed."""

import os
from collections import Counter
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, get_args

from omegaconf import MISSING

from nte.config import load_config, to_yaml
from nte.errors import NteError, expected_one_of
from nte.render.engine.backend import require_arrays
from nte.render.engine.mesh_stage import MeshStage
from nte.render.engine.stage import Stage
from nte.render.engine.xml.stage import XmlStage, require_scene
from nte.render.passes.rays import Mirrors
from nte.render.passes.shutter import SUBFRAMES
from nte.render.passes.unshadowed import unshadowed_integrator
from nte.render.scenes.families import FAMILIES
from nte.render.world.keyframes import read_animation
from nte.render.world.scene import Scene
from nte.render.world.seeds import derive_generator
from nte.version import __version__

SPLITS = ("train", "test")
START = "start"  # the only parameter of a user's own scene: the first frame of the animation to render
SHARP = "sharp"  # folder of the sharp twins of blurred clips
_AT_LEAST = {
    "clips": 0, "width": 1, "height": 1, "frames": 1, "spp": 1, "seeds": 1, "reference_spp": 2, "max_depth": 2,
}  # fmt: skip
_ONE_OF: dict[str, tuple[str, ...]] = {
    "guides": ("averaged", "centred", "random"), "mirrors": get_args(Mirrors),
}  # fmt: skip
_TOO_MUCH = 2**31  # beyond the renderer's integers


@dataclass
class Group:
    """Clips of one kind."""

    scene: str = "rooms"  # family of scenes, or a YAML file with an animated XML scene (world.keyframes)
    parameters: dict[str, Any] = field(default_factory=dict)  # of the family, by name: the fields of its Parameters
    clips: int = MISSING
    width: int = 128  # pixels
    height: int = 128
    frames: int = 8
    spp: int = 1  # samples per pixel of `color`, per seed
    seeds: int = 1  # independent noise seeds of `color`
    reference_spp: int = 256  # samples per pixel of both halves of the reference together
    components: bool = False  # light separated into components, and shadow and reflection vectors
    shutter: float = 0.0  # open share of the frame, in [0, 1]; above 0, frames are blurred and sharp/ holds sharp twins
    unshadowed: bool = False  # shading without noise: diffuse light of the first hit, without shadows
    guides: str = "averaged"  # means over a pixel (averaged), or one sample that aliases: centred, random
    mirrors: str = "colour"  # what albedo shows of metal and glass: colour, black or white
    max_depth: int = 4  # path segments: 1 sees lights only, 2 direct light, 3 one bounce of indirect light
    # (a scene with a medium raises it by itself, because light scatters often there)


@dataclass
class Recipe:
    """A data set. Clips of `train` and `test` never show the same scene."""

    name: str = MISSING
    seed: int = 0
    train: list[Group] = field(default_factory=list)
    test: list[Group] = field(default_factory=list)


@dataclass(frozen=True)
class ClipPlan:
    """One clip to render: a unit that depends on nothing but these fields."""

    recipe: str
    seed: int
    split: str
    number: int  # among the clips of its family in its split
    group: Group
    sharp: bool = False  # the sharp twin of a blurred clip
    animation: Path | None = None  # the animation of a user's own scene, in place of a family
    start: int = 0  # the animation's frame that becomes the clip's first

    @property
    def name(self) -> str:
        """Return the clip's name, such as train/rooms_003; its randomness is derived from it.

        A sharp twin has the name, and so the randomness, of its blurred clip.
        """
        return f"{self.split}/{scene_name(self.group)}_{self.number:03d}"

    @property
    def folder(self) -> str:
        """Return the clip's folder in the output: train/rooms_003, or sharp/train/rooms_003 for a sharp twin.

        Sharp twins lie apart, so that no split mixes the two kinds.
        """
        return f"{SHARP}/{self.name}" if self.sharp else self.name

    @property
    def blurred(self) -> bool:
        """Return whether the samples of a frame are spread over the shutter."""
        return self.group.shutter > 0 and not self.sharp


def make_stage(unit: ClipPlan) -> Stage:
    """Build the scene of a clip in Mitsuba; the result is the same whenever and wherever it is built."""
    group = unit.group
    how = group.width, group.height, group.max_depth, unshadowed_integrator() if group.unshadowed else None
    if unit.animation is not None:
        return XmlStage(read_animation(unit.animation), *how, unit.start)
    return MeshStage(make_scene(unit), *how)


def make_scene(unit: ClipPlan) -> Scene:
    """Make the scene of a clip from its family."""
    rng = derive_generator(unit.seed, unit.name, "scene")
    return FAMILIES[unit.group.scene](rng, unit.split, unit.group.parameters)


def read_recipe(path: Path) -> Recipe:
    """Read and check a recipe. Raises NteError that names the file and the key, with what was expected."""
    recipe = load_config(Recipe, path)
    if not recipe.train and not recipe.test:
        raise NteError(f"{path}: neither 'train' nor 'test' has a group of clips: expected at least one")
    for split in SPLITS:
        for number, group in enumerate(getattr(recipe, split)):
            _check(f"{path}: {split}[{number}]", group, path.parent)
    return recipe


def recipe_text(recipe: Recipe, folder: Path = Path()) -> str:
    """Return the recipe with every default written out, and the version of nte: equal texts give equal clips.

    folder: the folder of the recipe's file. For a user's own scene the text has the digest of its XML and keyframes;
    meshes and textures are not read.
    """
    lines = [f"# Rendered by nte {__version__} with these settings."]
    for scene in sorted({group.scene for split in SPLITS for group in getattr(recipe, split) if is_own(group)}):
        animation = read_animation(folder / scene)
        content = (folder / scene).read_bytes() + Path(animation.xml).read_bytes()
        lines.append(f"# {scene}: {sha256(content).hexdigest()[:16]}")
    return "\n".join([*lines, to_yaml(recipe)])


def plan(recipe: Recipe, folder: Path = Path()) -> list[ClipPlan]:
    """Return the clips of a recipe, in order; each blurred clip is followed by its sharp twin.

    folder: the folder of the recipe's file. Clips of one animation follow each other in it, frame after frame, training
    before test.
    """
    plans, frames = [], Counter[Path]()
    for split in SPLITS:
        count = Counter[str]()
        for group in getattr(recipe, split):
            animation = (folder / group.scene).absolute() if is_own(group) else None
            for _ in range(group.clips):
                start = frames[animation] + group.parameters.get(START, 0) if animation else 0
                number = count[scene_name(group)]
                unit = ClipPlan(recipe.name, recipe.seed, split, number, group, animation=animation, start=start)
                plans += [unit, replace(unit, sharp=True)] if unit.blurred else [unit]
                count[scene_name(group)] += 1
                if animation:
                    frames[animation] += group.frames
    return plans


def is_own(group: Group) -> bool:
    """Say whether the scene is a user's own: a file, not a family."""
    return Path(group.scene).suffix in (".yaml", ".yml")


def scene_name(group: Group) -> str:
    """Return what clips are called by: the name of the family, or of the file of somebody's own scene."""
    return Path(group.scene).stem if is_own(group) else group.scene


def _require_own(where: str, group: Group, folder: Path) -> None:
    """Raise NteError for an animation, or a scene, that cannot be rendered."""
    path = folder / group.scene
    if not os.path.isfile(path):  # False also for a name that is too long for any file
        raise NteError(f"{where}.scene: {path} is no file")
    unknown = [name for name in group.parameters if name != START]
    if unknown or type(group.parameters.get(START, 0)) is not int:
        raise NteError(f"{where}.parameters: expected nothing but '{START}', a whole number, for somebody's own scene")
    require_arrays(f"the scene {group.scene}")
    require_scene(read_animation(path), group.components)


def _check(where: str, group: Group, folder: Path) -> None:
    if not is_own(group):
        _require_family(where, group)
    for key, least in _AT_LEAST.items():
        if (value := getattr(group, key)) < least:
            raise NteError(f"{where}.{key} is {value}: expected at least {least}")
        if value >= _TOO_MUCH:
            raise NteError(f"{where}.{key} is {value}: expected less than {_TOO_MUCH}")
    for key, choices in _ONE_OF.items():
        if (choice := getattr(group, key)) not in choices:
            raise NteError(f"{where}.{key} is '{choice}'{expected_one_of(choice, choices)}")
        if choice != choices[0] and (group.components or group.shutter):
            other = "components" if group.components else "a shutter"
            raise NteError(f"{where}.{key} is '{choice}': expected '{choices[0]}' with {other}")
    if group.components and group.unshadowed:
        raise NteError(f"{where}.unshadowed is true: expected false with components, which are those of a whole path")
    _require_shutter(where, group)
    if group.components and group.spp != 1:
        raise NteError(
            f"{where}.spp is {group.spp}: expected 1 with components (vectors have no mean): use seeds for more"
        )
    if group.reference_spp % 2:
        raise NteError(f"{where}.reference_spp is {group.reference_spp}: expected an even number (two halves)")
    if is_own(group):
        _require_own(where, group, folder)


def _require_family(where: str, group: Group) -> None:
    if group.scene not in FAMILIES:
        raise NteError(
            f"{where}.scene is '{group.scene}'{expected_one_of(group.scene, FAMILIES)}, or a YAML file with a scene of "
            "your own"
        )
    try:
        FAMILIES[group.scene].read(group.parameters)
    except NteError as error:
        raise NteError(f"{where}.parameters: scene '{group.scene}': {error}") from error
    if FAMILIES[group.scene].media:
        if group.components:
            raise NteError(
                f"{where}.components is true: light in the medium of '{group.scene}' has no components: expected false"
            )
        if group.unshadowed:
            raise NteError(f"{where}.unshadowed is true: the medium of '{group.scene}' has no surface: expected false")


def _require_shutter(where: str, group: Group) -> None:
    if not 0 <= group.shutter <= 1:
        raise NteError(f"{where}.shutter is {group.shutter}: expected the open share of the frame, in [0, 1]")
    if not group.shutter:
        return
    if group.components:
        raise NteError(f"{where}.components is true: expected false with a shutter: its frames have no components")
    if group.spp != 1:
        raise NteError(f"{where}.spp is {group.spp}: expected 1 with a shutter (a sample has one time): use seeds")
    if group.reference_spp % (2 * SUBFRAMES):
        raise NteError(
            f"{where}.reference_spp is {group.reference_spp}: expected a multiple of {2 * SUBFRAMES} with a shutter "
            f"({SUBFRAMES} sub-frames in each half)"
        )
