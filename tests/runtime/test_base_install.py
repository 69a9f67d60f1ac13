"""The base install: `import nte` is light, and exported models run where PyTorch is not installed."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from nte.frames.clip import Clip
from nte.frames.exr import read_layers, write_exr
from nte.importing.channel_map import MAPS
from nte.models.temporal import TemporalDenoiser
from nte.session import Session
from tests.importing.producers import blender, scene
from tests.synthetic import disc_clip

pytestmark = pytest.mark.slow
EXTRAS = ("torch", "mitsuba", "drjit", "matplotlib", "lightning_fabric", "safetensors", "onnx", "tensorboard")
WITHOUT = f"import sys; sys.modules |= dict.fromkeys({EXTRAS!r}); "


def python(code: str, *arguments: object) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def nte_without_extras(*arguments: object) -> "subprocess.CompletedProcess[str]":
    return python(WITHOUT + "from nte.cli import main; sys.exit(main(sys.argv[1:]))", *arguments)


def test_importing_nte_loads_nothing_heavy() -> None:
    code = "import sys, nte, nte.cli; print(*sys.modules)"
    loaded = set(python(code).stdout.split())
    assert "nte.registry" in loaded
    assert not loaded & {*EXTRAS, "onnxruntime"}


def test_an_exported_model_runs_without_pytorch(
    network: TemporalDenoiser, model: Path, noisy_disc: Path, tmp_path: Path
) -> None:
    code = WITHOUT + (
        "import numpy, nte; "
        "results = nte.denoise(nte.load_denoiser(sys.argv[1]), nte.Clip(sys.argv[2])); "
        "numpy.save(sys.argv[3], [result.image[0] for result in results])"
    )
    done = python(code, model, noisy_disc, tmp_path / "images.npy")
    assert done.returncode == 0, done.stderr
    running = Session(network)
    expected = [running.denoise(frame)[0] for frame in Clip(noisy_disc)]
    np.testing.assert_allclose(np.load(tmp_path / "images.npy"), expected, rtol=1e-3, atol=1e-4)


def test_the_command_line_denoises_without_pytorch(model: Path, tmp_path: Path) -> None:
    clip = disc_clip(tmp_path / "clip", frames=2, seed=1)
    for spec in ("noisy", model):
        done = nte_without_extras("denoise", clip, "--denoiser", spec, "--out", tmp_path / Path(spec).stem, "--png")
        assert done.returncode == 0, done.stderr
        assert len(Clip(tmp_path / Path(spec).stem)) == 2
    viewed = nte_without_extras("view", clip, "--denoiser", model, "--out", tmp_path / "view", "--no-open")
    assert viewed.returncode == 0, viewed.stderr
    assert "pip install 'nte-denoiser[eval]'" in (tmp_path / "view" / "index.html").read_text("utf-8")
    for path in clip.glob("*.exr"):
        layers = {name: plane for name, plane in read_layers(path).items() if not name.startswith("reference")}
        write_exr(path, layers)
    assert (
        nte_without_extras("view", clip, "--denoiser", model, "--out", tmp_path / "bare", "--no-open").returncode == 0
    )
    page = (tmp_path / "bare" / "index.html").read_text("utf-8")
    assert "No scores: the clip has no reference." in page
    assert "pip install 'nte-denoiser[eval]'" not in page
    assert nte_without_extras("info", model).returncode == 0
    assert nte_without_extras("info", clip).returncode == 0


def test_what_needs_an_extra_says_which_in_one_line(noisy_disc: Path, tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("name: x")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.yaml").write_text("name: x")
    blender(tmp_path / "renders", scene(2))
    for extra, arguments in {
        "eval": ("denoise", noisy_disc, "--denoiser", "taa", "--out", tmp_path / "out"),
        "train": ("train", config),
        "render": ("render", config, "--out", tmp_path / "out"),
        "import": ("import", "blender", tmp_path / "renders", "--out", tmp_path / "out"),
    }.items():
        done = nte_without_extras(*arguments)
        assert done.returncode == 2, done.stderr
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert f"pip install 'nte-denoiser[{extra}]'" in done.stderr
    done = nte_without_extras("denoise", noisy_disc, "--denoiser", tmp_path / "run", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "pip install 'nte-denoiser[train]'" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_function_that_needs_an_extra_says_which() -> None:
    for name, package, extra in (
        ("check", "torch", "eval"),
        ("train", "torch", "train"),
        ("dual_motion", "torch", "eval"),
    ):
        done = python(WITHOUT + f"import nte; assert '{name}' in dir(nte); nte.{name}")
        needs = f"nte.{name} needs the package '{package}': pip install 'nte-denoiser[{extra}]'"
        assert f"ImportError: {needs}" in done.stderr
    done = python(WITHOUT + "import nte; nte.render('recipe.yaml', 'clips')")
    assert "ImportError: rendering needs the package 'torch': pip install 'nte-denoiser[render]'" in done.stderr


def test_another_renderers_frames_are_denoised_without_pytorch(model: Path, tmp_path: Path) -> None:
    """Such as Blender's: with motion, which is converted, and forward motion, which the next frame uses."""
    blender(tmp_path / "renders", scene(2))
    command = ["denoise", tmp_path / "renders", "--denoiser", model, "--out", tmp_path / "clean", "--png"]
    done = nte_without_extras(*command)
    assert done.returncode == 0, done.stderr
    assert "read as Blender Cycles" in done.stdout
    assert len([*(tmp_path / "clean").glob("*.png")]) == 2
    lines = (MAPS / "blender.yaml").read_text("utf-8").splitlines()
    kept = [line for line in lines if not line.lstrip().startswith("motion:")]
    (tmp_path / "forward.yaml").write_text("\n".join(kept), "utf-8")
    done = nte_without_extras(*command, "--force", "--map", tmp_path / "forward.yaml")
    assert done.returncode == 2
    assert "forward vectors alone needs the package 'torch': pip install 'nte-denoiser[import]'" in done.stderr
