"""The `nte` command, a file for each subcommand. A subcommand's imports happen when it runs, so --help is instant.

Exit status: 0 done; 1 a bug in nte; 2 wrong usage or input, told in one line; 130 interrupted; 141 nobody reads what it
prints (… | head), in silence.
"""

import argparse
import errno
import signal
import sys
import warnings
from collections.abc import Sequence

from nte.cli import (
    bench,
    check,
    compare,
    demo,
    denoise,
    estimate,
    evaluate,
    export,
    import_clip,
    info,
    merge_burst,
    render,
    train,
    view,
)
from nte.cli.parsing import Parser
from nte.console import NoReaderError, standard_streams
from nte.errors import NteError, lacking_memory, needs_extra, printable
from nte.interrupt import terminable
from nte.version import __version__

_COMMANDS = (
    demo, render, train, evaluate, compare, export, denoise, estimate, import_clip, bench, merge_burst, check, info,
    view,
)  # fmt: skip
INTERRUPTED, NO_READER = 130, 141  # 128 + SIGINT, 128 + SIGPIPE, as a shell says it
_OF_THE_SYSTEM = {
    errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENAMETOOLONG,
    errno.ELOOP, errno.EMFILE, errno.ENOTDIR, errno.EISDIR, errno.ESTALE,
}  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (None: that of the process) and return the exit status.

    Wrong usage ends the process with status 2.
    """
    with standard_streams():
        status = _status(argv)
    if argv is None:  # Python ends now, and Ctrl-C would show a traceback of that
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return status


def _status(argv: Sequence[str] | None) -> int:
    """Run the command line, tell what went wrong, and return the exit status."""
    try:
        try:
            return _run(argv)
        finally:
            sys.stdout.flush()  # what it refuses must not look as if it had been printed
    except NteError as error:
        return _failed(error)
    except NoReaderError:  # silent, as the commands of the system are: nobody has asked for the rest
        return NO_READER
    except OSError as error:  # not permitted, no space left, a name that is too long
        if error.errno not in _OF_THE_SYSTEM:
            raise
        return _failed(f"{f'{error.filename}: ' if error.filename else ''}{error.strerror}")
    except (MemoryError, RuntimeError) as error:
        if (what := lacking_memory(error)) is None:
            raise
        return _failed(f"{what}: give it smaller frames or more memory, or fewer --jobs")
    except KeyboardInterrupt:
        # No more than that: a second Ctrl-C kills workers, whose hidden files the next command sweeps.
        return _failed("interrupted; every file is whole or absent", INTERRUPTED)


def _run(argv: Sequence[str] | None) -> int:
    """Parse the command line and do what it says; a missing optional dependency becomes an NteError."""
    parser = _parser()
    options, rest = parser.parse_known_args(argv)
    if hasattr(options, "overrides") and all("=" in item and item[0] != "-" for item in rest):
        options.overrides += rest  # argparse stops taking positionals after an option, but users mix them
    elif rest:
        parser.prog = f"nte {options.command}"  # whose --help is named
        parser.error(f"unrecognised arguments: {' '.join(rest)}")
    warnings.showwarning = _tell_warning
    try:
        with terminable():
            return int(options.run(options) or 0)
    except ImportError as error:
        if not options.extra or (error.name or "").startswith("nte"):
            raise
        raise needs_extra(options.extra, f"nte {options.command}", error) from error


def _failed(what: object, status: int = 2) -> int:
    print(f"nte: {printable(str(what))}", file=sys.stderr)
    return status


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="nte", description="Neural temporal denoising of path-traced sequences")
    parser.add_argument("--version", action="version", version=f"nte {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for module in _COMMANDS:
        module.add(commands)
    return parser


def _tell_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    print(f"nte: warning: {printable(str(message))}", file=sys.stderr)
