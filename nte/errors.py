"""NteError, the one error that is meant for users, and what makes its messages."""

import re
import unicodedata
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from difflib import get_close_matches


class NteError(Exception):
    """A mistake in usage or input, told in one line.

    The message says what was found, where, what was expected and what to do. The command line prints it without a
    traceback and exits with status 2; any other exception is a bug in nte. Characters that would break the line, steer
    a terminal or have no encoding are escaped, and the middle of a long message is left out: texts of other people's
    files are quoted in it.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(_shortened(message)))


_BEGIN, _END = 600, 400  # characters that stay of a long message: where and what was found, and what was expected


def _shortened(text: str) -> str:
    return text if len(text) <= _BEGIN + _END else f"{text[:_BEGIN]} … {text[-_END:]}"


def printable(text: str, but: str = "") -> str:
    r"""Escape the characters that would break a line, steer a terminal, turn the text's direction or have no encoding.

    The last are bytes of a file's name that are no text: \udc80 to \udcff. but: characters that stay.

    >>> from nte.errors import printable
    >>> print(printable("a\nb\x1b[2J"))
    a\nb\x1b[2J
    """
    return "".join(
        c if c.isprintable() or c in but or unicodedata.category(c) == "Zs" else c.encode("unicode_escape").decode()
        for c in text
    )


@contextmanager
def naming(source: object) -> Iterator[None]:
    """Put the source before the message of an NteError that the block raises."""
    try:
        yield
    except NteError as error:
        raise NteError(f"{source}: {error}") from error


DISTRIBUTION = "nte-denoiser"  # the name on PyPI, where `nte` is somebody else's package


def needs_extra(extra: str, what: str, cause: ImportError) -> NteError:
    """Make the error for a missing optional dependency, which names the extra that installs it.

    extra: such as train or eval. what: the feature that needs it. cause: the failed import.
    """
    package = str(cause.name).partition(".")[0]
    return NteError(f"{what} needs the package '{package}': pip install '{DISTRIBUTION}[{extra}]'")


def expected_one_of(found: object, known: Iterable[object]) -> str:
    """Say what was expected instead of a name, as the end of an error: the nearest known name, then all of them.

    found: the name that somebody typed. known: the names that would have been right. The text follows the wrong name:
    «, did you mean taa? expected one of noisy, taa», or «, expected one of …» if no name is near.
    """
    names = [str(name) for name in known]
    return f"{did_you_mean(found, names)} expected {'one of ' if names else ''}{', '.join(names) or 'none'}"


def did_you_mean(found: object, known: Iterable[str]) -> str:
    """Return «, did you mean NAME?» for the known name that is nearest to a wrong one, or a comma if none is near.

    Upper and lower case count as equal.
    """
    folded: dict[str, str] = {}
    for name in known:
        folded.setdefault(name.casefold(), name)
    near = get_close_matches(str(found).casefold(), folded, 1)
    return f", did you mean {folded[near[0]]}?" if near else ","


# NumPy: Unable to allocate 7.1 GiB. PyTorch: can't allocate memory: you tried to allocate 4000 bytes; CUDA out of
# memory. Tried to allocate 2.00 GiB. ONNX Runtime: Failed to allocate memory for requested buffer of size 4000.
_LACKS_MEMORY = re.compile(r"allocate (?:memory|\d)|out of memory|bad_alloc")
_ASKED = re.compile(r"(?:allocate|buffer of size) ([\d.]+)(?: ([KMGTPE]iB))?")


def lacking_memory(error: BaseException) -> str | None:
    """Say how much memory was asked for in vain, if that is what an error of a library is about; else None.

    Beside it stands what the process had before, so that both together are what the work takes at least. Of a GPU's
    memory that is not known.
    """
    text = str(error)
    if not isinstance(error, MemoryError) and not _LACKS_MEMORY.search(text):
        return None
    found = _ASKED.search(text)
    if found is None:
        return "too little memory"
    asked = f"{found[1]} {found[2]}" if found[2] else f"{float(found[1]) / 2**20:,.1f} MiB"
    beside = ""
    if "CUDA" not in text:
        with suppress(ImportError):  # a system that does not tell
            from nte.memory import peak_resident_mb

            beside = f", beside the {peak_resident_mb():,.0f} MB that the process had"
    return f"too little memory: another {asked} were asked for{beside}"
