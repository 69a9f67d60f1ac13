"""Commands that write files, to be disturbed: started again, each ends with the files of an undisturbed run."""

import json
from pathlib import Path

from tests.training.runs import config_file

COMMANDS = {
    "denoise": "denoise CLIP --denoiser taa --png --out OUT",
    "loose frames": "denoise FRAMES --denoiser noisy --out OUT",
    "estimate": "estimate CLIP --noise clean --out OUT",
    "evaluate": "evaluate --clips CLIP --denoisers noisy taa --out OUT",
    "export": "export RUN --out OUT/model.onnx",
    "import": "import exr CLIP --map MAP --out OUT/clip",
    "render": "render RECIPE --out OUT",
    "train": "train CONFIG runs=OUT resume=true --device cpu",
    "train from mapped files": "train CONFIG runs=OUT resume=true data.cache_gb=0 --device cpu",
    "view": "view CLIP --denoiser taa --out OUT --no-open",
}
MAP = "channels: {color: color, albedo: albedo, normal: normal}\n"
RECIPE = "name: x\ntrain: [{scene: rooms, clips: 2, width: 16, height: 16, frames: 3, reference_spp: 4}]\n"


def command(name: str, out: Path, clip: Path, run: Path, folder: Path) -> list[str]:
    """The words of a command that writes into `out`. folder: where its map, recipe and configuration are made."""
    (folder / "map.yaml").write_text(MAP)
    (folder / "recipe.yaml").write_text(RECIPE)
    places = {
        "CLIP": clip, "RUN": run, "MAP": folder / "map.yaml", "RECIPE": folder / "recipe.yaml",
        "CONFIG": config_file(folder, clip),
    }  # fmt: skip
    frames = [str(path) for path in sorted(clip.glob("*.exr"))]
    words = COMMANDS[name].split()
    typed = [frames if word == "FRAMES" else [str(places.get(word, word))] for word in words]
    return [word.replace("OUT", str(out)) for part in typed for word in part]


def contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder, without what no two runs share: times in scores and pages, and a run's log."""
    found = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    if "metrics.json" in found:
        rows = json.loads(found["metrics.json"])["rows"]
        kept = [{key: value for key, value in row.items() if "ms_per_frame" not in key} for row in rows]
        found |= {"metrics.json": json.dumps(kept).encode()}
    if "index.html" in found:
        found |= {"index.html": found["index.html"][-10:]}
    if any(name.endswith("plan.json") for name in found):
        found = {name: _weights(data) for name, data in found.items() if name.endswith(".safetensors")}
    return found


def _weights(data: bytes) -> bytes:
    """A checkpoint's tensors, and what is said of them in order: safetensors writes the metadata in any order."""
    length = 8 + int.from_bytes(data[:8], "little")
    return json.dumps(json.loads(data[8:length]), sort_keys=True).encode() + data[length:]
