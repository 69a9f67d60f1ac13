"""What a user types becomes a denoiser, or one line that says what there is."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch

from nte.denoiser import Denoiser, Filter, Noisy, Result, sanitised
from nte.errors import NteError
from nte.filters.estimated import EstimateOptions
from nte.filters.named import NAMES
from nte.filters.svgf import SvgfOptions
from nte.filters.taa import Taa, TaaOptions
from nte.filters.trmv.options import TrmvOptions
from nte.frames.channels import COMPONENTS
from nte.frames.frame import Frame
from nte.motion.search import SEARCHES
from nte.options import Options, Positive
from nte.registry import load_denoiser
from nte.session import Session
from tests.everything import floor_frame


@pytest.mark.parametrize("name", [name for name in NAMES if name != "oidn"])
def test_every_name_is_a_denoiser(name: str) -> None:
    assert isinstance(load_denoiser(name), Denoiser)


def test_what_training_and_export_return_can_be_loaded(tmp_path: Path) -> None:
    with pytest.raises(NteError, match="is no run folder"):
        load_denoiser(tmp_path)
    with pytest.raises(NteError, match=r"m\.onnx: does not exist"):
        load_denoiser(tmp_path / "m.onnx")


@pytest.mark.parametrize("name", ["composite", "estimate"])
def test_a_folder_wins_over_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).mkdir()
    with pytest.raises(NteError, match=f"'{name}' is no run folder: config.yaml is missing"):
        load_denoiser(name)


OWN = """
from nte import Denoiser, Result
from nte.filters.taa import Taa

class Mine(Taa):
    pass

class Plain(Denoiser):
    needs = ("color",)

    def step(self, frame, state, extras=()):
        return Result(0 * frame["color"]), ()

class Wanting(Plain):
    def __init__(self, weight):
        self.weight = weight
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of a module of denoisers."""
    name = f"own_{tmp_path.name}"
    (tmp_path / f"{name}.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    return name


def test_a_class_of_another_package_is_a_denoiser(own: str) -> None:
    assert load_denoiser(f"{own}:Mine:alpha=0.25").options.alpha == 0.25  # type: ignore[attr-defined]
    frame = Frame({"color": np.ones((1, 3, 4, 5), np.float32)})
    np.testing.assert_array_equal(load_denoiser(f"{own}:Plain").step(frame, None)[0].image, 0 * frame["color"])


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("{own}:Mine:alpha=2", "alpha"),
        ("{own}:Plain:alpha=2", "Plain is no Filter, so it has no options: leave out 'alpha=2'"),
        ("{own}:Nobody", "has no Denoiser of that name"),
        ("{own}:OWN", "has no Denoiser of that name"),
        ("{own}:Wanting", "Wanting cannot be made without arguments: .*weight"),
        ("{own}_not:Mine", "there is no module '.*_not': install it, or name its folder in PYTHONPATH"),
        ("{own}", "is no denoiser.*, or package.module:Class"),
    ],
)
def test_a_class_that_cannot_be_taken_is_told(own: str, spec: str, said: str) -> None:
    with pytest.raises(NteError, match=said) as error:
        load_denoiser(spec.format(own=own))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", NAMES)
def test_options_have_the_name_that_is_typed(name: str) -> None:
    module, kind, _ = NAMES[name]
    options = getattr(import_module(module), kind).options_type
    assert options.name == ("" if options is Options else name)
    for base in options.__mro__[1:]:  # which is called by a name that is typed, or by that of the Python class
        if issubclass(base, Options) and base is not Options:
            assert base.name in (*NAMES, base.__name__)


def test_options_become_the_types_of_their_fields() -> None:
    taa = load_denoiser("taa: clamp=clip , alpha=0.25")
    assert isinstance(taa, Taa)
    assert taa.options == TaaOptions(clamp="clip", alpha=0.25)
    assert isinstance(load_denoiser("noisy:"), Noisy)


def test_the_noisy_input_of_a_component_is_that_channel() -> None:
    frame = Frame({name: np.full((1, 3, 4, 5), i, np.float32) for i, name in enumerate(("color", "indirect"))})
    noisy = load_denoiser("noisy:target=indirect")
    assert (noisy.needs, noisy.target) == (("indirect",), "indirect")
    assert noisy.step(frame, None)[0].image.max() == 1


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("nosy", "'nosy' is no denoiser, did you mean noisy[?] expected one of .*noisy, taa"),
        ("", "'' is no denoiser"),
        ("estimate+", "'' is no denoiser"),
        ("taa:clmp=none", "'taa:clmp=none': unknown option 'clmp', did you mean clamp[?] expected one of clamp, alpha"),
        ("taa:clamp", "'clamp' is no option: expected name:key=value"),
        ("taa:clamp=", "'clamp' is no option"),
        ("taa:alpha=0.1, alpha =0.2", "alpha is given twice, as '0.1' and '0.2'"),
        (f"taa:alpha={'9' * 400}", "taa: alpha is inf"),
        (f"taa:clamp={'x' * 5000}", "taa: clamp is 'xxx"),
        ("svgf:young=nan", "svgf: young is nan, expected a finite number of 0 or more"),
        ("taa:alpha=much", r"alpha is 'much', expected a weight of the current frame in \(0, 1\]"),
        ("svgf:iterations=2.5", "iterations is '2.5', expected a whole number"),
        ("taa:alpha=2", "taa: alpha is 2.0"),
        ("asvgf:young=-3", "asvgf: young is -3.0, expected a finite number of 0 or more"),
        ("svgf:iterations=17", "svgf: iterations is 17, expected a whole number from 0 to 16"),
        ("asvgf:gradient_iterations=100000", "asvgf: gradient_iterations is 100000, expected a whole number from 0 to"),
        ("taa:clamp=hard", "taa: clamp is 'hard', expected one of none, clamp, clip"),
        ("svgf:target=albedo", "svgf: target is 'albedo', expected one of .*, components"),
        (
            "align_accumulate:target=components",
            "^'align_accumulate:target=components': align_accumulate has no target visibility, which components need: "
            "expected a target out of color, indirect, glossy$",
        ),
        (
            "oidn:target=components",
            "oidn has no target visibility, which components need: expected a target out of colo",
        ),
        ("trmv:preset=best", "trmv: preset is 'best', expected one of paper, traditional, "),
        ("trmv:presets=paper", "unknown option 'presets', did you mean preset[?] expected one of target, .*, preset"),
        ("svgf:preset=paper", "unknown option 'preset', expected one of target, .*, depth_floor$"),
        ("estimate:noise=loud+taa", "estimate: noise is 'loud', expected one of auto, clean, "),
        ("taa:device=cpu", "unknown option 'device', expected one of clamp, alpha"),
        ("noisy:seed=1", "unknown option 'seed', expected one of target"),
        ("nowhere/model.onnx", r"nowhere/model\.onnx: does not exist"),
        ("runs/nowhere", "'runs/nowhere' is no denoiser"),
    ],
)
def test_what_is_typed_wrong_is_named_with_what_there_is(spec: str, message: str) -> None:
    with pytest.raises(NteError, match=message):
        load_denoiser(spec)


T = "shadow=traditional,glossy=traditional,occlusion=traditional,indirect=colour"
S = T.replace("glossy=traditional", "glossy=specular")
FREE, CLAMPED = "clamp=inf,cleanup=false", "clamp=1,neighbourhood=adjacent,cleanup=false"


@pytest.mark.parametrize(
    ("preset", "options"),
    [
        ("trmv:preset=paper", "trmv:reshading=paper,half_angle=30,warm_up=false"),
        ("trmv:preset=traditional", f"trmv:{T},{FREE}"),
        ("trmv:preset=traditional_clamp", f"trmv:{T},{CLAMPED}"),
        ("trmv:preset=gradient", f"trmv:{T.replace('traditional', 'gradient')},{FREE}"),
        ("trmv:preset=specular", f"trmv:{S},{FREE}"),
        ("trmv:preset=specular_clamp", f"trmv:{S},{CLAMPED}"),
        ("trmv:preset=dual_colours", "trmv:occlusion=dual,indirect=colour"),
        ("trmv:alpha=0.2,preset=traditional,clamp=2", f"trmv:{T},clamp=2,cleanup=false,alpha=0.2"),
        (
            "motion_blur:preset=paper,history=false",
            "motion_blur:prefilter=true,near=2.5,jitter=1.5,beta_a=1,beta_l=10,stretch=1,weight=1,fetch=kernel,"
            "static=reprojected,factor=share,history=false",
        ),
    ],
)
def test_a_preset_is_a_list_of_options_which_others_change(preset: str, options: str) -> None:
    made, spelt = load_denoiser(preset), load_denoiser(options)
    assert isinstance(made, Filter)
    assert isinstance(spelt, Filter)
    assert made.options == spelt.options
    assert (made.needs, made.optional) == (spelt.needs, spelt.optional)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "oidn"])
def test_every_denoiser_gives_the_extras_that_it_names_and_no_others(name: str) -> None:
    denoiser, frame = load_denoiser(name), floor_frame(0)
    result, _ = denoiser.step(frame, None, denoiser.extras)
    assert tuple(result.extras) == denoiser.extras
    assert set(denoiser.components) <= set(denoiser.extras)
    listed = ", ".join(denoiser.extras) or "none"
    with pytest.raises(NteError, match=f"has no extra 'taste'.* expected (one of )?{listed}$"):
        denoiser.step(frame, None, ("taste",))


@dataclass(frozen=True)
class DimmerOptions(Options, name="dimmer"):
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"dusk": {"factor": 0.25}}
    factor: Positive = 0.5


class Dimmer(Filter[DimmerOptions]):
    needs = ("color",)
    options_type = DimmerOptions

    @sanitised
    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        return Result(frame["color"] * self.options.factor), ()


def test_a_new_filter_is_a_class_and_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(NAMES, "dimmer", (__name__, "Dimmer", ""))
    frame = floor_frame(0)
    for spec, factor in (("dimmer", 0.5), ("dimmer:factor=2", 2.0), ("dimmer:preset=dusk", 0.25)):
        image = Session(load_denoiser(spec)).denoise(frame)
        assert isinstance(image, np.ndarray)
        np.testing.assert_allclose(image, factor * frame["color"], rtol=1e-6)
    with pytest.raises(NteError, match=r"dimmer: factor is -1\.0, expected a finite number above 0"):
        load_denoiser("dimmer:factor=-1")
    with pytest.raises(NteError, match=r"did you mean dimmer[?] expected one of .*noisy, .*, dimmer"):
        load_denoiser("dimer")


class Stranger:
    """Has what a denoiser needs, but inherits nothing."""

    needs = ("color",)

    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        return Result(frame["color"]), ()


class Plain(Stranger, Denoiser):
    """A denoiser that no options can be typed for."""


@pytest.mark.parametrize("kind", [Stranger, Plain])
@pytest.mark.parametrize(
    "spec", ["stranger", "stranger:target=glossy", "composite:visibility=noisy,glossy=stranger,indirect=noisy"]
)
def test_a_row_that_names_no_filter_is_one_line(monkeypatch: pytest.MonkeyPatch, kind: type, spec: str) -> None:
    monkeypatch.setitem(NAMES, "stranger", (__name__, kind.__name__, ""))
    with pytest.raises(NteError, match=f"test_registry:{kind.__name__} is no Filter: expected a subclass with options"):
        load_denoiser(spec)


def test_options_of_another_filter_are_refused() -> None:
    with pytest.raises(NteError, match="Taa takes TaaOptions, not SvgfOptions"):
        Taa(SvgfOptions())  # type: ignore[arg-type]
    with pytest.raises(NteError, match="Taa takes TaaOptions, not 'none'"):
        Taa("none")  # type: ignore[arg-type]


def test_choices_that_a_type_spells_out_are_those_of_the_table() -> None:
    assert EstimateOptions.choices("noise") == ("auto", *SEARCHES)
    assert TaaOptions.choices("target") == TrmvOptions.choices("target") == ("color", *COMPONENTS)


PAGES = {  # page → what it documents: a table of options each
    "trmv.md": ("trmv",),
    "motion_blur.md": ("motion_blur", "post_blur", "mcguire"),
}


@pytest.mark.parametrize("page", PAGES)
def test_a_page_names_the_options_and_presets_that_there_are(page: str) -> None:
    text = (Path(__file__).parents[1] / "docs" / page).read_text()
    kinds = [load_denoiser(name).options_type for name in PAGES[page]]  # type: ignore[attr-defined]
    there = {option for kind in kinds for option in kind.names()} - {"preset"}
    documented, table = set(), re.search(r"\n\| option \|.*?\n\n", text, re.DOTALL)
    assert table
    for row in table[0].strip().splitlines()[2:]:
        documented |= set(re.findall(r"`(\w+)`", row.split("|")[1]))
    assert documented <= there
    for name in there | {preset for kind in kinds for preset in kind.presets}:
        assert re.search(rf"`(preset=)?{name}`|:preset={name}\b", text), name


def test_a_folder_hides_a_name_only_if_it_is_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "noisy").mkdir()  # such as the output of an earlier nte denoise
    assert isinstance(load_denoiser("noisy"), Noisy)
    (tmp_path / "clip").mkdir()
    with pytest.raises(NteError, match=r"'clip' is no run folder: config\.yaml is missing"):
        load_denoiser("clip")
    (tmp_path / "noisy" / "config.yaml").write_text("name: x")
    with pytest.raises(NteError, match=r"noisy/config\.yaml: "):
        load_denoiser("noisy")


@pytest.mark.parametrize("device", ["cuda", "cuda:3", "abacus"])
def test_a_device_that_is_not_there_is_named(device: str) -> None:
    if torch.cuda.is_available():
        pytest.skip("it is there")
    with pytest.raises(NteError, match=f"--device {device}: ") as error:
        load_denoiser("taa", device)
    assert "\n" not in str(error.value)
    assert isinstance(load_denoiser("noisy", device), Noisy)  # which needs none
