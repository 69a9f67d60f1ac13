"""Loader of YAML files with a typed schema: unknown keys, wrong types and resolvers are one-line errors."""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, get_args, get_origin, get_type_hints

from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    ConfigTypeError,
    OmegaConfBaseException,
    ValidationError,
)
from yaml import MarkedYAMLError, YAMLError

from nte.errors import NteError, expected_one_of, naming
from nte.files import is_inside, refuse_pipe
from nte.shipped import beside

_KINDS = {
    int: "a whole number", float: "a number", bool: "true or false", str: "text", list: "a list",
    dict: "keys with values",
}  # fmt: skip
_LARGEST = 2**63 - 1  # whole number
Schema = TypeVar("Schema")
Said: TypeAlias = Callable[[str], Any]  # a dotted key → the value that the file or an override gives it, or None
# ${oc.env:HOME} and other function calls, also with a composed name: ${${name}:HOME}
_RESOLVER = re.compile(r"\$\{[^}]*[:$]")


def load_config(
    schema: type[Schema],
    path: Path,
    overrides: Sequence[str] = (),
    choose: Callable[[Said], Schema] | None = None,
    check: Callable[[Schema], object] = lambda made: None,
    contained: bool = False,
    spell_out: Callable[[DictConfig], object] = lambda loaded: None,
) -> Schema:
    """Load an instance of the dataclass `schema` from a YAML file and `key=value` overrides.

    A file may be based on another: `base: other.yaml`, relative to itself, and then it holds only what differs. Lists
    are replaced as a whole, and so is a section whose `kind` is another one, since its keys are others.

    choose: makes the instance with the defaults, for schemas in which one key decides which others exist. It is called
    with a function from a dotted key to the value that the file or the overrides give it, or None. ${name} may refer to
    another key; resolvers such as ${oc.env:…} are refused, so that a configuration means the same on every machine.
    check: raises NteError, naming the key, for values that are not allowed. contained: refuse a `base` outside the
    folder of the file that names it. spell_out: changes the values of each file before it is merged with another, for
    schemas in which one thing can be said in two ways. Raises NteError, naming the file and the key, for anything that
    does not fit.
    """
    for override in overrides:
        if "=" not in override:
            raise NteError(f"'{override}': expected key=value")
    source = str(path)
    loaded: DictConfig | None = None
    try:
        loaded = _read(path, contained, spell_out)
        source = "command line"
        typed = OmegaConf.from_dotlist(list(overrides))
        refuse_resolvers(source, OmegaConf.to_container(typed, resolve=False))
        source = str(path)
        defaults = schema if choose is None else _chosen(choose, loaded, typed, source)
        config = OmegaConf.merge(OmegaConf.structured(defaults), loaded)
        source = "command line"
        config.merge_with_dotlist(list(overrides))
        source = str(path)
        missing = OmegaConf.missing_keys(config)
        if missing:
            raise NteError(f"{path}: '{min(missing)}' is missing: give it a value")
        made: Schema = OmegaConf.to_object(config)  # type: ignore[assignment]
    except YAMLError as error:  # from an override's value
        raise NteError(f"{source}: not readable as YAML: {problem_of(error)}") from error
    except RecursionError as error:
        raise NteError(f"{source}: nested too deeply: expected a few levels of keys") from error
    except (OmegaConfBaseException, ValueError, TypeError, OverflowError) as error:
        key = getattr(error, "full_key", None)
        where = f"'{_place(schema, loaded) if source == str(path) else ''}{key}': " if key else ""
        raise NteError(f"{source}: {where}{problem_with(error)}") from error
    with naming(path):
        _refuse_unfit(made, type(made))
        check(made)
    return made


def _place(schema: type, values: object) -> str:
    """The place, such as situations[0]., of the first entry that does not fit a list of dataclasses; "" if all do.

    OmegaConf names the key in such an entry only.
    """
    for name, hint in get_type_hints(schema).items():
        of_entry = get_args(hint)[-1] if get_origin(hint) is list else None
        entries: list[object] = []
        with suppress(OmegaConfBaseException):  # a reference that leads nowhere has no entries
            if is_dataclass(of_entry) and isinstance(values, DictConfig) and isinstance(values.get(name), ListConfig):
                entries = list(values[name])
        for number, entry in enumerate(entries):
            if not isinstance(entry, DictConfig):
                return ""  # the key of what is no section is named with its number
            try:
                OmegaConf.merge(OmegaConf.structured(of_entry), entry)
            except (OmegaConfBaseException, ValueError, TypeError, OverflowError):
                assert isinstance(of_entry, type)
                return f"{name}[{number}].{_place(of_entry, entry)}"
    return ""


def _refuse_unfit(value: object, hint: object, key: str = "") -> None:
    """Raise NteError for a list or a dictionary in the place of a single value: OmegaConf lets it pass within a list.

    Also for a whole number that no library can take.
    hint: the type that the value should have. key: where it is.
    """
    hint = next((one for one in get_args(hint) if type(None) in get_args(hint) and one is not type(None)), hint)
    if is_dataclass(value):
        for name, of_field in get_type_hints(type(value)).items():
            _refuse_unfit(getattr(value, name), of_field, f"{key}.{name}" if key else name)
    elif isinstance(value, list | dict):
        if hint in (int, float, bool, str):
            raise NteError(f"'{key}': {value!r:.60} is given, expected {_KINDS[hint]}")
        of_entry = get_args(hint)[-1] if get_args(hint) else object
        for place, entry in enumerate(value) if isinstance(value, list) else value.items():
            _refuse_unfit(entry, of_entry, f"{key}[{place}]" if isinstance(value, list) else f"{key}.{place}")
    elif isinstance(value, int) and abs(value) > _LARGEST:
        raise NteError(f"'{key}': {value!r:.40}… is given, expected a number of at most 64 bits")


def _chosen(choose: Callable[[Said], Schema], loaded: DictConfig, typed: DictConfig, source: str) -> Schema:
    """The defaults that `choose` makes from the values in file and overrides."""

    def said(key: str) -> Any:
        return OmegaConf.select(typed, key, default=OmegaConf.select(loaded, key))

    with naming(source):
        return choose(said)


def problem_with(error: Exception) -> str:
    """Say in one line what is wrong with a value; for an unknown key, list the known keys and suggest the nearest."""
    schema = getattr(error, "object_type", None)
    if isinstance(error, ValidationError):
        return _problem_with_value(error)
    if isinstance(error, ConfigTypeError) and schema in _KINDS:
        return f"expected {_KINDS[schema]}"
    if not isinstance(error, ConfigKeyError | ConfigAttributeError) or not is_dataclass(schema):
        return _one_line(error)
    known = [field.name for field in fields(schema)]
    return f"unknown key{expected_one_of(error.key, known)}"


def _problem_with_value(error: ValidationError) -> str:
    """Say what is given to a key and what it should be; in OmegaConf's own words for a type that users do not meet."""
    kind = error.object_type
    if is_dataclass(kind):
        kind = get_type_hints(kind).get(str(error.key))
    elif args := get_args(error.ref_type):  # an entry of a list or dictionary
        kind = args[-1]
    empty = type(None) in get_args(kind)
    kind = next((one for one in get_args(kind) if one is not type(None)), kind) if empty else kind
    kind = dict if is_dataclass(kind) else get_origin(kind) or kind
    if kind not in _KINDS:
        return _one_line(error)
    given = "null" if error.value is None else f"{error.value!r:.60}"
    return f"{given} is given, expected {_KINDS[kind]}{', or null' if empty else ''}"


def _read(
    path: Path, contained: bool, spell_out: Callable[[DictConfig], object], trail: tuple[Path, ...] = ()
) -> DictConfig:
    """The values of a file, merged over those of its base. trail: files that are based on this one."""
    loaded = _read_alone(path)
    refuse_resolvers(str(path), OmegaConf.to_container(loaded, resolve=False))
    spell_out(loaded)
    if "base" not in loaded:
        return loaded
    named, trail = loaded.pop("base"), (*trail, path.resolve())
    if not isinstance(named, str):
        raise NteError(f"{path}: 'base' is {named!r:.60}, expected the path of a file, relative to this one")
    if contained and not is_inside(path.parent / named, path.parent):
        raise NteError(f"{path}: 'base' is '{named}', which leads out of {path.parent}: expected a file in that folder")
    base = path.parent / named if contained else beside(path, named)
    if base.resolve() in trail:
        raise NteError(f"{path}: 'base' is '{named}', which is based on this file: expected another one")
    below = _read(base, contained, spell_out, trail)
    for key, section in loaded.items():
        if isinstance(section, DictConfig) and isinstance(before := below.get(key), DictConfig):
            kind = section.get("kind")
            if kind is not None and kind != before.get("kind"):
                del below[key]
    merged = OmegaConf.merge(below, loaded)
    assert isinstance(merged, DictConfig)
    return merged


def _read_alone(path: Path) -> DictConfig:
    try:
        refuse_pipe(path)
        loaded = OmegaConf.load(path)
    except OSError as error:
        if error.strerror is None:  # OmegaConf raises this for a file that is a single number
            raise NteError(f"{path}: expected a YAML mapping of keys to values") from error
        raise NteError(f"{path}: cannot be read: {error.strerror}") from error
    except (YAMLError, UnicodeDecodeError) as error:
        raise NteError(f"{path}: not readable as YAML: {problem_of(error)}") from error
    if not isinstance(loaded, DictConfig):
        raise NteError(f"{path}: expected a YAML mapping of keys to values")
    return loaded


def to_yaml(config: object) -> str:
    """Write a dataclass instance as YAML text, with every key."""
    return OmegaConf.to_yaml(OmegaConf.structured(config))


def refuse_resolvers(source: str, values: object, key: str = "") -> None:
    """Raise NteError for the first value, at any depth, that calls a resolver such as ${oc.env:HOME}.

    values: dictionaries, lists and texts. source, key: where they come from, for the error.
    """
    if isinstance(values, dict):
        for name, value in values.items():
            refuse_resolvers(source, value, f"{key}.{name}" if key else str(name))
    elif isinstance(values, list):
        for i, value in enumerate(values):
            refuse_resolvers(source, value, f"{key}[{i}]")
    elif isinstance(values, str) and _RESOLVER.search(values):
        raise NteError(f"{source}: '{key}': {values!r:.60} calls a resolver: write the value itself")


def problem_of(error: Exception) -> str:
    """Say in one line what the YAML parser found wrong, and in which line."""
    if isinstance(error, MarkedYAMLError) and error.problem_mark is not None:
        return f"{error.problem} in line {error.problem_mark.line + 1}"
    return _one_line(error)


def _one_line(error: Exception) -> str:
    """The first line of a library's message; the rest repeats the key and the internal type."""
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
