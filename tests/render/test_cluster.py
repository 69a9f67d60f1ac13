"""Rendering on a Dask cluster: a real scheduler and real workers on loopback."""

import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from weakref import ref

import numpy as np
import numpy.typing as npt
import pytest

from nte import cluster as clusters
from nte.cli import main
from nte.errors import NteError
from nte.evaluation.evaluate import evaluate
from nte.render.recipes.clips import render_recipe
from nte.render.recipes.jobs import RENDERING
from nte.render.recipes.output import claim
from nte.render.recipes.recipe import read_recipe
from tests.cluster import Cluster, wait_for
from tests.conftest import Rounds
from tests.render.test_clips import CLIP, contents
from tests.synthetic import disc_clip
from tests.test_jobs import KIND

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A scheduler with two workers of one thread each."""
    with Cluster(tmp_path_factory.mktemp("cluster")) as cluster:
        yield cluster.address


def test_workers_that_do_not_fit_are_refused(address: str, tmp_path: Path):
    with distributed.Client(address, set_as_default=False) as client:
        (tmp_path / "seen").touch()
        terms = clusters._Terms(
            RENDERING, tmp_path / "seen", tmp_path, clusters._versions(RENDERING), clusters._neighbours(client)
        )
        assert set(terms.neighbours.values()) == {2}
        assert set(client.run(clusters._fault, terms).values()) == {None}
        other = replace(terms, versions=terms.versions | {"nte": "0.0.1"})
        assert all("nte is 0." in said and "0.0.1 here" in said for said in client.run(clusters._fault, other).values())
        hidden = replace(terms, token=tmp_path / "elsewhere" / "seen")
        assert all(
            "file system that all workers share" in said for said in client.run(clusters._fault, hidden).values()
        )


def test_a_fault_on_a_worker_is_one_line(
    address: str, recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    claim(tmp_path, read_recipe(recipe), force=False)
    (tmp_path / "train").write_text("in the way")
    assert main(["render", str(recipe), "--out", str(tmp_path), "--scheduler", address]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[-1].startswith("nte: ")
    assert "cannot be made a folder" in said[-1]
    assert not any("Traceback" in line for line in said)
    assert not list(tmp_path.glob(".*"))


def test_clips_are_evaluated_on_the_same_workers(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Paths are relative to the directory in which the command is given."""
    monkeypatch.chdir(tmp_path)
    for seed in (1, 2):
        disc_clip(tmp_path / "clips" / f"disc_{seed}", frames=2, seed=seed)
    here = evaluate("clips", ["taa"], "here")
    there = evaluate("clips", ["taa"], "there", scheduler=address)
    for found in (here, there):
        for row in found.metrics["rows"]:
            row.pop("ms_per_frame")
    assert there.metrics["rows"] == here.metrics["rows"]
    assert not list((tmp_path / "there").glob(".*"))


def test_a_killed_worker_changes_nothing(address: str, rendered: Path, recipe: Path, tmp_path: Path):
    """The worker that renders a clip is killed after the clip's first frame: another one finishes it."""
    out = tmp_path / "out"
    with distributed.Client(address, set_as_default=False) as client, ThreadPoolExecutor() as pool:
        pids = client.run(os.getpid)
        assert len(pids) == 2
        job = pool.submit(render_recipe, recipe, out, progress=False, scheduler=address)

        def rendering() -> list[str]:
            return [worker for worker, keys in client.processing().items() if any(CLIP in str(key) for key in keys)]

        (victim,) = wait_for(rendering)
        wait_for((out / CLIP / "frame_0000.exr").is_file)
        os.kill(pids[victim], signal.SIGKILL)
        assert not (out / CLIP / "clip.json").exists()
        assert len(job.result(timeout=120)) == 2
        assert list(client.scheduler_info()["workers"]) == [worker for worker in pids if worker != victim]
    assert contents(out) == contents(rendered)


def test_a_scheduler_has_few_units_at_a_time_and_nobody_keeps_results(
    address: str, tmp_path: Path, rounds: Rounds, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(clusters, "QUEUED", 20)
    units = {f"unit {number}": number for number in range(rounds("units of a cluster", 200, 10_000))}
    given: list[ref[npt.NDArray[np.int64]]] = []
    seen: dict[str, int] = {}
    queued = most = 0
    with distributed.Client(address, set_as_default=False) as client:

        def done(name: str, result: npt.NDArray[np.int64]) -> None:
            nonlocal queued, most
            given.append(ref(result))
            seen[name], most = int(result[-1]), max(most, sum(one() is not None for one in given[-50:]))
            if len(seen) % 50 == 0:
                queued = max(queued, client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))

        clusters.on_cluster(KIND, partial(np.full, 1000), units, tmp_path, address, done)
    assert seen == units
    assert most < 5
    assert queued <= 2 * 20  # those that are forgotten in this moment included


def test_without_dask_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "dask", None)
    with pytest.raises(NteError, match=r"--scheduler needs the package 'dask': pip install 'nte-denoiser\[cluster\]'"):
        clusters.on_cluster(RENDERING, str, {}, tmp_path, "tcp://127.0.0.1:1", lambda name, result: None)


def test_a_scheduler_without_workers_or_with_wide_ones(recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(clusters, "PATIENCE", 2)
    with Cluster(tmp_path / "cluster", workers=0) as cluster:
        found = cluster.address
        with pytest.raises(NteError, match=f"{found} has no workers: start some with: dask worker"):
            render_recipe(recipe, tmp_path / "out", progress=False, scheduler=found)
        cluster.add_worker(threads=2)
        cluster.wait()
        with pytest.raises(NteError, match=r"has 2 threads, expected 1.*--nthreads 1"):
            render_recipe(recipe, tmp_path / "out", progress=False, scheduler=found)
    with pytest.raises(NteError, match=f"no Dask scheduler answers at {found}: start one") as caught:
        render_recipe(recipe, tmp_path / "out", progress=False, scheduler=found)
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "out").glob(".*"))
