"""The reading of a comparison from YAML, and the checks of its values, before anything is rendered or trained."""

from collections.abc import Iterable
from pathlib import Path

from nte.config import load_config
from nte.errors import NteError, expected_one_of
from nte.evaluation.comparison.schema import RUN_OF, Columns, Comparison, Situation, Table
from nte.evaluation.metric_table import METRICS
from nte.evaluation.metrics import REGIONS
from nte.evaluation.table_files import CSV, LATEX
from nte.files import is_folder_name
from nte.frames.channels import TARGETS
from nte.shipped import beside, shipped
from nte.viewer.recorder import INPUT, REFERENCE

_NAMES = tuple(metric.name for metric in METRICS)
_OF_A_CLIP = "ms_per_frame"  # the metric without a value for each frame
_RESULTS = ("comparison.yaml", "summary.json", "tables.md", CSV, LATEX)  # beside the folders of situations
# Keys of a training configuration that the comparison decides.
_DECIDED = {
    "seed": "give the network 'seeds'", "name": "a run has the network's title", "runs": "use --runs",
    "resume": "trainings always go on where they stopped",
}  # fmt: skip


def read_comparison(path: Path) -> Comparison:
    """Read and check a comparison; recipes and training configurations become paths that can be opened.

    Paths of a `base` (nte.config) are relative to this file, too.

    Raises NteError, naming the file and the key, for a comparison that is not valid.
    """
    path = shipped(path)
    comparison = load_config(Comparison, path, check=_check)
    comparison.recipes = {folder: str(beside(path, recipe)) for folder, recipe in comparison.recipes.items()}
    for network in comparison.networks.values():
        network.config = str(beside(path, network.config))
    if not comparison.tables:
        comparison.tables = [_whole(situation, comparison.against) for situation in comparison.situations]
    return comparison


def _whole(situation: Situation, against: str) -> Table:
    """The table of a situation: RMSE and SSIM of its light, also in its region, and of the composite."""
    parts = dict.fromkeys([(situation.light, "all"), (situation.light, situation.region), ("color", "all")])
    columns = [Columns(light=light, region=region, metrics=["rmse", "ssim"]) for light, region in parts]
    for part in columns:
        if against and (part.light, part.region) == (situation.light, situation.region):
            part.margins = ["rmse"]
    return Table(situation.name, situation.name, against=against, columns=columns)


def _check(comparison: Comparison) -> None:
    for key, folders in (("recipes", comparison.recipes), ("train", comparison.train)):
        for folder in folders:
            if Path(folder).is_absolute() or ".." in Path(folder).parts:
                raise NteError(f"{key}: '{folder}' leads out of the data's folder: expected a folder in it, or .")
    if not comparison.situations:
        raise NteError("'situations' is empty: expected at least one")
    for title in comparison.networks:
        _check_network(comparison, title)
    for number, situation in enumerate(comparison.situations):
        _check_situation(f"situations[{number}]", situation, comparison)
    names = [situation.name for situation in comparison.situations]
    _refuse_twice("two situations are called", names)
    files = {*_RESULTS, *(f"{plot.name}.svg" for plot in comparison.plots)}
    if taken := [name for name in names if name in files]:
        raise NteError(f"a situation is called '{taken[0]}', as a file of the results is: give it another name")
    for key, entries in (("tables", comparison.tables), ("plots", comparison.plots)):
        _refuse_twice(f"two {key} are called", [entry.name for entry in entries])
    for number, table in enumerate(comparison.tables):
        _check_table(f"tables[{number}]", table, comparison)
    for number, plot in enumerate(comparison.plots):
        where = f"plots[{number}]"
        if not is_folder_name(plot.name):
            raise NteError(f"{where}.name is {plot.name!r:.60}: expected the name of a file")
        _check_selection(where, plot.situation, plot.methods, plot.light, plot.region, comparison)
        _check_numbers(where, plot.metrics, plot.first, comparison.situation(plot.situation))
        if _OF_A_CLIP in plot.metrics:
            raise NteError(f"{where}.metrics has {_OF_A_CLIP}, which frames have no values of: put it into a table")


def _check_network(comparison: Comparison, title: str) -> None:
    seeds, where = comparison.seeds_of(title), f"networks.{title}"
    if not seeds:
        raise NteError(f"{where}: 'seeds' is empty: expected at least one, here or for all networks")
    if outside := [seed for seed in seeds if not 0 <= seed < 2**32]:
        raise NteError(f"{where}: the seed {outside[0]}: expected 0 to {2**32 - 1}")
    if twice := [seed for seed in seeds if seeds.count(seed) > 1]:
        raise NteError(f"{where}: the seed {twice[0]} is given twice: expected each once")
    if not is_folder_name(f"{title}_seed{max(seeds)}"):
        raise NteError(f"networks: the title {title!r:.60} cannot name a run's folder: expected one word or some")
    for override in (*comparison.overrides, *comparison.networks[title].overrides):
        key = override.partition("=")[0].strip()
        decided = _DECIDED | ({"data.clips": "'train' names the clips"} if comparison.train else {})
        if key in decided:
            raise NteError(f"{where}: '{override}' would be ignored: {decided[key]}; leave it out")


def _check_situation(where: str, situation: Situation, comparison: Comparison) -> None:
    situation.first = comparison.first if situation.first is None else situation.first
    if situation.first < 0:
        raise NteError(f"{where}.first is {situation.first}: expected the index of a frame, 0 or more")
    if situation.pictures < 1:
        raise NteError(f"{where}.pictures is {situation.pictures}: expected a number of clips, 1 or more")
    _one_of(f"{where}.light", situation.light, TARGETS)
    _one_of(f"{where}.region", situation.region, REGIONS)
    if not is_folder_name(situation.name):
        raise NteError(f"{where}.name is {situation.name!r:.60}: expected the name of a folder")
    if not situation.clips:
        raise NteError(f"{where}.clips is empty: expected at least one")
    if not situation.titles:
        raise NteError(f"{where}.methods is empty: expected at least one, or networks")
    for title, network in situation.runs.items():
        place = "networks" if title in situation.networks else f"methods.{title}"
        _known(f"{where}.{place}", network, comparison.networks, "network")
    for title, spec in situation.methods.items():
        if len(networks := set(RUN_OF.findall(spec))) > 1:
            raise NteError(f"{where}.methods.{title} uses {' and '.join(sorted(networks))}: expected one network")
    _refuse_twice(f"{where}: two methods are called", situation.titles)
    if taken := [title for title in situation.titles if title in (REFERENCE, INPUT)]:
        raise NteError(f"{where}: a method is called '{taken[0]}', as a picture of every report: give it another title")
    _refuse_twice(f"{where}: two methods are the denoiser", list(situation.methods.values()))
    if comparison.against and not comparison.tables and comparison.against not in situation.titles:
        known = ", ".join(situation.titles)
        raise NteError(f"{where}.methods lacks '{comparison.against}', named by 'against'; it has {known}")


def _check_table(where: str, table: Table, comparison: Comparison) -> None:
    if table.against is None:
        table.against = comparison.against
    if not table.columns:
        raise NteError(f"{where}.columns is empty: expected at least one part")
    for number, part in enumerate(table.columns):
        here = f"{where}.columns[{number}]"
        _check_selection(where, table.situation, table.methods, part.light, part.region, comparison, here)
        situation = comparison.situation(table.situation)
        _check_numbers(here, [*part.metrics, *part.margins], part.first, situation)
        if part.margins and not table.against:
            raise NteError(f"{here}.margins: no method to compare with: set 'against'")
    if table.against:
        _known(f"{where}.against", table.against, situation.titles, "method")


def _check_selection(
    where: str, name: str, methods: list[str], light: str, region: str, comparison: Comparison, part: str = ""
) -> None:
    """Raise NteError for a situation, a method, a light or a region that is not there."""
    _known(f"{where}.situation", name, [situation.name for situation in comparison.situations], "situation")
    for title in methods:
        _known(f"{where}.methods", title, comparison.situation(name).titles, "method")
    _one_of(f"{part or where}.light", light or "color", TARGETS)
    _one_of(f"{part or where}.region", region, REGIONS)


def _check_numbers(where: str, metrics: list[str], first: int | None, situation: Situation) -> None:
    if not metrics:
        raise NteError(f"{where}.metrics is empty: expected some of {', '.join(_NAMES)}")
    for name in metrics:
        _one_of(f"{where}: a metric", name, _NAMES)
    assert situation.first is not None
    if first is not None and first < situation.first:
        raise NteError(
            f"{where}.first is {first}, but situation '{situation.name}' is scored from frame {situation.first} on"
        )


def _one_of(what: str, value: str, allowed: Iterable[str]) -> None:
    if value not in allowed:
        raise NteError(f"{what} is '{value}'{expected_one_of(value, allowed)}")


def _known(where: str, name: str, known: Iterable[str], kind: str) -> None:
    if name not in known:
        raise NteError(f"{where}: there is no {kind} '{name}'{expected_one_of(name, known)}")


def _refuse_twice(what: str, names: list[str]) -> None:
    if twice := [name for name in names if names.count(name) > 1]:
        raise NteError(f"{what} '{twice[0]}': expected a name of its own for each")
