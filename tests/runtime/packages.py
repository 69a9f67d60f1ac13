"""The packages of npm that programs beside the exported model use: installed once on a machine, outside the tree."""

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from filelock import FileLock

EXPORT = Path(__file__).parents[2] / "export"
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "nte-tests" / "npm"


def needs(*programs: str) -> pytest.MarkDecorator:
    """Skip a test on a machine that lacks one of these programs."""
    missing = [program for program in programs if not shutil.which(program)]
    return pytest.mark.skipif(bool(missing), reason=f"{', '.join(missing)} is not installed")


def with_packages(consumer: str, folder: Path) -> Path:
    """Copy the sources of export/CONSUMER to a folder, and lay the packages of its lock file beside them.

    A machine without access to npm's registry skips the test.
    """
    source = EXPORT / consumer
    shutil.copytree(source, folder, ignore=shutil.ignore_patterns("node_modules", "build"))
    lock = (source / "package-lock.json").read_bytes()
    kept = CACHE / f"{consumer}-{hashlib.sha256(lock).hexdigest()[:16]}"
    kept.mkdir(parents=True, exist_ok=True)
    with FileLock(kept.with_suffix(".lock")):
        if not (kept / "whole").exists():
            for name in ("package.json", "package-lock.json", ".npmrc"):
                shutil.copy(source / name, kept)
            command = ["npm", "ci", "--no-audit", "--no-fund"]
            done = subprocess.run(command, cwd=kept, capture_output=True, text=True, check=False)
            if done.returncode:
                pytest.skip(f"npm ci does not work here: {done.stderr.strip()[:200]}")
            (kept / "whole").touch()
    (folder / "node_modules").symlink_to(kept / "node_modules")
    return folder
