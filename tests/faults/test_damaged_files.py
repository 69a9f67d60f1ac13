"""Files that are damaged in thousands of ways: each is read, or refused in one line, in bounded time and memory."""

import shutil
from pathlib import Path

import pytest

from tests.conftest import Rounds
from tests.faults.corpus import FORMATS, write_corpus
from tests.faults.limited import damaged_file, faults
from tests.faults.strangers import STRANGERS
from tests.shared import made_once

pytestmark = pytest.mark.slow


@pytest.fixture(scope="session")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole files. Only to be read."""
    return made_once(tmp_path_factory, "corpus", write_corpus)


@pytest.mark.parametrize("name", FORMATS)
def test_it_is_read_or_refused_in_a_line(name: str, corpus: Path, tmp_path: Path, rounds: Rounds) -> None:
    if name == "scene":
        pytest.importorskip("nte.render.engine.backend").load_mitsuba()
    folder = tmp_path / "corpus"
    shutil.copytree(corpus, folder)
    FORMATS[name].read(folder)  # as long as it is whole
    what, short, long = ("damaged files for a command", 2, 40) if name.startswith("nte ") else ("damaged files", 8, 700)
    made = len(STRANGERS.get(name, ()))
    count = rounds(what, made + short, made + long)
    found = dict(faults(name, corpus, folder, range(count)))
    for seed in found:  # to look at
        path, content = damaged_file(name, corpus, seed)
        (tmp_path / f"{seed}{path.suffix}").write_bytes(content)
    assert not found, f"files {tmp_path}/SEED.*: " + "\n".join(f"{seed}: {said}" for seed, said in found.items())
