"""Commands that write files, to be disturbed: started again, each ends with the files of an undisturbed run."""

import json
from pathlib import Path

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
    """All files below a folder, without what no two runs share: times in scores and pages, and a run's log."""
    found = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    for name, data in found.items():
        if name.endswith("metrics.json"):
            rows = [{key: v for key, v in row.items() if "ms_per_frame" not in key} for row in json.loads(data)["rows"]]
            found[name] = json.dumps(rows).encode()
        elif name.endswith("index.html"):
            found[name] = data[-10:]
        elif name.endswith(".npz"):  # a comparison's scores of a clip
            found[name] = b""
    if any(name.endswith("plan.json") for name in found):
        found = {name: _weights(data) for name, data in found.items() if name.endswith(".safetensors")}
    return found


def _weights(data: bytes) -> bytes:
    """A checkpoint's tensors, and what is said of them in order: safetensors writes the metadata in any order."""
    length = 8 + int.from_bytes(data[:8], "little")
    return json.dumps(json.loads(data[8:length]), sort_keys=True).encode() + data[length:]
