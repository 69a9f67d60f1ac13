"""Reading of damaged files in processes that may die: with limits of memory and time, and born again."""

import multiprocessing
import os
import random
import resource
import shutil
import signal
import traceback
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

from nte.errors import NteError
from tests.faults.corpus import FORMATS
from tests.faults.mutations import CANARY, SECRET, damage
from tests.faults.strangers import STRANGERS

MEMORY = 1 << 30  # bytes that a process may ask for, beyond what it has when it begins
SECONDS = 120  # for one small file, on a machine that has other work to do
VALUE = "what nobody is told"  # of the variable SECRET
WARM = multiprocessing.get_context("forkserver")
WARM.set_forkserver_preload(["tests.faults.corpus", "cv2", "rawpy", "tifffile", "onnxruntime", "zarr", __name__])


def faults(name: str, whole: Path, folder: Path, seeds: range) -> Iterator[tuple[int, str]]:
    """Damage a file of a format with each seed, and read it: the seeds that were neither read nor refused in a line.

    whole: the corpus, only to be read. folder: where it is copied to and damaged, again after each process that died.
    """
    while seeds:
        shutil.copytree(whole, folder, dirs_exist_ok=True)
        reader, writer = WARM.Pipe(duplex=False)
        process = WARM.Process(target=_read_all, args=(writer, name, str(folder), seeds))
        process.start()
        writer.close()
        told, wrong = _listen(reader, seeds)
        yield from wrong
        if told < len(seeds):  # it did not come to the end
            process.kill()
        process.join()
        if told < len(seeds):
            yield seeds[told], f"process ended with {process.exitcode}, or took more than {SECONDS} s"
            told += 1
        seeds = seeds[told:]


def _listen(reader: Connection, seeds: range) -> tuple[int, list[tuple[int, str]]]:
    """How many seeds were told of until the process fell silent, and what was wrong."""
    told, wrong = 0, []
    with reader:
        while told < len(seeds) and reader.poll(SECONDS):
            try:
                outcome = reader.recv()
            except EOFError:
                break
            if outcome:
                wrong.append((seeds[told], outcome))
            told += 1
    return told, wrong


def damaged_file(name: str, corpus: Path, seed: int) -> tuple[Path, bytes]:
    """The file of the corpus that a seed damages, and what it then holds; the first seeds are STRANGERS."""
    rng = random.Random(seed)
    path = rng.choice(sorted(corpus.glob(FORMATS[name].files)))
    if seed < len(made := STRANGERS.get(name, ())):
        return path, made[seed]
    return path, damage(path.read_bytes(), rng, FORMATS[name].text)


def _read_all(writer: Connection, name: str, corpus: str, seeds: range) -> None:
    """In the process: tell "" for each seed that was read or refused, or what happened instead."""
    folder = Path(corpus)
    os.chdir(folder)
    os.environ[SECRET] = VALUE
    FORMATS[name].read(folder)  # libraries take their memory, and folders are there
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, size + MEMORY))
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    for seed in seeds:
        path, content = damaged_file(name, folder, seed)
        whole = path.read_bytes()
        path.write_bytes(content)
        if FORMATS[name].seal:
            with suppress(Exception):  # what is damaged too much has nothing to be sealed
                FORMATS[name].seal(path)
        try:
            outcome = _trace(folder, repr(FORMATS[name].read(folder)))
        except NteError as error:
            outcome = f"several lines: {error}" if len(str(error).splitlines()) != 1 else _trace(folder, str(error))
        except BaseException:
            outcome = traceback.format_exc()
        finally:
            path.write_bytes(whole)
        writer.send(outcome)


def _trace(folder: Path, said: str) -> str:
    """What tells that a file was believed: code of it has run, or has read the environment; "" if nothing does."""
    if (folder / CANARY).exists():
        (folder / CANARY).unlink()
        return "code in the file was run"
    written = (path.read_bytes() for path in folder.glob("out/**/*") if path.is_file())
    return "the environment was read" if VALUE in said or any(VALUE.encode() in data for data in written) else ""
