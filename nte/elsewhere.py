"""Classes of other people's packages, which users name as package.module:Class."""

from importlib import import_module

from nte.errors import NteError


def is_elsewhere(name: str) -> bool:
    """Tell whether a name has the form package.module:Class."""
    module, _, attribute = name.partition(":")
    return attribute.isidentifier() and all(part.isidentifier() for part in module.split("."))


def class_elsewhere(name: str, base: type, said: str) -> type:
    """Import the class `name`, package.module:Class, which must inherit from `base`.

    The package must be installed, or its folder be in PYTHONPATH. said: where the name was found, with which an error
    begins. Raises NteError for a module that cannot be imported, and for a class that is not there or another one.
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(import_module(module), attribute, None)
    except Exception as error:  # whatever the file does when it is imported
        what = f"{module} cannot be imported: {type(error).__name__}: {error}".splitlines()[0]
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):
            what = f"there is no module '{error.name}': install it, or name its folder in PYTHONPATH"
        raise NteError(f"{said}: {what}") from error
    if not (isinstance(found, type) and base in found.__mro__):
        raise NteError(f"{said}: {module} has no {base.__name__} of that name")
    return found
