"""NteError, the one error that is meant for users."""


class NteError(Exception):
    """A mistake in usage or input, told in one line.

    The message says what was found, where, what was expected and what to do. The command line prints it without a
    traceback and exits with status 2; any other exception is a bug in nte.
    """


DISTRIBUTION = "nte-denoiser"  # the name on PyPI, where `nte` is somebody else's package


def needs_extra(extra: str, what: str, cause: ImportError) -> NteError:
    """Make the error for a missing optional dependency, which names the extra that installs it.

    extra: such as train or eval. what: the feature that needs it. cause: the failed import.
    """
    package = str(cause.name).partition(".")[0]
    return NteError(f"{what} needs the package '{package}': pip install '{DISTRIBUTION}[{extra}]'")
