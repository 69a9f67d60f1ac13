"""Configurations: what is typed is taken, and everything else is refused by file and key in one line."""

from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

from nte.config import load_config, to_yaml
from nte.errors import NteError
from nte.evaluation.comparison.read import read_comparison
from nte.importing.channel_map import load_channel_map
from nte.models.cost import macs_per_pixel
from nte.models.rae import RaeConfig
from nte.models.registry import make_network
from nte.models.temporal import TemporalConfig
from nte.registry import load_denoiser
from nte.render.recipes.recipe import Recipe, plan, read_recipe
from nte.render.world.keyframes import read_animation
from nte.training.config import load_train_config, read_train_config

GOOD = "name: x\ndata:\n  clips: [a]\nphases:\n  - {steps: 3}\n"
ROOT = Path(__file__).parents[1]


def written(folder: Path, text: str | bytes = GOOD) -> Path:
    path = folder / "c.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@dataclass
class Size:
    width: int = 1


def require_width(size: Size) -> None:
    if size.width < 1:
        raise NteError(f"'width' is {size.width}, expected at least 1")


def test_a_value_that_the_schema_s_own_check_refuses_is_told_with_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, "width: 0\n")
    assert load_config(Size, path).width == 0
    assert load_config(Size, path, ["width=3"], check=require_width) == Size(3)
    with pytest.raises(NteError) as error:
        load_config(Size, path, check=require_width)
    assert str(error.value) == f"{path}: 'width' is 0, expected at least 1"


def test_file_then_overrides_over_the_defaults(tmp_path: Path) -> None:
    config = load_train_config(
        written(tmp_path, GOOD + "seed: 5\n"),
        ["data.clips=[b,c]", "phases[0].steps=7", "name=run_${seed}", "optimiser.learning_rate=1e-3"],
    )
    assert config.data.clips == ["b", "c"]
    assert config.phases[0].steps == 7
    assert config.name == "run_5"
    assert config.optimiser.learning_rate == 1e-3
    assert config.data.frames == 9


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    config = load_train_config(written(tmp_path), ["network.channels=[4,8,8]", "loss.space=display"])
    again = read_train_config(written(tmp_path, to_yaml(config)))
    assert again == config


SHIPPED = sorted([*ROOT.glob("configs/*.yaml"), *ROOT.glob("configs/neural/*.yaml")])
COMPARISONS = [path for path in SHIPPED if path.stem.startswith("compare_")]


@pytest.mark.parametrize("path", [path for path in SHIPPED if path not in COMPARISONS], ids=lambda path: path.name)
def test_shipped_configurations_are_valid(path: Path) -> None:
    assert load_train_config(path, []).name == path.stem


@pytest.mark.parametrize("path", COMPARISONS, ids=lambda path: path.name)
def test_shipped_comparisons_name_denoisers_and_clips_of_their_recipes(path: Path) -> None:
    comparison = read_comparison(path)
    recipes = {folder: load_config(Recipe, Path(recipe)) for folder, recipe in comparison.recipes.items()}
    clips = [Path(folder, unit.folder) for folder, recipe in recipes.items() for unit in plan(recipe)]
    patterns = [pattern for situation in comparison.situations for pattern in situation.clips]
    patterns += [pattern for table in comparison.tables for part in table.columns for pattern in part.clips]
    patterns += [plot.clip for plot in comparison.plots]
    assert not [pattern for pattern in patterns if not any(clip.match(pattern) for clip in clips)]
    assert not [folder for folder in comparison.train if not any(clip.is_relative_to(folder) for clip in clips)]
    for situation in comparison.situations:
        for spec in situation.methods.values():
            if "{" not in spec:  # the run of a network
                load_denoiser(spec)
    for network in comparison.networks.values():
        load_train_config(Path(network.config), [*comparison.overrides, *network.overrides])


# What each rival changes of the whole network, besides its name; losses and networks are compared key by key.
RIVALS = {
    "ours": {},
    "c": {},
    "b": {"loss.occlusion": 0.0},
    "a": {"loss.occlusion": 0.0, "network.motion": "traditional"},
    "ntasd": {"loss.occlusion": 0.0, "network.motion": "traditional"},
    "ntasd_no_feedback": {"loss.occlusion": 0.0, "network.motion": "traditional", "network.feed_warped": False},
    "kpcn": {"network.scales": 1, "network.temporal": False, "network.feed_warped": False},
    "no_temporal_kernel": {"network.temporal": False},
    "mean": {"network.downsample": "mean"},
    "scales_1": {"network.scales": 1},
    "scales_2": {"network.scales": 2},
    "scales_4": {"network.scales": 4},
    "demodulate": {"network.demodulate": True},
    "demodulate_mean": {"network.demodulate": True, "network.downsample": "mean"},
    "loss_linear": {"loss.space": "linear"},
    "loss_display": {"loss.space": "display"},
    "feature_history": {"network.feature_history": 8},
}


def flat(values: dict[str, object], prefix: str = "") -> dict[str, object]:
    found: dict[str, object] = {}
    for key, value in values.items():
        found |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return found


def test_rivals_differ_in_what_their_names_say() -> None:
    whole = flat(asdict(load_train_config(ROOT / "configs" / "paper_small.yaml", [])))
    assert {path.stem for path in (ROOT / "configs" / "neural").iterdir()} == {*RIVALS, "rae", "separated", "color"}
    for name, changes in RIVALS.items():
        rival = flat(asdict(load_train_config(ROOT / "configs" / "neural" / f"{name}.yaml", [])))
        assert rival == whole | changes | {"name": name}
    rae = load_train_config(ROOT / "configs" / "neural" / "rae.yaml", [])
    assert rae.network.kind == "rae"
    found = flat(asdict(rae))
    assert {key for key in whole if not key.startswith("network.") and found[key] != whole[key]} == {
        "name",
        "loss.occlusion",
    }
    ours = make_network(load_train_config(ROOT / "configs" / "neural" / "ours.yaml", []).network)
    counts = [sum(p.numel() for p in network.parameters()) for network in (make_network(rae.network), ours)]
    assert counts == [130_457, 131_079]  # as the configuration says


def test_color_costs_as_much_as_separate_lights() -> None:
    names = ("separated", "color")
    networks = [load_train_config(ROOT / "configs" / "neural" / f"{name}.yaml", []).network for name in names]
    costs = [sum(map(sum, macs_per_pixel(make_network(network)).values())) for network in networks]
    assert costs == [pytest.approx(27_600, rel=0.01)] * 2  # as the configuration says


def test_a_file_holds_what_differs_from_its_base(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    written(tmp_path, GOOD + "seed: 5\nnetwork: {channels: [4, 8], front: 2, scales: 1}\n")
    middle, top = tmp_path / "below" / "middle.yaml", tmp_path / "below" / "top.yaml"
    middle.write_text("base: ../c.yaml\nnetwork: {channels: [4]}\nphases: [{epochs: 2}]\n")
    top.write_text("base: middle.yaml\nname: top\n")
    config = load_train_config(top, ["network.front=1"])
    assert (config.name, config.seed) == ("top", 5)
    assert config.network == TemporalConfig(channels=[4], front=1, scales=1)
    assert [(phase.epochs, phase.steps) for phase in config.phases] == [(2, 0)]
    top.write_text("base: middle.yaml\nnetwork: {kind: rae}\n")  # whose keys are others
    assert load_train_config(top, []).network == RaeConfig()


def test_bases_that_are_none(tmp_path: Path) -> None:
    path = written(tmp_path, "base: other.yaml\n")
    other = tmp_path / "other.yaml"
    with pytest.raises(NteError, match=r"other\.yaml: cannot be read: No such file"):
        load_train_config(path, [])
    other.write_text("base: c.yaml\n")
    with pytest.raises(NteError, match=r"other\.yaml: 'base' is 'c\.yaml', which is based on this file"):
        load_train_config(path, [])
    other.write_text(GOOD + "runs: ${oc.env:HOME}\n")
    with pytest.raises(NteError, match=r"other\.yaml: 'runs': .* calls a resolver"):
        load_train_config(path, [])
    for text in ("base: [a]\n", "base: 3\n", "base:\n"):
        with pytest.raises(NteError, match=r"c\.yaml: 'base' is .*, expected the path of a file, relative to this one"):
            load_train_config(written(tmp_path, text), [])


def test_phases_in_epochs_or_steps(tmp_path: Path) -> None:
    config = load_train_config(written(tmp_path), ["phases=[{epochs: 2},{steps: 5, occlusion: 0.5}]"])
    assert [phase.length(epoch=10) for phase in config.phases] == [20, 5]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("nope=1", "command line: 'nope': unknown key, expected one of name, "),
        ("data.nope=1", "command line: 'data.nope': unknown key, expected one of clips, frames, "),
        ("data.clip=x", "command line: 'data.clip': unknown key, did you mean clips[?] expected one of clips, "),
        ("data.frames=many", "command line: 'data.frames': 'many' is given, expected a whole number$"),
        ("data.frames=1.5", "command line: 'data.frames': 1.5 is given, expected a whole number$"),
        ("data.frames=null", "command line: 'data.frames': null is given, expected a whole number$"),
        ("data=3", "command line: 'data': 3 is given, expected keys with values$"),
        ("data.clips=x", "command line: 'data.clips': 'x' is given, expected a list$"),
        ("network.channels=[8,x]", r"command line: 'network.channels\[1\]': 'x' is given, expected a whole number$"),
        ("phases=3", "command line: 'phases': 3 is given, expected a list$"),
        ("phases={steps: 1}", "command line: 'phases': expected a list$"),
        ("phases=[3]", r"command line: 'phases\[0\]': 3 is given, expected keys with values$"),
        ("phases=[{steps: x}]", "command line: 'steps': 'x' is given, expected a whole number$"),
        ("resume=maybe", "command line: 'resume': 'maybe' is given, expected true or false$"),
        ("optimiser.learning_rate=fast", "learning_rate': 'fast' is given, expected a number$"),
        ("data.frames", "'data.frames': expected key=value"),
        ("data.frames=[1", "command line: not readable as YAML: did not find expected"),
        ("name=a: b: c", "command line: not readable as YAML: mapping values"),
        ("name=\0", "command line: not readable as YAML: unacceptable character"),
        ("network.channels=[[4],4]", r"'network.channels\[0\]': \[4\] is given, expected a whole number"),
        ("loss.space=${oc.env:HOME}", "command line: 'loss.space': .* calls a resolver"),
        ("loss.space=${${name}:LANG}", "command line: 'loss.space': .* calls a resolver"),
        ("loss.space=${nope}", "c.yaml: 'loss.space': .*'nope' not found"),
        ("name=${name}", "c.yaml: 'name': Recursive"),
        ("name=../x", "c.yaml: 'name' is '../x', expected the name of a folder"),
        ("name=/x", "c.yaml: 'name' is '/x'"),
        ("name=..", "c.yaml: 'name'"),
        ("name=''", "c.yaml: 'name' is ''"),
        ("seed=-1", "c.yaml: 'seed' is -1, expected 0 to"),
        ("seed=4294967296", "c.yaml: 'seed'"),
        ("data.batch=0", "c.yaml: 'data.batch' is 0, expected at least 1"),
        ("data.crop=-8", "c.yaml: 'data.crop' is -8"),
        ("data.holdout=-1", "c.yaml: 'data.holdout'"),
        ("data.workers=-1", "c.yaml: 'data.workers'"),
        ("data.warmup=9", "c.yaml: 'data.warmup' is 9, expected less than data.frames"),
        ("validate_clips=0", "c.yaml: 'validate_clips'"),
        ("log_every=0", "c.yaml: 'log_every'"),
        ("optimiser.name=sgd", "c.yaml: 'optimiser.name' is 'sgd', expected one of adam, adamw"),
        ("optimiser.schedule=step", "c.yaml: 'optimiser.schedule'"),
        ("optimiser.learning_rate=.nan", "c.yaml: 'optimiser.learning_rate' is nan"),
        ("optimiser.learning_rate=.inf", "c.yaml: 'optimiser.learning_rate' is inf"),
        ("optimiser.ema=1.5", "c.yaml: 'optimiser.ema' is 1.5, expected 0 to 1"),
        ("precision=16", "c.yaml: 'precision' is '16', expected one of"),
        ("network.front=3", "c.yaml: network.front is 3"),
        ("loss.mask_weights=[]", "c.yaml: loss.mask_weights is empty"),
        ("loss.spatial=-1", "c.yaml: 'loss.spatial' is -1"),
        ("phases=[]", "c.yaml: 'phases' is empty"),
        ("phases=[{occlusion: 1}]", r"c.yaml: 'phases\[0\]' needs either"),
        ("phases=[{epochs: 1, steps: 5}]", r"c.yaml: 'phases\[0\]' needs either"),
        ("phases=[{epochs: -1, steps: 5}]", r"c.yaml: 'phases\[0\].epochs' is -1"),
    ],
)
def test_a_wrong_override_is_named(tmp_path: Path, override: str, message: str) -> None:
    with pytest.raises(NteError, match=message) as error:
        load_train_config(written(tmp_path), [override])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "'data.clips' is missing: give it a value"),
        ("42", "expected a YAML mapping"),
        ("[1, 2]", "expected a YAML mapping"),
        ("name: x\nseed: [1", "not readable as YAML: .* in line 3"),
        ("name: x\nname: y\n", "duplicate key name in line 2"),
        (b"\xff\xfe\x00", "not readable as YAML"),
        ("name: !!python/object/apply:os.getcwd []\n", "could not determine a constructor"),
        ("name: ${oc.env:HOME}\n" + GOOD[8:], "'name': .* calls a resolver"),
        # The resolver's name is that of another key: a LANG of «C» would be a good name for a run.
        ("runs: oc.env\nname: ${${runs}:LANG}\n" + GOOD[8:], "'name': .* calls a resolver"),
        ("runs: oc\nname: ${${runs}.env:LANG}\n" + GOOD[8:], "'name': .* calls a resolver"),
        ("runs: oc.env\nname: '${ ${runs} : LANG }'\n" + GOOD[8:], "'name': .* calls a resolver"),
        ("data: {clips: ['${oc.env:HOME}']}", r"'data.clips\[0\]': .* calls a resolver"),
        (GOOD + "sed: 1\n", "'sed': unknown key, did you mean seed[?] expected one of name, seed, "),
        (GOOD + "seed: one\n", "'seed': 'one' is given, expected a whole number$"),
    ],
)
def test_a_wrong_file_is_named_with_its_key_or_line(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(NteError, match=r"c\.yaml: .*" + message) as error:
        load_train_config(written(tmp_path, text), [])
    assert "\n" not in str(error.value)


NONSENSE = [
    "!!set {a, b}", "name: !!set {x, y}", "2020-01-01: 1", "name: 2020-01-01", "? \n: 1", "null: 1", "name: null",
    "name: '${'", "name: ${a", "name: ${..}", "name: ${name}", "a: ${b}\nb: ${a}", "name: ${oc.env:HOME}",
    "runs: oc.env\nname: ${${runs}:HOME}", "name: ${${runs}}", "name: ${ oc.env : HOME }", "[1,2", "a: &a [*a]",
    "name: " + "[" * 3000 + "]" * 3000, "name: " + "{a: " * 500 + "1" + "}" * 500, "- a", "3", "''",
    "name: !!python/object/apply:os.system ['echo hi']", "1.5: 3", "true: x", "seed: .nan", "seed: 1e400", "data: 5",
    "train: [null]", "situations: [{name: [a]}]", "channels: {null: x}", "channels: {color: {a: b}}", "xml: 5",
    "seed: " + "9" * 400, "xml: " + "x" * 300, '"\\ud800": 1', 'name: "\\ud800\\n\\x1b[31m"',
    "xml: x\ncamera: [{frame: " + "9" * 400 + ", origin: [0, 0, 1], target: [0, 0, 0]}]",
    "channels: {color: {layer: R, scale: " + "9" * 400 + "}}",
    "xml: x\nobjects: {a: 5}", "name: a\nname: b", "\0", "%YAML 3.0\n---\na: 1", "--- a\n--- b", "name: ???", "<<: 3",
]  # fmt: skip
READERS = [lambda path: load_train_config(path, []), read_recipe, read_comparison, load_channel_map, read_animation]


@pytest.mark.parametrize("text", NONSENSE, ids=range(len(NONSENSE)))
def test_what_nobody_can_mean_is_one_line_for_every_reader(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    for read in READERS:
        with pytest.raises(NteError, match=r"c\.yaml: ") as error:
            read(path)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("read", "text", "said"),
    [
        (read_recipe, "nam: x", "'nam': unknown key, did you mean name[?] expected one of name, seed, train, test$"),
        (
            read_comparison,
            "situation: []",
            "'situation': unknown key, did you mean situations[?] expected one of recipes, ",
        ),
        (
            load_channel_map,
            "motion: {unt: uv}",
            "'motion.unt': unknown key, did you mean unit[?] expected one of points, ",
        ),
        (
            load_channel_map,
            "channels: {color: {layr: a}}",
            "'channels.color.layr': unknown key, did you mean layer[?] ",
        ),
        (read_animation, "objcts: {}", "'objcts': unknown key, did you mean objects[?] expected one of xml, "),
    ],
)
def test_an_unknown_key_is_told_with_those_that_there_are(tmp_path: Path, read, text: str, said: str) -> None:
    with pytest.raises(NteError, match=r"c\.yaml: " + said) as error:
        read(written(tmp_path, text))
    assert "\n" not in str(error.value)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(NteError, match=r"c\.yaml: cannot be read: No such file"):
        load_train_config(tmp_path / "c.yaml", [])
    with pytest.raises(NteError, match="cannot be read: Is a directory"):
        load_train_config(tmp_path, [])
