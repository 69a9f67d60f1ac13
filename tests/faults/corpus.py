"""Small whole files of every format that nte reads, and how it reads them."""

import io
import re
import shutil
import zipfile
import zlib
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numcodecs.pickles
import numpy as np
import OpenEXR
from safetensors import safe_open

from nte import load_denoiser
from nte.burst.pictures import read_picture, write_picture
from nte.burst.raw import read_raw
from nte.cli import main
from nte.errors import NteError
from nte.evaluation.comparison.read import read_comparison
from nte.frames.clip import Clip
from nte.frames.exr import read_parts
from nte.importing.cameras import load_cameras
from nte.importing.channel_map import load_channel_map
from nte.importing.noisebase_files import ARRAYS, NoisebaseSequence
from nte.render.recipes.recipe import plan, read_recipe
from nte.render.world.keyframes import read_animation
from nte.runtime.description import UNSEALED, seal
from nte.runtime.export import export_onnx
from nte.session import Session
from nte.training.checkpoint import checksum_of
from nte.training.config import load_train_config
from nte.training.loop import train
from nte.training.run import load_run
from tests.burst.dng import BAYER, write_dng
from tests.faults.strangers import ROOM
from tests.importing.producers import engine, scene
from tests.importing.test_noisebase import sequence
from tests.networks import small_network
from tests.synthetic import disc_clip, random_frames
from tests.training.runs import config_file, tiny_config

RECIPE = """\
name: x
seed: 3
train:
  - {scene: rooms, clips: 2, width: 32, height: 24, frames: 4, spp: 1, reference_spp: 16}
test:
  - {scene: spheres, clips: 1, width: 32, height: 24, frames: 3, reference_spp: 8}
"""
OWN = """\
name: own
seed: 3
test:
  - {scene: moves.yaml, clips: 1, width: 8, height: 6, frames: 1, reference_spp: 2}
"""
COMPARISON = """\
recipes: {}
situations:
  - {name: disc, clips: [disc], methods: {nothing: noisy, ours: "taa:alpha=0.1"}}
tables:
  - {name: Discs, situation: disc, caption: all}
"""
MOVES = """\
xml: room.xml
objects:
  mesh: [{frame: 0}, {frame: 8, translate: [1, 0.6, 0], rotate: [0, 90, 30], pivot: [-1, 0.5, 0]}]
lights:
  bulb: [{frame: 0, brightness: 0.5}, {frame: 8, translate: [-4, 0, 0]}]
camera:
  - {frame: 0, origin: [0, 2, -6], target: [0, 1, 0]}
  - {frame: 8, origin: [1, 2.2, -6], target: [0, 1, 0]}
"""


class Format(NamedTuple):
    """Files that are damaged, and the call that reads them all."""

    files: str  # a pattern, relative to the corpus
    read: Callable[[Path], object]  # takes the folder of the corpus
    text: bool = False
    seal: Callable[[Path], object] | None = None  # what whoever damages a file on purpose does to it then


def _exr(folder: Path) -> None:
    for path in sorted((folder / "exr").iterdir()):
        read_parts(path)


def _noisebase(folder: Path) -> None:
    numcodecs.pickles.ALLOW_UNSAFE_PICKLE_DECODE = True  # as in versions that do not refuse it by themselves
    found = NoisebaseSequence(folder / "scene.zip")
    for frame in range(found.frames):
        for name in ARRAYS:
            found.read(frame, name)


def _model(folder: Path) -> None:
    session = Session(load_denoiser(str(folder / "model.onnx")))
    for frame in random_frames(2):
        session.denoise(frame)


def _command(*words: str) -> Callable[[Path], str]:
    """Type a command, and return what it says; @ stands for the folder of the corpus."""

    def run(folder: Path) -> str:
        shutil.rmtree(folder / "out", ignore_errors=True)
        said, told = io.StringIO(), io.StringIO()
        with redirect_stderr(said), redirect_stdout(told):
            code = main([word.replace("@", f"{folder}/") for word in words])
        ends = [line for line in said.getvalue().splitlines() if line.startswith("nte:")]
        if code == 2 and len(ends) == 1:
            raise NteError(ends[0])
        assert code in (0, 1), f"{words} ended with {code}: {said.getvalue()}"
        return said.getvalue() + told.getvalue()

    return run


def _sealed_anew(path: Path) -> None:
    path.write_bytes(re.sub(rb'(?<="sha256": ")[0-9a-f]{64}', UNSEALED.encode(), path.read_bytes()))
    seal(path)


def _weights_anew(path: Path) -> None:
    with safe_open(path, framework="pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        checksum = checksum_of(int(file.metadata()["step"]), tensors).encode()
        path.write_bytes(re.sub(rb'(?<="sha256":")[0-9a-f]{64}', checksum, path.read_bytes()))


def _members_anew(path: Path) -> None:
    """Write a zip file again with the checksums that its members have now."""
    with zipfile.ZipFile(path) as file:
        members = {}
        for name in file.namelist():
            with file.open(name) as member:
                member._expected_crc = None  # type: ignore[attr-defined]
                members[name] = member.read()
        with zipfile.ZipFile(path.with_suffix(".new"), "w") as made:
            for name, data in members.items():
                made.writestr(name, data)
        path.with_suffix(".new").replace(path)


def _chunks_anew(path: Path) -> None:
    """Write the checksum of each chunk of a PNG anew."""
    content, at = bytearray(path.read_bytes()), 8
    while at + 12 <= len(content):
        end = at + 8 + int.from_bytes(content[at : at + 4], "big")
        content[end : end + 4] = zlib.crc32(content[at + 4 : end]).to_bytes(4, "big")
        at = end + 4
    path.write_bytes(content)


FORMATS = {
    "clip": Format("clip/*.exr", lambda folder: list(Clip(folder / "clip"))),
    "clip.json": Format("clip/clip.json", lambda folder: list(Clip(folder / "clip")), True),
    "OpenEXR": Format("exr/*", _exr),
    "training": Format("tiny.yaml", lambda folder: load_train_config(folder / "tiny.yaml", []), True),
    "comparison": Format("compare.yaml", lambda folder: read_comparison(folder / "compare.yaml"), True),
    "recipe": Format("recipe.yaml", lambda folder: plan(read_recipe(folder / "recipe.yaml"), folder), True),
    "animation": Format("moves.yaml", lambda folder: read_animation(folder / "moves.yaml"), True),
    "channel map": Format("map.yaml", lambda folder: load_channel_map(folder / "map.yaml"), True),
    "cameras": Format("cameras.json", lambda folder: load_cameras(folder / "cameras.json", 4), True),
    "weights": Format("runs/tiny/checkpoint.safetensors", lambda folder: load_run(folder / "runs" / "tiny")),
    "weights, sealed": Format(
        "runs/tiny/checkpoint.safetensors", lambda folder: load_run(folder / "runs" / "tiny"), seal=_weights_anew
    ),
    "scene": Format("room.xml", lambda folder: read_recipe(folder / "own.yaml"), True),
    "run": Format("runs/tiny/config.yaml", lambda folder: load_run(folder / "runs" / "tiny"), True),
    "model": Format("model.onnx", _model),
    "model, sealed": Format("model.onnx", _model, seal=_sealed_anew),
    "noisebase": Format("scene.zip", _noisebase),
    "noisebase, sealed": Format("scene.zip", _noisebase, seal=_members_anew),
    "photograph": Format("photo.dng", lambda folder: read_raw(folder / "photo.dng")),
    "PNG": Format("picture.png", lambda folder: read_picture(folder / "picture.png")),
    "PNG, sealed": Format("picture.png", lambda folder: read_picture(folder / "picture.png"), seal=_chunks_anew),
    "TIFF": Format("picture.tif", lambda folder: read_picture(folder / "picture.tif")),
} | {
    words.partition(" @")[0]: Format(files, _command(*words.removeprefix("nte ").split()), seal=seal)
    for files, words, seal in (
        ("clip/*", "nte check @clip", None),
        ("clip/*", "nte denoise @clip --denoiser taa --png --out @out/taa", None),
        ("clip/*", "nte evaluate --clips @clip --denoisers taa --out @out/table", None),
        ("engine/*", "nte import exr @engine --map @map.yaml --out @out/clip", None),
        ("scene.zip", "nte import noisebase @scene.zip --out @out/clip", None),
        ("model.onnx", "nte info @model.onnx", _sealed_anew),
        ("photo*.dng", "nte merge-burst @photo.dng @photo2.dng --noise 0.001 0.0001 --out @out/merged.exr", None),
    )
}


def write_corpus(folder: Path) -> None:
    """Write every file of the corpus into an empty folder."""
    disc_clip(folder / "clip", frames=2, seed=1, size=(24, 40), start=(10.0, 12.0), radius=6.0)
    _write_exrs(folder / "exr")
    config_file(folder, folder / "clip")
    train(tiny_config(folder, folder / "clip", "phases=[{steps: 2}]", "data.holdout=0"), device="cpu")
    for name, text in {"compare": COMPARISON, "recipe": RECIPE, "own": OWN, "moves": MOVES}.items():
        (folder / f"{name}.yaml").write_text(text)
    (folder / "room.xml").write_text(ROOM)
    engine(folder, scene())
    export_onnx(small_network(channels=[4, 4], scales=2), folder / "model.onnx", progress=lambda line: None)
    sequence(folder / "scene.zip", count=2)
    rng = np.random.default_rng(0)
    for name in ("photo.dng", "photo2.dng"):
        write_dng(folder / name, rng.integers(64, 1023, (64, 72), np.uint16), BAYER)
    picture = rng.random((3, 20, 30), np.float32)
    write_picture(folder / "picture.png", picture)
    write_picture(folder / "picture.tif", picture)


def _write_exrs(folder: Path) -> None:
    """One file for each way in which OpenEXR stores pixels, with smooth and noisy channels of each type."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    planes: dict[str, np.ndarray] = {
        "color.R": rng.random((24, 40), np.float32),
        "depth.Z": np.linspace(1, 9, 960, dtype=np.float32).reshape(24, 40).astype(np.float16),
        "id": rng.integers(0, 4, (24, 40), np.uint32),
    }
    for name in dir(OpenEXR):
        if name.endswith("_COMPRESSION") and not name.startswith(("LJ2K", "ZSTD", "HTJ2K")):
            header = {"compression": getattr(OpenEXR, name), "type": OpenEXR.scanlineimage}
            OpenEXR.File(header, _copies(planes)).write(str(folder / f"{name}.exr"))
    tiles = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    OpenEXR.File(tiles, _copies(planes)).write(str(folder / "tiled.exr"))
    parts: Sequence[OpenEXR.Part] = [
        OpenEXR.Part({"name": name, "type": OpenEXR.scanlineimage}, _copies(planes)) for name in ("left", "right")
    ]
    OpenEXR.File(parts).write(str(folder / "parts.exr"))


def _copies(planes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: values.copy() for name, values in planes.items()}
