"""Intel Open Image Denoise, a single-frame denoiser that is easy to install, for comparison.

Afra, «Intel Open Image Denoise», 2019–; used through the package pyoidn. It works on NumPy arrays, without PyTorch.
"""

import threading
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from nte.denoiser import Filter, Result, State, refuse_other_size, sanitised
from nte.errors import NteError, lacking_memory, needs_extra
from nte.filters.accumulation import History, Surface, accumulate, with_denoised
from nte.filters.change import in_blocks
from nte.filters.look_ahead import Next, add_next
from nte.frames.ahead import NEXT
from nte.frames.clip import Pixels
from nte.frames.frame import Frame
from nte.options import Allowed, Options

GUIDES = ("albedo", "normal")
MOTION = ("motion", "depth", "previous_forward_motion")  # what accumulation takes
_TO_NEXT = "forward_motion"  # and to look ahead, beside the channels of the next frame

_Handle: TypeAlias = Any  # a device or a filter of pyoidn, which is not typed


@dataclass(frozen=True)
class OidnOptions(Options, name="oidn"):
    """Options of OIDN.

    target: the radiance to denoise. quality: OIDN's own quality setting. prefilter: denoise the guides first, each by
    itself, as OIDN's documentation recommends for noisy guides; None does so for guides that are not known to be clean
    (`Frame.clean_guides`), unless clean_aux is given. clean_aux: tell OIDN that its guides are free of noise (its
    `cleanAux`); with noisy guides it then copies their noise into the image; None does so for guides that are clean or
    prefiltered. None is typed `auto`. accumulate: at most so many frames are averaged before OIDN sees them, each pixel
    for as long as its light does not seem to have changed (nte.filters.accumulation); 1 is OIDN as it comes, frame by
    frame. ahead: also see the next frame, where a sequence has it, which takes accumulate (nte.filters.look_ahead).
    """

    quality: Literal["high", "balanced", "fast"] = "high"
    clean_aux: bool | None = None
    prefilter: bool | None = None
    target: Literal["color", "glossy", "indirect"] = "color"
    accumulate: Annotated[int, Allowed("a number of frames from 1 to 64", lambda n: 1 <= n <= 64)] = 1
    ahead: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.ahead and (self.accumulate == 1 or self.target != "color"):
            raise NteError(
                f"{self.name}: ahead adds the next frame's color to what is accumulated: give accumulate=8, no target"
            )


class Oidn(Filter[OidnOptions]):
    """OIDN on HDR radiance, frame by frame, guided by albedo and normal where the frame has them.

    OIDN chooses its own exposure for each frame. Unless it accumulates it has no history, and the state is empty.
    Accumulating takes motion, and depth or previous_forward_motion, without which a frame is denoised by itself. OIDN's
    devices and filters are kept from call to call. Raises NteError if pyoidn is not installed.
    """

    needs: tuple[str, ...] = ("color",)
    optional: tuple[str, ...] = GUIDES
    options_type = OidnOptions
    uses_device = False

    def __init__(self, options: OidnOptions | None = None, *, device: str = "cpu") -> None:
        super().__init__(options, device=device)
        try:
            import pyoidn
        except ImportError as error:
            raise needs_extra("oidn", "oidn", error) from error
        self.target = self.options.target
        self.needs = (self.target,)
        self.accumulates = self.options.accumulate > 1
        if self.accumulates:
            self.optional, self.wants = (*GUIDES, *MOTION), ("motion",)
        if self.options.ahead:
            self.optional = (*self.optional, _TO_NEXT, *NEXT)
        self._denoise = pyoidn.denoise
        self._prefilters = _Prefilters(self.options.quality)

    @sanitised
    def step(self, frame: Frame, state: Sequence[History] | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Denoise `target` (N, 3, H, W), each image of the batch separately; bad pixels count as 0."""
        whole = frame.numpy()
        arrays = {name: np.asarray(whole[name], np.float32) for name in (*self.needs, *self.optional) if name in whole}
        guided = [name for name in GUIDES if name in frame] if "albedo" in frame else []  # normals need an albedo
        histories = self._histories(frame, state)
        denoised = []
        for i, noisy in enumerate(arrays[self.target]):
            given = {name: values[i] for name, values in arrays.items()}
            guides = [given[name] for name in guided]
            if not self.accumulates:
                denoised.append(self._clean(noisy, guides, *self._switches(frame), self.options.quality))
                continue
            surface, after = self._seen(given, bool(frame.clean_guides))
            small, clean = [in_blocks(guide) for guide in guides], bool(frame.clean_guides)
            denoise = partial(self._clean, guides=small, prefilter=False, clean_aux=clean, quality="fast")
            glance = _once(denoise)  # past and next frame ask for the same blocks
            image, accumulated = accumulate(noisy, surface, histories[i], self.options.accumulate, glance)
            if after:
                image = add_next(noisy, surface, accumulated, after, glance)
            denoised.append(self._clean(image, guides, *self._switches(frame), self.options.quality))
            histories[i] = with_denoised(accumulated, denoised[-1], surface)
        return Result(np.stack(denoised)), tuple(histories)

    def _seen(self, given: Mapping[str, Pixels], clean_guides: bool) -> tuple[Surface, Next | None]:
        """What accumulation takes from the channels (C, H, W) of an image: of its surfaces, and of the next frame."""
        # Light from a glossy reflection has no texture to divide by, and what a noisy one divides becomes darker.
        divides = self.target != "glossy" and clean_guides
        albedo, next_albedo = (given.get(name) if divides else None for name in ("albedo", "next_albedo"))
        surface = Surface(albedo, *(given.get(name) for name in MOTION))
        light = given.get("next_color")
        if _TO_NEXT not in given or light is None or not light.any():  # black where others of the batch go on
            return surface, None
        return surface, Next(light, next_albedo, given.get("next_depth"), given.get("next_motion"), given[_TO_NEXT])

    def _clean(self, image: Pixels, guides: list[Pixels], prefilter: bool, clean_aux: bool, quality: str) -> Pixels:
        """Let OIDN denoise one image (3, H, W)."""
        image, *guides = (_interleaved(values) for values in (image, *guides))
        if prefilter:
            guides = list(self._prefilters(guides))
        with _its_errors():
            denoised = self._denoise(image, *guides, hdr=True, clean_aux=clean_aux, quality=quality)
        return np.ascontiguousarray(denoised.transpose(2, 0, 1), np.float32)

    def _histories(self, frame: Frame, state: Sequence[History] | None) -> list[History | None]:
        """The history of each image of the batch; none where a sequence starts, or if nothing is accumulated."""
        if not self.accumulates:
            return []
        if not state:
            return [None] * frame.batch
        refuse_other_size(frame, (len(state), *state[0].length.shape))
        starts = [False] * frame.batch if frame.reset is None else [r > 0 for r in frame.reset]
        return [None if start else history for start, history in zip(starts, state, strict=True)]

    def settings(self, frame: Frame) -> str:
        """Return the options in effect for a frame like this one, as a user would type them."""
        prefilter, clean_aux = self._switches(frame)
        found = f"quality={self.options.quality}"
        if self.accumulates:
            found += f",accumulate={self.options.accumulate}" + ",ahead=true" * self.options.ahead
        if "albedo" not in frame:
            return f"{found}, without guides"
        return f"{found},clean_aux={clean_aux},prefilter={prefilter}".lower()

    def _switches(self, frame: Frame) -> tuple[bool, bool]:
        """The values of prefilter and clean_aux for a frame."""
        if "albedo" not in frame:
            return False, False
        clean, given, prefilter = bool(frame.clean_guides), self.options.clean_aux, self.options.prefilter
        prefilter = not clean and given is None if prefilter is None else prefilter
        return prefilter, clean or prefilter if given is None else given


def _once(denoise: Callable[[Pixels], Pixels]) -> Callable[[Pixels], Pixels]:
    """Let a denoiser run for its first image alone, and give that one's result for all after it."""
    done: list[Pixels] = []

    def denoised(image: Pixels) -> Pixels:
        if not done:
            done.append(denoise(image))
        return done[0]

    return denoised


@contextmanager
def _its_errors() -> Iterator[None]:
    """Turn OIDN's errors into ours, such as a library that cannot be loaded: pyoidn does so for the first image."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        if lacking_memory(error):
            raise
        raise NteError(f"Open Image Denoise fails: {' '.join(str(error).split())}: install pyoidn again") from error


class _Prefilters:
    """OIDN's networks that denoise a guide alone: filters that get an albedo or a normal and nothing else.

    pyoidn's `denoise` requires a colour, so this class uses its low-level filters, which are made on first use. A
    filter holds its images between calls: threads take turns.
    """

    def __init__(self, quality: str) -> None:
        self.quality = quality
        self._device: _Handle = None
        self._filters: dict[str, _Handle] = {}
        self._turn = threading.Lock()

    def __call__(self, guides: list[Pixels]) -> Iterator[Pixels]:
        """Denoise albedo and normal (H, W, 3), in this order, or albedo alone. Raises NteError where OIDN fails."""
        for name, guide in zip(GUIDES, guides, strict=False):
            yield self._run(name, guide)

    def _run(self, name: str, guide: Pixels) -> Pixels:
        import pyoidn

        with self._turn:
            if self._device is None:
                with _its_errors():
                    self._device = pyoidn.Device()
                    self._device.commit()
                weakref.finalize(self, _release, self._device, self._filters)
            if name not in self._filters:
                self._filters[name] = pyoidn.Filter(self._device, pyoidn.OIDN_FILTER_TYPE_RT)
            chosen, output = self._filters[name], np.empty_like(guide)
            chosen.set_image(name, guide, pyoidn.OIDN_FORMAT_FLOAT3)
            chosen.set_image(pyoidn.OIDN_IMAGE_OUTPUT, output, pyoidn.OIDN_FORMAT_FLOAT3)
            chosen.set_quality(getattr(pyoidn, f"OIDN_QUALITY_{self.quality.upper()}"))
            chosen.commit()
            chosen.execute()
            if message := self._device.get_error():
                raise NteError(f"oidn: {name} cannot be prefiltered: {message}")
            return output


def _release(device: _Handle, filters: dict[str, _Handle]) -> None:
    for chosen in filters.values():
        chosen.release()
    device.release()


def _interleaved(values: Pixels) -> Pixels:
    """The values (C, H, W) as (H, W, C)."""
    return np.ascontiguousarray(values.transpose(1, 2, 0), np.float32)
