"""Images as scripts: nothing is lost but what a half float cannot hold."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nte.viewer.layer_file import layer_script, type_of
from nte.viewer.page import clear
from tests.viewer.reading import read_script

NASTY = 'a"b</script>/é'


@given(st.integers(1, 3), st.integers(1, 7), st.integers(1, 9), st.sampled_from(["byte", "half", "float"]), st.data())
def test_what_is_written_comes_back(components: int, height: int, width: int, kind: str, data: st.DataObject) -> None:
    dtype = {"byte": np.uint8, "half": np.float16, "float": np.float32}[kind]
    bits = np.dtype({"byte": "u1", "half": "u2", "float": "u4"}[kind])
    seed = data.draw(st.integers(0, 2**32 - 1))
    drawn = np.random.default_rng(seed).integers(0, 2 ** (8 * bits.itemsize), (components, height, width), np.uint64)
    values = drawn.astype(bits).view(dtype)  # any bits: infinities, NaN and denormals too
    name, read = read_script(layer_script("clip/layer/0001", values, kind))
    assert name == "clip/layer/0001"
    np.testing.assert_array_equal(read, values)


def test_a_name_cannot_end_the_text() -> None:
    script = layer_script(NASTY, np.zeros((1, 2, 2), np.float32), "half")
    assert read_script(script)[0] == NASTY


@pytest.mark.parametrize(
    ("channel", "values", "kind"),
    [
        ("color", [0.5, 1e-9, np.nan], "half"),  # what is too dark for a half float is black on any screen
        ("color", [65504.0], "half"),
        ("color", [70000.0], "float"),
        ("reference", [3.0], "half"),  # the EXR has floats; the viewer shows light to half precision
        ("depth", [3.0], "float"),
        ("motion", [3.0, 4.0], "float"),
        ("position", [1.0, 2.0, 3.0], "float"),
        ("instance", [3.0], "float"),
        ("alpha", [0.2], "half"),
        ("glossy_vector", [1.0, 2.0], "float"),
    ],
)
def test_half_floats_where_they_keep_what_counts(channel: str, values: list[float], kind: str) -> None:
    assert type_of(channel, np.array(values, np.float32).reshape(-1, 1, 1)) == kind


def test_bytes_stay_bytes() -> None:
    assert type_of("color", np.zeros((3, 2, 2), np.uint8)) == "byte"


def test_what_a_killed_process_has_left_of_a_layer_goes_with_the_page(tmp_path: Path) -> None:
    folder = tmp_path / "layers" / "a"
    folder.mkdir(parents=True)
    code = "import sys; from pathlib import Path; from nte.files import temporary_name as name; "
    subprocess.run([sys.executable, "-c", code + "name(Path(sys.argv[1])).touch()", folder / "0000.js"], check=True)
    assert len(list(folder.iterdir())) == 1
    clear(tmp_path)
    assert list(tmp_path.iterdir()) == []
