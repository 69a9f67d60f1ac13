"""Recipes: a YAML file that says which clips to render, and everything random in them by one seed."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import yaml
from omegaconf import MISSING, OmegaConf
from omegaconf.errors import OmegaConfBaseException

import nte
from nte.errors import NteError
from nte.render.scenes import FAMILIES

SPLITS = ("train", "test")
_AT_LEAST = {
    "clips": 0, "width": 1, "height": 1, "frames": 1, "spp": 1, "seeds": 1, "reference_spp": 2, "max_depth": 2,
}  # fmt: skip


@dataclass
class Group:
    """Clips of one kind."""

    scene: str = "rooms"  # family of scenes
    clips: int = MISSING
    width: int = 128  # pixels
    height: int = 128
    frames: int = 8
    spp: int = 1  # samples per pixel of `color`, per seed
    seeds: int = 1  # independent noise seeds of `color`
    reference_spp: int = 256  # of both halves together
    max_depth: int = 4  # path segments: 1 sees lights only, 2 direct light, 3 one bounce of indirect light


@dataclass
class Recipe:
    """A data set. Clips of `train` and `test` are never of the same scene."""

    name: str = MISSING
    seed: int = 0
    train: list[Group] = field(default_factory=list)
    test: list[Group] = field(default_factory=list)


@dataclass(frozen=True)
class ClipPlan:
    """One clip to render: a unit that depends on nothing but what is written here."""

    recipe: str
    seed: int
    split: str
    number: int  # among the clips of its family in its split
    group: Group

    @property
    def name(self) -> str:
        """train/rooms_003: the clip's folder in the output, and what its randomness is derived from."""
        return f"{self.split}/{self.group.scene}_{self.number:03d}"


def read_recipe(path: Path) -> Recipe:
    """Read and check a recipe. Raises NteError that names the file and the key, with what was expected."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise NteError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    # A recipe means the same on every machine: nothing may be looked up in the environment.
    if resolver := re.search(r"\$\{[^}]*:[^}]*\}?", text):
        raise NteError(f"{path}: {resolver[0]} is a resolver, which recipes may not use: write the value itself")
    try:
        given = OmegaConf.create(text)
        recipe = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(Recipe), given))
    except (OmegaConfBaseException, yaml.YAMLError, ValueError, AssertionError) as error:
        raise NteError(f"{path}: {_one_line(error)}") from error
    assert isinstance(recipe, Recipe)
    _check(path, recipe)
    return recipe


def recipe_text(recipe: Recipe) -> str:
    """The recipe with every default written out, and what renders it: equal texts give equal clips."""
    settings = OmegaConf.to_yaml(OmegaConf.structured(recipe))
    return f"# Rendered by nte {nte.__version__} with these settings. nte render compares them before it resumes.\n{settings}"


def plan(recipe: Recipe) -> list[ClipPlan]:
    """The clips of a recipe, in order."""
    return list(_plan(recipe))


def _plan(recipe: Recipe) -> Iterator[ClipPlan]:
    for split in SPLITS:
        count = dict.fromkeys(FAMILIES, 0)
        for group in getattr(recipe, split):
            for _ in range(group.clips):
                yield ClipPlan(recipe.name, recipe.seed, split, count[group.scene], group)
                count[group.scene] += 1


def _check(path: Path, recipe: Recipe) -> None:
    if not recipe.train and not recipe.test:
        raise NteError(f"{path}: neither 'train' nor 'test' has a group of clips: expected at least one")
    for split in SPLITS:
        for number, group in enumerate(getattr(recipe, split)):
            where = f"{path}: {split}[{number}]"
            if group.scene not in FAMILIES:
                raise NteError(f"{where}.scene is '{group.scene}': expected one of {', '.join(FAMILIES)}")
            for key, least in _AT_LEAST.items():
                if (value := getattr(group, key)) < least:
                    raise NteError(f"{where}.{key} is {value}: expected at least {least}")
            if group.reference_spp % 2:
                raise NteError(f"{where}.reference_spp is {group.reference_spp}: expected an even number (two halves)")


def _one_line(error: Exception) -> str:
    """What OmegaConf says, with the key, in one line."""
    key = getattr(error, "full_key", None)
    known = ", ".join(f.name for f in fields(Recipe)) + "; in a group: " + ", ".join(f.name for f in fields(Group))
    first = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    hint = f" (known keys: {known})" if "not in" in first else ""
    return (f"'{key}': " if key else "") + first + hint
