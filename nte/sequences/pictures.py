"""Pictures of a denoised sequence: one beside each frame, those of a video, and those that are half noisy."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nte.errors import NteError
from nte.files import make_folder
from nte.frames.channels import CHANNELS
from nte.frames.clip import Pixels
from nte.frames.show import RGB, show, write_png
from nte.frames.views import find_view
from nte.sequences.video import FORMATS, open_video, require_video


@dataclass(frozen=True)
class PictureSettings:
    """What is written besides the denoised frames.

    png: a picture beside each frame. video: a file (.mp4, .webp) of all pictures, `fps` a second. before_after: noisy
    on the left and denoised on the right, of the frame in the middle of the sequence (.png) or of all frames (.mp4,
    .webp). view: the view transform, see `nte.frames.views.find_view`; None takes `standard` for frames of another
    renderer, `nte` for others.
    """

    png: bool = False
    video: Path | None = None
    fps: float = 24.0
    before_after: Path | None = None
    view: str | None = None


@dataclass(frozen=True)
class Denoised:
    """A frame of a sequence: its number, the image before and after (C, H, W), and the exposure of the denoiser.

    stated: whether the exposure was given, and not estimated.
    """

    number: int
    noisy: Pixels
    pixels: Pixels
    exposure: float
    stated: bool


class Pictures:
    """The pictures of one sequence, as the settings say.

    target: the channel that they show. written: the denoised frames' files. usual: the view transform, if the settings
    choose none. Raises NteError for names that end otherwise, and for a view transform that is not there.
    """

    def __init__(self, settings: PictureSettings, target: str, written: Sequence[Path], usual: str) -> None:
        for path, endings in ((settings.video, [*FORMATS]), (settings.before_after, [".png", *FORMATS])):
            if path and path.suffix.lower() not in endings:
                raise NteError(f"{path}: expected a name that ends in {' or '.join(endings)}")
        if settings.view and CHANNELS[target].kind != "radiance":
            raise NteError(f"view {settings.view}: the denoiser gives '{target}', which is no light and has no view")
        extra = [path for path in (settings.video, settings.before_after) if path]
        self._moving = [path for path in extra if path.suffix.lower() in FORMATS]
        for path in self._moving:
            require_video(path, settings.fps)
        self._settings, self._target = settings, target
        self._beside = [path.with_suffix(".png") for path in written] if settings.png else []
        self._middle = len(written) // 2
        self.name = settings.view or usual
        self._view = find_view(self.name)
        self.files = (*self._beside, *extra)
        self._add: dict[Path, Callable[[RGB], None]] = {}  # to the videos that are open

    @contextmanager
    def videos(self) -> Iterator[None]:
        """Keep the videos open, to which `write` adds; they are whole after the block, or absent if it raises."""
        with ExitStack() as stack:
            for path in self._moving:
                self._add[path] = stack.enter_context(open_video(path, self._settings.fps))
            yield

    def write(self, image: Denoised) -> None:
        """Write the pictures of a frame; the frames come in their order."""
        settings, both = self._settings, self._settings.before_after
        halves = both is not None and (both in self._moving or image.number == self._middle)
        if not (settings.png or settings.video or halves):
            return
        after = self._draw(image.pixels, image)
        if settings.png:
            write_png(self._beside[image.number], after)
        if settings.video:
            self._add[settings.video](after)
        if both and halves:
            joined = _halves(self._draw(image.noisy, image), after)
            if both in self._moving:
                self._add[both](joined)
            else:
                make_folder(both.parent)
                write_png(both, joined)

    def _draw(self, pixels: Pixels, image: Denoised) -> RGB:
        """Draw light with the view transform, and anything else as the table of channels says.

        An exposure that is only estimated would make pictures brighter or darker than the renderer's own: the view
        transform `nte` alone uses it.
        """
        exposure = image.exposure if image.stated or self.name == "nte" else 1.0
        return show(self._target, pixels, exposure, view=self._view).pixels


def _halves(before: RGB, after: RGB) -> RGB:
    """Join the left half of one picture and the right half of another (H, W, 3), with a white line between them."""
    middle = before.shape[1] // 2
    joined = np.concatenate([before[:, :middle], after[:, middle:]], axis=1)
    joined[:, middle : middle + max(1, before.shape[1] // 640)] = 255
    return joined
