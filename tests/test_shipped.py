"""The configurations and recipes that come with nte, in a clone and in a wheel."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from nte.evaluation.comparison.read import read_comparison
from nte.shipped import shipped
from nte.training.config import load_train_config

ROOT = Path(__file__).parents[1]
RECIPE = Path("datasets/quickstart.yaml")


def test_a_file_that_exists_is_the_user_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert shipped(RECIPE) == ROOT / RECIPE
    RECIPE.parent.mkdir()
    RECIPE.write_text("name: mine\n")
    assert shipped(RECIPE) == RECIPE


@pytest.mark.parametrize("path", ["quickstart.yaml", "configs/none.yaml", "configs/../LICENSE", "/configs/paper.yaml"])
def test_every_other_path_stays(path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert shipped(Path(path)) == Path(path)


def test_one_that_ships_is_based_on_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_train_config(Path("configs/neural/b.yaml"), []).data.clips == ["data/paper-small/train"]


def test_a_file_of_ones_own_is_based_on_one_that_ships(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text("base: configs/neural/c.yaml\nname: mine\n")
    assert load_train_config(Path("mine.yaml"), []).data.clips == ["data/paper-small/train"]
    Path("configs/neural").mkdir(parents=True)
    Path("configs/neural/c.yaml").write_text("base: configs/quickstart.yaml\n")  # one that is there comes first
    assert load_train_config(Path("mine.yaml"), []).data.clips == ["data/quickstart/train"]


def test_a_comparison_of_ones_own_names_what_ships(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(
        "recipes: {q: datasets/quickstart.yaml}\nnetworks: {C: {config: configs/neural/c.yaml}}\nseeds: [1]\n"
        "situations: [{name: s, clips: [q/test/*], networks: [C], light: indirect}]\nagainst: C\n"
    )
    found = read_comparison(Path("mine.yaml"))
    assert Path(found.networks["C"].config).is_file()
    assert Path(found.recipes["q"]).is_file()


@pytest.mark.slow
def test_a_wheel_has_all_that_is_not_code_and_works_without_the_repository(tmp_path: Path) -> None:
    build = ["pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path, ROOT]
    subprocess.run([sys.executable, "-m", *build], check=True)
    (wheel,) = tmp_path.glob("nte_denoiser-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        archive.extractall(tmp_path / "site")
    expected = {
        f"nte/{path.relative_to(folder)}"
        for folder, pattern in ((ROOT, "configs/**/*.yaml"), (ROOT, "datasets/**/*.yaml"), (ROOT / "nte", "**/*.*"))
        for path in folder.glob(pattern)
        if path.suffix != ".pyc"
    }
    assert expected <= names
    licences = {name.partition(".dist-info/licenses/")[2] for name in names} - {""}
    assert licences == {"LICENSE", "nte/viewer/bundle/THIRD_PARTY_LICENSES.txt"}
    assert {name.split("/")[0] for name in names} == {"nte", wheel.name.split("-py3")[0] + ".dist-info"}
    code = "import sys; sys.path.insert(0, sys.argv.pop(1)); from nte.cli import main; sys.exit(main(sys.argv[1:]))"
    (tmp_path / "empty").mkdir()
    shown = subprocess.run(
        [sys.executable, "-I", "-c", code, tmp_path / "site", "info", "configs/neural/b.yaml"],
        cwd=tmp_path / "empty", capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "parameters" in shown.stdout
