"""What a wrong map loses is told at import: the clip that is left looks right to `nte check`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from nte.cli import main
from nte.frames.exr import REC_709, write_exr
from tests.importing.producers import SIZE, named, scene, write_layers, write_map
from tests.synthetic import Pixels

CHANNELS = {name: name for name in ("color", "albedo", "normal", "depth", "instance", "motion")}
FRAMES = scene()
HALF = FRAMES[0]["depth"].shape[2] // 2


def layers(change: Callable[[dict[str, Pixels]], dict[str, Pixels]], without: tuple[str, ...] = ()) -> list[Any]:
    written = []
    for frame in FRAMES:
        f = frame | change(frame)
        own = {"depth.Z": f["depth"][0], "instance.X": f["instance"][0]} | named("motion", "XY", f["motion"])
        own |= {k: v for n in ("color", "albedo") for k, v in named(n, "RGB", f[n]).items()}
        own |= named("normal", "XYZ", f["normal"])
        written.append({k: v for k, v in own.items() if k.split(".")[0] not in without})
    return written


def said(folder: Path, capsys: pytest.CaptureFixture[str], written: list[Any], **groups: Any) -> str:
    about = {"channels": CHANNELS, "optional": True, **groups}
    source, map_path = write_layers(folder / "shots", written), write_map(folder / "map.yaml", about)
    main(["import", "exr", str(source), "--map", str(map_path), "--out", str(folder / "clip")])
    return capsys.readouterr().out


def left_of(f: dict[str, Pixels], depth: float) -> dict[str, Pixels]:
    return {"depth": np.where(np.arange(f["depth"].shape[2]) < HALF, depth * f["depth"], f["depth"])}


@pytest.mark.parametrize("without", [(), ("normal",), ("instance",)])
@pytest.mark.parametrize(("depth", "stored"), [(-1.0, "is stored as -"), (np.nan, "is not finite, or beyond")])
def test_surfaces_without_depth_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], depth: float, stored: str, without: tuple[str, ...]
) -> None:
    """Depth counted from the plane in focus, and one that is not a number."""
    out = said(tmp_path, capsys, layers(lambda f: left_of(f, depth), without))
    assert "made misses: 47% of the pixels, whose other channels show a surface: their depth " + stored in out


def test_a_limit_of_the_sky_amid_surfaces_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    limit = float(FRAMES[0]["depth"].max())
    assert "made misses: " in said(tmp_path, capsys, layers(lambda f: {}), depth={"sky": limit})


@pytest.mark.parametrize("miss", [0.0, -1.0, np.inf, np.nan, 1e10])
def test_the_sky_is_no_loss(tmp_path: Path, capsys: pytest.CaptureFixture[str], miss: float) -> None:
    out = said(tmp_path, capsys, layers(lambda f: {"depth": np.where(f["depth"] > 0, f["depth"], miss)}))
    assert "misses" not in out
    assert "decoded" not in out


def test_encoded_normals_of_the_sky_are_no_surface(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = layers(lambda f: {"normal": np.round(255 * (f["normal"] / 2 + 0.5)) / 255})
    out = said(tmp_path, capsys, frames, normal={"encoded": True})
    assert "misses" not in out
    assert "decoded" not in out


def test_normals_that_are_not_encoded_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    turned = layers(lambda f: {"normal": f["normal"] * np.reshape([1, 1, -1], (3, 1, 1))})
    assert "decoded: normal, which is stored as -" in said(tmp_path, capsys, turned, normal={"encoded": True})


@pytest.mark.parametrize("summed", [True, False])
def test_albedo_that_is_twice_as_large_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], summed: bool
) -> None:
    """A sum of two colours may be 2."""
    albedo = {"layer": "albedo", "plus": ["more"]} if summed else "albedo"
    bright = layers(lambda f: {"albedo": np.clip(2 * f["albedo"], 0, 2)})
    out = said(tmp_path, capsys, bright, channels=CHANNELS | {"albedo": albedo})
    assert ("cut to [0, 1]: " in out) != summed


def test_normals_that_are_not_unit_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They are normalised: of another layer that is all that would be left to see."""
    out = said(tmp_path / "a", capsys, layers(lambda f: {"normal": 0.3 * f["normal"]}))
    assert "normalised: normal, whose vectors are about 0.3 long" in out
    assert "normalised" not in said(tmp_path / "b", capsys, layers(lambda f: {}))


def test_normals_of_surfaces_that_are_no_number_are_counted_and_those_of_the_sky_are_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They become 0, for which the depth would be blamed: the normal of a sky is often 0 divided by 0."""
    sky = scene()[0]["depth"] <= 0
    dirty = layers(lambda f: {"normal": np.where(sky, np.nan, f["normal"])})
    assert "bad: " not in said(tmp_path, capsys, dirty)
    for layer in dirty:
        layer["normal.X"][20, 3:5] = np.nan, np.inf
    (tmp_path / "more").mkdir()
    assert f"bad: {2 * len(FRAMES)} pixels of normal, first in " in said(tmp_path / "more", capsys, dirty)


def test_geometric_normals_are_looked_at_as_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = layers(lambda f: {})
    for frame in frames:
        frame |= {f"flat.{c}": frame[f"normal.{c}"] / 2 + 0.5 for c in "XYZ"}
    out = said(tmp_path, capsys, frames, channels=CHANNELS | {"geometric_normal": "flat"})
    assert "normalised: geometric_normal, whose vectors are about 1.22 long" in out
    assert "normalised: normal" not in out


def test_positions_without_depth_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where neither normals nor instances show surfaces."""
    frames = layers(lambda f: left_of(f, -1), ("normal", "instance"))
    for frame in frames:
        frame |= {f"position.{c}": np.ones_like(frame["depth.Z"]) for c in "XYZ"}
    out = said(tmp_path, capsys, frames, channels=CHANNELS | {"position": "position"})
    assert "made misses: " in out
    assert "whose other channels show a surface" in out


@pytest.mark.parametrize(
    ("header", "told"),
    [
        ({"compression": OpenEXR.DWAA_COMPRESSION}, "lossy: DWAA compression changes vectors, normals and ids too"),
        ({"compression": OpenEXR.PXR24_COMPRESSION}, "lossy: PXR24 compression changes"),  # 100001 becomes 100002
        ({"colorInteropID": "lin_rec2020_scene"}, "call their colours lin_rec2020_scene, which are shown as if"),
        ({"colorInteropID": "lin_rec709_scene"}, ""),
        ({"chromaticities": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.3217, 0.3377)}, "the primaries 0.713 0.293 "),
        ({"displayWindow": ((0, 0), (SIZE[1] - 1, SIZE[0] - 3))}, "left out: overscan, the pixels outside"),
        ({"compression": OpenEXR.PIZ_COMPRESSION, "chromaticities": REC_709}, ""),
    ],
    ids=["DWAA", "PXR24", "Blender's Rec. 2020", "Blender's Rec. 709", "ACEScg", "overscan", "as usual"],
)
def test_what_a_header_says_of_values_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], header: dict[str, object], told: str
) -> None:
    folder = tmp_path / "shots"
    folder.mkdir()
    for i, planes in enumerate(layers(lambda f: {})):
        stored = {name: np.ascontiguousarray(plane, np.float32) for name, plane in planes.items()}
        with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, stored) as file:
            file.write(str(folder / f"shot.{i:04d}.exr"))
    map_path = write_map(tmp_path / "map.yaml", {"channels": CHANNELS})
    main(["import", "exr", str(folder), "--map", str(map_path), "--out", str(tmp_path / "clip")])
    out = capsys.readouterr().out
    assert (told in out) if told else not any(word in out for word in ("lossy", "not converted", "overscan"))


@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_positions_in_half_floats_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: type[np.floating]
) -> None:
    """Cameras are recovered from them, and from cameras the sky's motion, which is a quarter of a pixel off at 20."""
    (tmp_path / "shots").mkdir()
    for i, planes in enumerate(layers(lambda f: {})):
        stored = {name: np.ascontiguousarray(plane, np.float32) for name, plane in planes.items()}
        position = {f"P.{c}": np.full(SIZE, 20, kind) for c in "XYZ"}
        write_exr(tmp_path / "shots" / f"shot.{i}.exr", stored | position)
    map_path = write_map(tmp_path / "map.yaml", {"channels": CHANNELS | {"position": "P"}})
    main(["import", "exr", str(tmp_path / "shots"), "--map", str(map_path), "--out", str(tmp_path / "clip")])
    told = "coarse: position is stored in half floats, in steps of 0.016 scene units" in capsys.readouterr().out
    assert told == (kind is np.float16)
