"""Every command that a page shows: the real parsers take it, and its options and denoisers exist."""

import argparse
import re
import shlex
import shutil
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

from nte.cli import _parser, main
from nte.filters.estimated import EstimateOptions
from nte.filters.named import NAMES, filter_type, parse
from nte.registry import parts_of
from nte.training.config import load_train_config
from tests.evaluation.conftest import noisy_frames
from tests.importing.producers import blender, scene
from tests.synthetic import write_clip
from tests.test_pages import PAGES, ROOT, blocks
from tests.training.runs import CONFIG

INDENTED = re.compile(r"\n\n((?:    .*\n)+)")
INLINE = re.compile(r"(?<!`)`([^`\n]+(?:\n[^`\n]+)?)`(?!`)")
PARTIAL = re.compile(r"…|\[-|\|")  # a synopsis: `nte bench SPEC… [--json FILE]`
SPEC = re.compile(rf"(?:{'|'.join(NAMES)}|estimate):[\w.,=-]+")


class Shown(NamedTuple):
    """A command of a page."""

    page: str
    text: str
    is_whole: bool  # in a block, and no synopsis; anything else only names a subcommand and options


def commands(page: Path, program: str) -> Iterator[Shown]:
    """Each command of a page that begins with `program`."""
    text, name = page.read_text("utf-8"), page.relative_to(ROOT).as_posix()
    for block in (*blocks(text), *INDENTED.findall(text)):
        for line in block.replace("\\\n", " ").splitlines():
            if line.strip().startswith(f"{program} "):
                command = re.sub(r"\s+#\s.*", "", line.strip())
                yield Shown(name, command, not PARTIAL.search(command))
    for code in INLINE.findall(text):
        if code.startswith(f"{program} "):
            yield Shown(name, " ".join(code.split()), False)


def all_commands(program: str) -> list[Shown]:
    return sorted({shown for page in PAGES for shown in commands(page, program)})


def parsed(words: list[str]) -> argparse.Namespace:
    """The options that `nte` makes of a whole command."""
    options, rest = _parser().parse_known_args(words)
    assert not rest or (hasattr(options, "overrides") and all("=" in word for word in rest)), rest
    if hasattr(options, "overrides"):
        options.overrides += rest
    return options


def options_of(words: list[str]) -> set[str]:
    """The names of the options that a subcommand of `nte` has."""
    parser = _parser()
    for word in words:
        inside = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
        if not inside:
            break
        if word in ("…", "--help", "--version"):
            return {"--help", "--version"}
        assert word in inside[0].choices, f"{word} is no subcommand"
        parser = inside[0].choices[word]
    return {name for action in parser._actions for name in action.option_strings}


def require_options(spec: str) -> None:
    """Fail if `spec` sets an option that its denoiser does not have; runs and models have none."""
    wrapper, plus, inner = spec.partition("+")
    if plus:
        EstimateOptions.parse(parse(spec, wrapper.partition(":")[2]), spec)
        return require_options(inner)
    for part in parts_of(spec):
        name, _, text = part.partition(":")
        if name == "estimate":
            EstimateOptions.parse(parse(part, text), part)
        elif name in NAMES:
            given = parse(part, text)
            given.pop("target") if given.get("target") == "components" else None
            filter_type(part).options_type.parse(given, part)
        else:
            assert "/" in part or part.endswith(".onnx") or part == "SPEC", f"{part} is no denoiser"
    return None


@pytest.mark.parametrize("shown", all_commands("nte"), ids=lambda shown: f"{shown.page}: {shown.text}")
def test_the_command_takes_what_a_page_shows(shown: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    words = shlex.split(shown.text)[1:]
    if not shown.is_whole:
        assert {word.strip("[]") for word in words if re.match(r"\[?--", word)} <= options_of(words)
        return
    options = parsed(words)
    for name in ("denoiser", "denoisers", "specs"):
        given = getattr(options, name, None) or []
        for spec in [given] if isinstance(given, str) else given:
            require_options(spec)
    if options.command == "train" and options.config.is_file():
        load_train_config(options.config, options.overrides)


@pytest.mark.parametrize("shown", all_commands("python -m"), ids=lambda shown: f"{shown.page}: {shown.text}")
def test_a_benchmark_has_the_options_that_a_page_shows(shown: Shown, capsys: pytest.CaptureFixture[str]) -> None:
    words = shlex.split(shown.text.replace("…", ""))[2:]
    if not words[0].startswith("benchmarks.") or "NAME" in words[0]:
        return
    with pytest.raises(SystemExit):
        import_module(words[0]).main(["--help"])
    known = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    assert {word.strip("[]") for word in words[1:] if re.match(r"\[?--", word)} <= known


def test_make_has_every_target_that_a_page_names() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    named = {word for shown in all_commands("make") for word in re.findall(r"make ([a-z]+)", shown.text)}
    assert named <= targets
    assert "demo" in named


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_options_of_denoisers_in_a_page_exist(page: Path) -> None:
    for code in INLINE.findall(page.read_text("utf-8")):
        for spec in SPEC.findall(code):
            if "key=value" not in spec:
                require_options(spec.rstrip(",="))


def test_what_is_wrong_is_found() -> None:
    with pytest.raises(SystemExit):
        parsed(shlex.split("denoise clip --denoiser taa"))
    with pytest.raises(AssertionError, match="--denoizer"):
        parsed(shlex.split("denoise clip --denoizer taa --out out"))
    with pytest.raises(AssertionError, match="--noize"):
        parsed(shlex.split("estimate clip --out out --noize clean"))
    with pytest.raises(AssertionError, match="denoize is no subcommand"):
        options_of(["denoize", "--out"])
    assert "--steps" in options_of(["bench", "SPEC"])
    assert "--vectors" not in options_of(["bench", "SPEC"])
    with pytest.raises(Exception, match="unknown option 'sigma'"):
        require_options("composite:visibility=trmv,glossy=[svgf:sigma=2],indirect=runs/mine")
    with pytest.raises(Exception, match="unknown option 'noize'"):
        require_options("estimate:noize=clean+taa")
    assert [shown.text for shown in commands(ROOT / "README.md", "nte") if "oidn:quality=fast" in shown.text] == [
        "nte bench    svgf asvgf oidn:quality=fast --size 1280x720"
    ]


RUN = ("check", "denoise", "estimate", "evaluate", "export", "info", "import")  # neither renders nor trains for long


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what pages name: clips, a renderer's frames, a run and its model, recipes and configurations."""
    folder = tmp_path_factory.mktemp("made")
    for clip in ("data/quickstart/test/rooms_000", "data/mine", "data/engine"):
        write_clip(folder / clip, noisy_frames(3))
    for source in ("renders/noisy", "renders/clean"):
        blender(folder / source, scene(3), old_names=False)
    for name in ("configs", "datasets"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "tiny.yaml").write_text(CONFIG.format(clip="data/mine", runs="runs"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["train", "tiny.yaml", "name=mine", "phases=[{steps: 2}]", "--device", "cpu"]) == 0
        assert main(["export", "runs/mine", "--out", "demo/quickstart.onnx"]) == 0
        shutil.copy("demo/quickstart.onnx", "mine.onnx")
    return folder


def inputs(words: list[str]) -> list[str]:
    """What a command reads: its words up to --out that are paths, or name a run or a model among denoisers."""
    written = {
        words[i + 1] for i, word in enumerate(words[:-1]) if word in ("--out", "--picture", "--vectors", "--json")
    }
    paths = [word for word in words[1:] if re.fullmatch(r"[\w.-]+(/[\w.-]*)+|[\w-]+\.(onnx|yaml)", word)]
    return [path for path in paths if path not in written]


def test_inputs_of_a_command() -> None:
    words = shlex.split("evaluate --clips data/a --denoisers taa:alpha=0.2 runs/b c.onnx --out reports/d")
    assert inputs(words) == ["data/a", "runs/b", "c.onnx"]


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md", "docs/start_artist.md", "docs/start_engine.md", "docs/symptoms.md"])
def test_commands_of_a_page_run(page: str, made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that take seconds, on small files in the place of what they name."""
    monkeypatch.chdir(made)
    ran = 0
    for shown in commands(ROOT / page, "nte"):
        words = shlex.split(shown.text)[1:]
        if shown.is_whole and words[0] in RUN and all(Path(path).exists() for path in inputs(words)):
            assert main([*words, *(["--force"] if words[0] != "info" else [])]) == 0, shown.text
            ran += 1
    assert ran >= 3
