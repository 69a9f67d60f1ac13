"""An entry of a channel map: where the values of a channel are in the files, and how they are stored there."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any, TypeAlias

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from nte.config import problem_of, problem_with, refuse_resolvers
from nte.errors import NteError, expected_one_of
from nte.frames.channels import CHANNELS, Channel

Entry: TypeAlias = Any  # what YAML holds for a channel: a layer, its components, or the keys of a Source
SKY = "sky"  # an entry of `unknown` that stands for the vectors of misses
# Keys of a map and of its entries that are taken as they are typed: YAML reads *, # and no otherwise.
_TEXTS = ("file", "part", "view", "prefix", "result", "cameras", "producer")
_LISTS = ("layer", "plus", "where_dark", "scale", "offset", "unknown")  # keys of Source that accept a single value


@dataclass
class Source:
    """The place of a channel's values in the files, and how they are stored. A layer alone stands for {layer: …}."""

    layer: list[str] = field(default_factory=list)  # a layer, or its components one by one; empty: R, G, B of no layer
    plus: list[str] = field(default_factory=list)  # layers that are added if the file has them
    where_dark: list[str] = field(default_factory=list)  # layers that are added only in pixels that are still dark
    file: str = ""  # pattern of this channel's own files below SOURCE: # is the frame number, * anything
    part: str = ""  # name or number of a part of a multi-part file
    view: str = ""  # view of a stereo file
    scale: list[float] = field(default_factory=lambda: [1.0])  # value = stored · scale + offset;
    offset: list[float] = field(default_factory=lambda: [0.0])  # each is one number, or one for each component
    unknown: list[str] = field(default_factory=list)  # stored values of unknown vectors; `sky`: the vectors of misses


def _keys(entry: Entry) -> dict[str, Entry]:
    """The keys of an entry of `channels`: a layer alone stands for itself, without the layers that others add to it."""
    return dict(entry) if isinstance(entry, dict) else {"layer": entry, "plus": [], "where_dark": []}


def spell_out(loaded: DictConfig) -> None:
    """Give the keys of all entries of a map's file, since those of another one are merged into them."""
    channels = loaded.get("channels")
    if isinstance(channels, DictConfig):
        entries = OmegaConf.to_container(channels, resolve=False)
        assert isinstance(entries, dict)
        loaded.channels = {name: _keys(entry) for name, entry in entries.items()}


def as_typed(item: str) -> str:
    """Quote the value of `key=value` for YAML if the key's values are texts, and this one is not quoted already."""
    key, equals, text = item.partition("=")
    return (
        f"{key}={json.dumps(text, ensure_ascii=False)}"
        if equals and key in _TEXTS and text[:1] not in ("'", '"')
        else item
    )


def override(channels: Mapping[str, Entry], overrides: Sequence[str]) -> dict[str, Entry]:
    """Return the entries of `channels` with `channels.NAME=…`, `channels.NAME.KEY=…` or `channels={…}` applied.

    Raises NteError for text that is not readable, or names no channel.
    """
    found = dict(channels)
    for item in overrides:
        key, equals, text = item.partition("=")
        name, _, part = key.removeprefix("channels").removeprefix(".").partition(".")
        if not equals or "${" in text:
            raise NteError(f"'{item}': expected key=value, with the value itself")
        try:
            value: Entry = text
            if part not in _TEXTS or text[:1] in ("'", '"'):
                value = OmegaConf.to_container(OmegaConf.from_dotlist([f"value={text}"]))["value"]  # type: ignore[index,call-overload]
        except YAMLError as error:
            raise NteError(f"'{item}': not readable as YAML: {problem_of(error)}") from error
        if not name and not isinstance(value, dict):
            raise NteError(f"'{item}': expected the layers of channels, such as channels={{color: beauty}}")
        for one, entry in ({name: {part: value} if part else value} if name else value).items():
            found[one] = {**_keys(found.get(one, {})), **_keys(entry)}
    return found


def read_source(path: Path, name: str, given: Entry, common: Source) -> Source:
    """Return the checked Source of an entry of `channels`, whose missing keys are those of `common`.

    Raises NteError, naming the map `path` and the key, for what does not fit the channel `name`.
    """
    where = f"{path}: 'channels.{name}'"
    row = CHANNELS.get(name)
    if row is None or row.storage == "derived":
        stored = [key for key, r in CHANNELS.items() if r.storage != "derived"]
        raise NteError(f"{where}: no such channel{expected_one_of(name, stored)}")
    keys = _keys(given)
    listed = {key: [value] if key in _LISTS and not isinstance(value, list) else value for key, value in keys.items()}
    # Checked once more: these values are resolved, and two halves may have met to form a resolver.
    refuse_resolvers(str(path), [listed, common.file, common.part, common.view], f"channels.{name}")
    try:
        merged = OmegaConf.merge(OmegaConf.structured(common), listed)
        source: Source = OmegaConf.to_object(merged)  # type: ignore[assignment]
    except (OmegaConfBaseException, OverflowError) as error:
        key = getattr(error, "full_key", None)
        if key and key.startswith("layer"):
            raise NteError(f"{where}: {keys.get('layer')!r}: expected a layer, or {_names(row)}") from error
        raise NteError(f"{where.removesuffix(chr(39))}{f'.{key}' if key else ''}': {problem_with(error)}") from error
    _require_source(where, row, keys.get("layer"), source)
    return source


def _require_source(where: str, row: Channel, layer: Entry, source: Source) -> None:
    count = len(row.components)
    # OmegaConf accepts containers in a list of strings or numbers.
    nested = [key for key in _LISTS if any(isinstance(value, dict | list) for value in getattr(source, key))]
    unnamed = any(not part.strip() for name in source.layer if isinstance(name, str) for part in name.split("|"))
    if nested or unnamed or len(source.layer) not in (0, 1, count):
        key = f"{nested[0]}: " if nested and nested[0] != "layer" else ""
        expected = "single values" if key else f"a layer, or {_names(row)}"
        raise NteError(f"{where}: {key}{getattr(source, nested[0]) if key else layer!r}: expected {expected}")
    for key in ("scale", "offset"):
        numbers = getattr(source, key)
        if len(numbers) not in (1, count) or not all(map(isfinite, numbers)) or (key == "scale" and 0 in numbers):
            raise NteError(f"{where}: '{key}' is {numbers}, expected a number, or {count}, one for each component")
    if source.unknown and row.kind != "motion":
        raise NteError(f"{where}: 'unknown' is for motion vectors")
    for value in source.unknown:
        try:
            float(0 if value == SKY else value)
        except ValueError:
            raise NteError(f"{where}: 'unknown' has '{value}', expected stored values or {SKY}") from None


def _names(row: Channel) -> str:
    count = len(row.components)
    return f"the names of {count} channels" if count > 1 else "the name of its channel"
