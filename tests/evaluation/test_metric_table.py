"""The text table: aligned, with the best of each column marked."""

from nte.evaluation.metric_table import METRICS, best_of, format_table


def means(**psnr: float | None) -> dict[str, dict[str, float | None]]:
    return {spec: {m.name: None for m in METRICS} | {"psnr": p, "ms_per_frame": 1.0} for spec, p in psnr.items()}


def test_the_best_is_marked_and_columns_are_aligned() -> None:
    lines = format_table({"rows": [], "means": means(noisy=15.123, much_longer_name=30.456)}).splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("denoiser          PSNR, dB")
    assert "15.12 " in lines[1]
    assert "30.46*" in lines[2]
    assert lines[1].index("15.12") == lines[2].index("30.46")
    # Time has no best: doing nothing would win.
    assert "1.0*" not in format_table({"rows": [], "means": means(a=1.0, b=2.0)})


def test_the_best_is_of_what_is_printed() -> None:
    psnr = METRICS[0]
    assert best_of(means(a=30.001, b=30.002, c=29.0, d=None), psnr) == {"a", "b"}
    assert best_of(means(a=30.0), psnr) == set()
    assert best_of(means(a=None, b=None), psnr) == set()


def test_lower_is_better_where_the_table_says_so() -> None:
    flip = next(m for m in METRICS if m.name == "flip")
    assert best_of({"a": {"flip": 0.1}, "b": {"flip": 0.2}}, flip) == {"a"}
