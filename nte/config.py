"""YAML files against a typed schema: unknown keys, wrong types and resolvers are refused in one line."""

import re
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException
from yaml import MarkedYAMLError, YAMLError

from nte.errors import NteError

Schema = TypeVar("Schema")
# ${oc.env:HOME} and other function calls, also those whose name is put together: ${${name}:HOME}
_RESOLVER = re.compile(r"\$\{[^}]*[:$]")


def load_config(
    schema: type[Schema], path: Path, overrides: Sequence[str] = (),
    choose: Callable[[Callable[[str], Any]], Schema] | None = None,
) -> Schema:  # fmt: skip
    """An instance of the dataclass `schema` from a YAML file and `key=value` overrides.

    choose: makes the instance with the defaults where a key decides which others there are; it is given a function from
    a dotted key to what file or overrides say, or None. Raises NteError that names the file and the key. ${name} may
    refer to another key; resolvers such as ${oc.env:…} are refused: a configuration means the same on every machine.
    """
    for override in overrides:
        if "=" not in override:
            raise NteError(f"'{override}': expected key=value")
    source = str(path)
    try:
        loaded = _read(path)
        refuse_resolvers(source, OmegaConf.to_container(loaded, resolve=False))
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
    except YAMLError as error:  # of an override's value
        raise NteError(f"{source}: not readable as YAML: {problem_of(error)}") from error
    except RecursionError as error:
        raise NteError(f"{source}: nested too deeply: expected a few levels of keys") from error
    except (OmegaConfBaseException, ValueError, TypeError) as error:
        key = getattr(error, "full_key", None)
        where = f"'{key}': " if key else ""
        raise NteError(f"{source}: {where}{problem_with(error)}") from error
    return made


def _chosen(
    choose: Callable[[Callable[[str], Any]], Schema], loaded: DictConfig, typed: DictConfig, source: str
) -> Schema:
    """The defaults that `choose` makes of what file and overrides say."""

    def said(key: str) -> Any:
        return OmegaConf.select(typed, key, default=OmegaConf.select(loaded, key))

    try:
        return choose(said)
    except NteError as error:
        raise NteError(f"{source}: {error}") from error


def problem_with(error: Exception) -> str:
    """What is wrong with a value, or a key that the schema lacks: the keys that there are, the nearest one first."""
    schema = getattr(error, "object_type", None)
    if not isinstance(error, ConfigKeyError | ConfigAttributeError) or not is_dataclass(schema):
        return _one_line(error)
    known = [field.name for field in fields(schema)]
    near = get_close_matches(str(error.key), known, 1)
    return f"unknown key{f', did you mean {near[0]}?' if near else ':'} expected one of {', '.join(known)}"


def _read(path: Path) -> DictConfig:
    try:
        loaded = OmegaConf.load(path)
    except OSError as error:
        if error.strerror is None:  # how OmegaConf says that it is a number
            raise NteError(f"{path}: expected a YAML mapping of keys to values") from error
        raise NteError(f"{path}: cannot be read: {error.strerror}") from error
    except (YAMLError, UnicodeDecodeError) as error:
        raise NteError(f"{path}: not readable as YAML: {problem_of(error)}") from error
    if not isinstance(loaded, DictConfig):
        raise NteError(f"{path}: expected a YAML mapping of keys to values")
    return loaded


def to_yaml(config: object) -> str:
    """A dataclass instance as YAML, every key written out."""
    return OmegaConf.to_yaml(OmegaConf.structured(config))


def refuse_resolvers(source: str, values: object, key: str = "") -> None:
    """Raise NteError that names the first of the values, at any depth, that calls a resolver such as ${oc.env:HOME}."""
    if isinstance(values, dict):
        for name, value in values.items():
            refuse_resolvers(source, value, f"{key}.{name}" if key else str(name))
    elif isinstance(values, list):
        for i, value in enumerate(values):
            refuse_resolvers(source, value, f"{key}[{i}]")
    elif isinstance(values, str) and _RESOLVER.search(values):
        raise NteError(f"{source}: '{key}': '{values}' calls a resolver: write the value itself")


def problem_of(error: Exception) -> str:
    """What the YAML parser stumbled over, and in which line."""
    if isinstance(error, MarkedYAMLError) and error.problem_mark is not None:
        return f"{error.problem} in line {error.problem_mark.line + 1}"
    return _one_line(error)


def _one_line(error: Exception) -> str:
    """The first line of a library's message; the rest repeats the key and the internal type."""
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
