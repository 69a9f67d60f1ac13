"""The mark in a folder whose files are not all there yet, by which the same command may begin again without --force.

Frames are denoised one after the other, and each depends on those before: a command that was killed cannot go on in the
middle. It starts anew and replaces what it had written, and nothing that another command wrote.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path

from nte.files import remove, write_whole

MARK = ".unfinished.json"
Command = Mapping[str, object]  # what the files of a folder depend on; paths as Path, which may be relative


def is_unfinished(folder: Path, command: Command) -> bool:
    """Tell whether this very command has begun to write to `folder` and was stopped before its last file."""
    try:
        return (folder / MARK).read_text(encoding="utf-8") == _text(command)
    except (OSError, ValueError):
        return False


def begin(folder: Path, command: Command) -> None:
    """Mark `folder`, before the command's first file. Raises NteError if that cannot be written."""
    write_whole(folder / MARK, lambda temporary: temporary.write_text(_text(command), encoding="utf-8"))


def finish(folder: Path) -> None:
    """Remove the mark, after the last file."""
    remove(folder / MARK)


def _text(command: Command) -> str:
    return json.dumps(command, indent=1, sort_keys=True, default=os.path.abspath) + "\n"
