"""Commands that write files, to be disturbed: started again, each ends with the files of an undisturbed run."""

import csv
import io
import json
import re
from pathlib import Path

import numpy as np

from tests.synthetic import disc_clip
from tests.training.runs import config_file

COMMANDS = {
    "compare": "compare COMPARISON --data DATA --out OUT",
    "denoise": "denoise CLIP --denoiser taa --png --out OUT",
    "loose frames": "denoise FRAMES --denoiser noisy --out OUT",
    "estimate": "estimate CLIP --noise clean --out OUT",
    "evaluate": "evaluate --clips CLIP --denoisers noisy taa --out OUT",
    "export": "export RUN --out OUT/model.onnx",
    "import": "import exr CLIP --map MAP --out OUT/clip",
    "merge-burst": "merge-burst BURST --out OUT/merged.exr",
    "render": "render RECIPE --out OUT",
    "train": "train CONFIG runs=OUT resume=true --device cpu",
    "train from mapped files": "train CONFIG runs=OUT resume=true data.cache_gb=0 --device cpu",
    "view": "view CLIP --denoiser taa --out OUT --no-open",
}
MAP = "channels: {color: color, albedo: albedo, normal: normal}\n"
COMPARISON = "situations: [{name: disc, clips: [disc], methods: {nothing: noisy, TAA: taa}}]\n"
RECIPE = "name: x\ntrain: [{scene: rooms, clips: 2, width: 16, height: 16, frames: 3, reference_spp: 4}]\n"
FOLDER = b"a folder"  # the content of one
DATA = re.compile(rb'(<script type="application/json" id="data">)(.*?)(</script>)', re.DOTALL)
TABLE = re.compile(rb"<pre>.*?</pre>", re.DOTALL)


def command(name: str, out: Path, clip: Path, run: Path, folder: Path) -> list[str]:
    """The words of a command that writes into `out`. folder: where its map, recipe and configuration are made."""
    texts = {"map.yaml": MAP, "recipe.yaml": RECIPE, "comparison.yaml": COMPARISON}
    for file, text in texts.items():
        (folder / file).write_text(text)
    if name == "merge-burst" and not (folder / "burst").exists():
        disc_clip(folder / "burst", frames=2, seed=1, size=(64, 64))
    places = {file.partition(".")[0].upper(): folder / file for file in texts}
    places |= {"CLIP": clip, "DATA": clip.parent, "RUN": run, "CONFIG": config_file(folder, clip)}
    several = {"FRAMES": clip, "BURST": folder / "burst"}
    typed = [
        sorted(map(str, several[word].glob("*.exr"))) if word in several else [str(places.get(word, word))]
        for word in COMMANDS[name].split()
    ]
    return [word.replace("OUT", str(out)) for part in typed for word in part]


def contents(folder: Path) -> dict[str, bytes]:
    """All files and folders below a folder, without what no two runs share: the time of a step, and a run's log.

    Of the latter it counts that it is there, as of the run's configuration, which has the name of its folder.
    """
    found = {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else FOLDER
        for path in folder.rglob("*")
        if not path.name.startswith("events.out.")  # TensorBoard's, with the time in its name
    }
    return {
        name: next((mask(data) for end, mask in _MASKED.items() if name.endswith(end)), data)
        for name, data in found.items()
    }


def differing(found: dict[str, bytes], expected: dict[str, bytes]) -> list[str]:
    """The names of the files that are missing, that are there beside those expected, or that have another content."""
    every = sorted({*found, *expected})
    return [name for name in every if found.get(name) != expected.get(name)]


def _weights(data: bytes) -> bytes:
    """A checkpoint's tensors, and what is said of them in order: safetensors writes the metadata in any order."""
    length = 8 + int.from_bytes(data[:8], "little")
    return json.dumps(json.loads(data[8:length]), sort_keys=True).encode() + data[length:]


def _untimed(value: object) -> object:
    """What is left of JSON without the times of steps."""
    if isinstance(value, dict):
        return {key: _untimed(one) for key, one in value.items() if "ms_per_frame" not in key}
    return [_untimed(one) for one in value] if isinstance(value, list) else value


def _scores(data: bytes) -> bytes:
    """The metrics of an evaluation without times."""
    return json.dumps(_untimed(json.loads(data))).encode()


def _page(data: bytes) -> bytes:
    """A page without times, which are in its data, and in the last column of the table for readers without scripts."""
    page = DATA.sub(lambda found: found[1] + _scores(found[2]) + found[3], data)
    return TABLE.sub(lambda found: re.sub(rb" +([0-9]+\.[0-9](?=\n|<))?", b" ", found[0]), page)


def _timeless(data: bytes) -> bytes:
    """LaTeX tables without times, the numbers with one decimal: one is bold, and an interval may reach below 0."""
    return re.sub(rb"\\textbf\{\d+\.\d\}|(?:\$-\$)?(?<![\d.])\d+\.\d(?!\d)", b"", data)


def _columns(data: bytes) -> bytes:
    """The lines of a CSV without times."""
    return json.dumps([_untimed(line) for line in csv.DictReader(data.decode().splitlines())]).encode()


def _archive(data: bytes) -> bytes:
    """What a comparison keeps of a clip: the archive's own files have the time at which they were written."""
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    about = _scores(arrays.pop("about").tobytes())
    rest = ((f"{name} {one.dtype} {one.shape}".encode(), one.tobytes()) for name, one in sorted(arrays.items()))
    return b"\n".join([about, *(part for one in rest for part in one)])


def _nothing(data: bytes) -> bytes:
    """Of a file that need only be there."""
    return b""


_MASKED = {
    "metrics.json": _scores, "index.html": _page, ".npz": _archive, ".safetensors": _weights,
    "tables.csv": _columns, "tables.tex": _timeless, "metrics.jsonl": _nothing, "tiny/config.yaml": _nothing,
}  # fmt: skip
