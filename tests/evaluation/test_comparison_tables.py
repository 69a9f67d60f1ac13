"""The numbers of a table from rows that are written by hand, and what they look like as text."""

import pytest

from nte.evaluation.comparison.numbers import Evaluated, Method, Selection, part_of
from nte.evaluation.comparison.text import markdown, plain
from nte.evaluation.metric_table import Row

Scores = dict[str, list[float | None]]  # denoiser → PSNR in each clip
SEEDS = Method("network", ("seed 1", "seed 2"), (1, 2))
FILTER = Method("filter", ("filter",))


def table_of(scores: Scores) -> Row:
    """The summary of a comparison of the network and the filter, whose table has the network's margin as well."""
    clips = [f"clip {number}" for number in range(len(scores["filter"]))]
    rows = [
        {"denoiser": spec, "clip": clip, "target": "color", "region": "moving", "psnr": value, "per_frame": {}}
        for spec, values in scores.items()
        for clip, value in zip(clips, values, strict=True)
    ]
    chosen = Selection("moving", tuple(clips), "color", "moving", 1)
    parts = {m: part_of(Evaluated(rows), m, chosen, ["psnr"], ["psnr"], FILTER) for m in (SEEDS, FILTER)}
    return {
        "tables": [{
            "name": "both", "caption": "", "against": "filter",
            "columns": [{"title": "moving", "clips": len(clips), "metrics": ["psnr"], "margins": ["psnr"]}],
            "rows": [
                {"method": m.title, "label": m.title, "seeds": list(m.seeds), "parts": [part]}
                for m, part in parts.items()
            ],
        }],
        "failures": [],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("scores", "margin"),
    [
        ({"seed 1": [31.0], "seed 2": [33.0], "filter": [30.0]}, "+2.00"),  # it would be one over seeds alone
        ({"seed 1": [31.0, 32.0], "seed 2": [31.0, 32.0], "filter": [30.0, 31.0]}, "+1.00 (+1.00 … +1.00)"),
    ],
)
def test_a_margin_has_an_interval_if_there_are_several_clips(scores: Scores, margin: str) -> None:
    summary = table_of(scores)
    assert f"| {margin} |" in markdown(summary)
    assert margin in plain(summary)


def test_a_number_of_fewer_clips_than_the_heading_has_says_so() -> None:
    summary = table_of(
        {"seed 1": [31.0, 32.0, None], "seed 2": [31.0, 32.0, 33.0], "filter": [None, 31.0, 30.0]}  # of no pixels there
    )
    network, filtered = (row["parts"][0] for row in summary["tables"][0]["rows"])
    assert (network["counted"], filtered["counted"]) == ({"psnr": 2}, {"psnr": 2})
    assert network["margins"]["psnr"]["clips"] == 1
    for text in (plain(summary), markdown(summary)):
        assert "both, 3 clips" in text
        assert all(said in text for said in ("31.50, 2 clips", "30.50, 2 clips", "+1.00, 1 clip"))
    whole = plain(table_of({"seed 1": [31.0, 32.0], "seed 2": [31.0, 32.0], "filter": [30.0, 31.0]}))
    assert whole.count("clips") == 1  # the heading
