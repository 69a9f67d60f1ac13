"""Frames for which memory does not suffice: one line, which says how much was missing."""

import re
import resource
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.cli import main
from nte.errors import lacking_memory
from nte.frames.clip import write_frame
from nte.frames.clip_files import frame_path
from nte.frames.clip_info import write_clip_info
from tests.faults.limited import WARM

SIDE = 2400  # pixels


def test_what_libraries_say_is_understood() -> None:
    with pytest.raises(MemoryError) as of_numpy:
        np.empty(10**15)
    with pytest.raises(RuntimeError) as of_torch:
        torch.empty(10**15)
    there = r" were asked for, beside the ([\d,]+) MB that the process had"
    for error, asked in ((of_numpy.value, "7.11 PiB"), (of_torch.value, "3,814,697,265.6 MiB")):
        found = re.fullmatch(f"too little memory: another {asked}{there}", lacking_memory(error) or "")
        assert found
        assert 50 < int(found[1].replace(",", "")) < 20_000  # a process that has imported PyTorch
    cuda = RuntimeError("CUDA out of memory. Tried to allocate 2.50 GiB. GPU 0 has a total capacity of 8 GiB")
    assert lacking_memory(cuda) == "too little memory: another 2.50 GiB were asked for"
    assert lacking_memory(MemoryError()) == "too little memory"
    assert lacking_memory(RuntimeError("The size of tensor a (3) must match")) is None


def limited(arguments: list[str], beyond: int, said: str) -> None:
    """Run a command that may ask for so many bytes, and write what it says to a file."""
    with open(said, "w") as file:
        sys.stdout = sys.stderr = file
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + beyond, size + beyond))
        code = main(arguments)
    sys.exit(code)


@pytest.mark.slow
@pytest.mark.parametrize("denoiser", ["taa", "svgf", "MODEL"])
def test_a_frame_that_is_too_large_is_one_line(denoiser: str, run: Path, tmp_path: Path) -> None:
    if denoiser == "MODEL":
        denoiser = str(tmp_path / "model.onnx")
        assert main(["export", str(run), "--out", denoiser]) == 0
    clip = tmp_path / "large"
    shapes = {"color": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2, "forward_motion": 2}
    channels = {name: np.full((width, SIDE, SIDE), 0.5, np.float32) for name, width in shapes.items()}
    write_frame(frame_path(clip, 0), channels)
    write_clip_info(clip, {"width": SIDE, "height": SIDE, "frames": 1})
    words = ["denoise", str(clip), "--denoiser", denoiser, "--out", str(tmp_path / "out")]
    process = WARM.Process(target=limited, args=(words, 700 << 20, str(tmp_path / "said")))
    process.start()
    process.join()
    said = (tmp_path / "said").read_text().splitlines()
    assert process.exitcode == 2, said
    assert "too little memory: another" in said[-1]
    assert sum(line.startswith("nte: ") for line in said) == 1
    assert not any("Traceback" in line for line in said)
