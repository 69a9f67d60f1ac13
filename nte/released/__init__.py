"""The models that come with nte, by name: NAME.onnx, its weights NAME.safetensors, and its card NAME.md; and a clip.

Each .onnx file carries its checksum, which is verified whenever it is loaded (nte.runtime.description).
"""

from pathlib import Path

FOLDER = Path(__file__).parent
DEFAULT = "steady"  # the one that nte demo shows
WITH_ALL_FRAMES = "steady:ahead=true"  # what nte denoise takes if nothing is said
CLIP = FOLDER / "toys"  # ten frames to look at (datasets/blender/toys.sh)


def names() -> list[str]:
    """List the names of the released models."""
    return sorted(path.stem for path in FOLDER.glob("*.onnx"))


def model_path(name: str) -> Path | None:
    """Return the file of the released model of this name; None if there is none."""
    return FOLDER / f"{name}.onnx" if name in names() else None


def weights_path(name: str) -> Path | None:
    """Return the weights of the released model of this name, with which a training can begin; None if there is none."""
    return FOLDER / f"{name}.safetensors" if name in names() else None
