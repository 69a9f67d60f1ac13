"""What a run says while it trains: metrics.jsonl, TensorBoard's events, and lines or a bar for people."""

import json
from collections.abc import Mapping
from pathlib import Path

from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from nte.files import writing
from nte.progress import Progress


class RunLog:
    """The log of the run in `folder`, from step `first` on. Every method raises NteError if it cannot be written."""

    def __init__(self, folder: Path, first: int, progress: Progress) -> None:
        self.folder, self._progress = folder, progress
        with writing(folder):
            self._events = SummaryWriter(str(folder), purge_step=first)

    def values(self, step: int, values: Mapping[str, float]) -> None:
        """Say the values of a step: a line in metrics.jsonl, curves, and a line on stdout or the bar."""
        with writing(self.folder):
            with (self.folder / "metrics.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps({"step": step, **values}) + "\n")
            for name, value in values.items():
                self._events.add_scalar(name, value, step)
        line = f"step {step}: " + ", ".join(f"{name} {value:.4g}" for name, value in values.items())
        if self._progress.lines:
            print(line, flush=True)
            self._progress.told()
        else:
            self._progress.say(f"loss {values['loss']:.4f}" if "loss" in values else "")

    def picture(self, step: int, name: str, image: Tensor) -> None:
        """Show a picture (3, H, W) in [0, 1] among TensorBoard's."""
        with writing(self.folder):
            self._events.add_image(name, image, step)

    def close(self) -> None:
        """Write what TensorBoard's thread has not written yet."""
        with writing(self.folder):
            self._events.close()
