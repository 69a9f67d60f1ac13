"""The one error that is meant for users."""


class NteError(Exception):
    """A mistake in usage or input, told in one line.

    The message says what was found, where, what was expected and what to do. The command line prints it
    without a traceback and exits with status 2; any other exception is a fault of ours.
    """


DISTRIBUTION = "nte-denoiser"  # its name on PyPI; `nte` is somebody else's package there


def needs_extra(extra: str, what: str, cause: ImportError) -> NteError:
    """The error for a missing optional dependency: names the extra that brings it."""
    return NteError(f"{what} needs the package '{cause.name}': pip install '{DISTRIBUTION}[{extra}]'")
