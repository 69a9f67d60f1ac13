"""Make the folder of the page that denoises a clip in the browser: its files, ONNX Runtime, the model and the clip.

    python export/web/prepare.py demo/quickstart.onnx data/quickstart/test/rooms_000 --out demo/page
    python -m http.server --bind 127.0.0.1 --directory demo/page

`npm ci` in export/web brings ONNX Runtime before. A server is needed because browsers load no modules from disk.
"""

import argparse
import shutil
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from nte.errors import NteError
from nte.files import make_folder, refuse_to_replace
from nte.frames.channels import PRIOR
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.runtime.session import OnnxDenoiser
from nte.runtime.vectors import write_vectors

HERE = Path(__file__).resolve().parent
PAGE = (
    "index.html",
    "page.mjs",
    "placement.mjs",
    "../node/denoiser.mjs",
    "../node/description.mjs",
    "../node/vectors.mjs",
)
RUNTIME = (
    "ort.webgpu.bundle.min.mjs",
    "ort-wasm-simd-threaded.asyncify.wasm",
)  # its WebAssembly runs without a GPU too


def prepare(model: Path, clip: Path, out: Path, frames: int = 10, packages: Path = HERE / "node_modules") -> Path:
    """Write the folder of the page, and return its index.html.

    model: an exported one. clip: a clip of nte, whose first `frames` frames are played. packages: what npm has
    installed. Raises NteError for what is not there, for no frames, and for a model that is built on another denoiser.
    """
    if frames < 1:
        raise NteError(f"--frames is {frames}, expected 1 or more")
    runtime = packages / "onnxruntime-web" / "dist"
    if not (runtime / RUNTIME[0]).is_file():
        raise NteError(f"{runtime / RUNTIME[0]}: does not exist: run npm ci in {HERE}")
    denoiser = OnnxDenoiser(model)
    if PRIOR in denoiser.needs:
        raise NteError(
            f"{model}: needs the image of '{denoiser.prior}', which a browser does not have: give another model"
        )
    make_folder(out)
    write_vectors(model, out / "clip", islice(_frames(denoiser, Clip(clip)), frames))
    for file in (*(HERE / name for name in PAGE), *(runtime / name for name in RUNTIME)):
        shutil.copyfile(file, out / file.name)
    shutil.copyfile(model, out / "model.onnx")
    return out / "index.html"


def _frames(denoiser: OnnxDenoiser, clip: Clip) -> Iterator[Frame]:
    """The frames of a clip, with the channels that the graph or its scalars are made from."""
    known = [name for name in denoiser.optional if name in clip.channels]
    return (clip.frame(index, (*denoiser.needs, *known)) for index in range(len(clip)))


def main() -> int:
    """Run the command; return the exit code."""
    parser = argparse.ArgumentParser(description="Make the folder of a page that denoises a clip in the browser.")
    parser.add_argument("model", type=Path, metavar="MODEL.onnx")
    parser.add_argument("clip", type=Path, metavar="CLIP")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--frames", type=int, default=10, help="how many frames are played (10)")
    parser.add_argument("--force", action="store_true", help="overwrite a page that is there")
    options = parser.parse_args()
    try:
        refuse_to_replace([options.out / "index.html"], options.force)
        print(prepare(options.model, options.clip, options.out, options.frames))
    except NteError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
