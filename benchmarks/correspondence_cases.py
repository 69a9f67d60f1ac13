"""Test cases of benchmarks/correspondence.py: pairs of rendered frames, and images of known motion."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nte.color import display, psnr
from nte.filters.align_accumulate import AlignAccumulate, AlignAccumulateOptions
from nte.filters.estimated import matched_grey
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.frames.scalars import estimate_exposure
from nte.motion.correspondence import find_correspondence, noise_of, patch_error, rejection_mask
from nte.motion.geometric import dual_motion
from nte.motion.search import SEARCHES
from nte.motion.warp import inside, pixel_centres, warp
from nte.session import Session
from tests.motion.test_correspondence import real_patch_error

PAIRS = 2  # pairs of frames from a clip, at most
LONG = 6  # clips of this many frames or more are for accumulation
SURFACES = ("spheres", "dining")  # scenes in which only surfaces move, so the motion is known
_SIZE = 512


class Pair(NamedTuple):
    """Noisy images to search, clean images to compare, and the true motion where it is known."""

    current: Tensor  # (1, 1, H, W) noisy, displayed luminance
    previous: Tensor
    now: Tensor  # (1, C, H, W) clean, displayed
    before: Tensor
    truth: Tensor | None = None  # (1, 2, H, W) px
    seen: Tensor | None = None  # (1, 1, H, W) bool: visible, and inside the image, in both frames

    @property
    def images(self) -> tuple[Tensor, Tensor]:
        return self.current, self.previous

    def error(self, motion: Tensor) -> float:
        """Return the mean |warped previous − current| of the clean images."""
        return float((warp(self.before, motion).image - self.now).abs().mean())

    def end_points(self, motion: Tensor) -> Tensor:
        """Return the distances from the true motion, px, of the pixels that were seen in both images."""
        assert self.truth is not None
        assert self.seen is not None
        return (motion - self.truth).square().sum(1, keepdim=True).sqrt()[self.seen]

    def end_point(self, motion: Tensor) -> float:
        return float(self.end_points(motion).mean())

    def panned(self, pan: tuple[int, int]) -> "Pair":
        """Return the clean image, cut to an odd size, and the same image cut out elsewhere."""
        return _panned(self.now.mean(1, keepdim=True), pan)


class Case(NamedTuple):
    """Pairs of one kind."""

    name: str
    noise: str  # of the images, as measured: a name of SEARCHES
    pairs: list[Pair]


def from_clip(folder: Path) -> list[Case]:
    """Read the clip at 1 sample per pixel, and at the mean of its noise seeds if it has several; none if it is long."""
    clip = Clip(folder)
    if len(clip) >= LONG:
        return []
    scene, cases = folder.name.rpartition("_")[0], []
    for samples in sorted({1, clip.seeds}):
        frames, exposure = _read(clip, samples)
        pairs = [_pair(before, now, exposure, scene in SURFACES) for before, now in pairwise(frames)][:PAIRS]
        cases.append(Case(f"{scene}, {samples} spp", noise_of(pairs[0].current), pairs))
    return cases


def long_clips(folders: list[Path]) -> list[Path]:
    return [folder for folder in folders if len(Clip(folder)) >= LONG]


def accumulation(folder: Path, motion: str, kappa: float, eta: float) -> float:
    """Return the mean PSNR, dB, of the displayed image of align_accumulate at 1 spp, without the first frame."""
    frames, exposure = _read(Clip(folder), 1)
    session, values = Session(AlignAccumulate(AlignAccumulateOptions(motion, kappa=kappa, eta=eta))), []
    for frame in frames:
        apart = display(session.denoise(frame), exposure) - display(frame["reference"], exposure)
        values.append(float(psnr(apart.square().mean())))
    return float(np.mean(values[1:]))


def trust(case: Case) -> tuple[float, float, float]:
    """Measure how well the patch error ε works; return means over the case's pairs.

    The three numbers are: the correlation of ε with the patch error of the clean images along the returned motion; and
    the share of pixels, in per cent, that the mask rejects (m > 0) along the true motion and along zero motion, of the
    pixels seen in both images (NaN where no truth is known).
    """
    search, found = SEARCHES[case.noise], []
    for pair in case.pairs:
        motion, error = find_correspondence(*pair.images, search)
        clean = [image.mean(1, keepdim=True) for image in (pair.now, pair.before)]
        row = [_correlation(error, patch_error(*clean, motion, search))]
        for vectors in (pair.truth, torch.zeros_like(motion)):
            if pair.truth is None or vectors is None or pair.seen is None:
                row.append(float("nan"))
            else:
                mask = rejection_mask(patch_error(*pair.images, vectors, search), 2.0, 1.6)
                row.append(100 * float((mask[pair.seen] > 0).float().mean()))
        found.append(row)
    correlation, right, zero = np.mean(found, 0)
    return float(correlation), float(right), float(zero)


def own_error(case: Case) -> float:
    """Return the correlation of ε with the patch error along the returned motion, computed step by step."""
    search, pair = SEARCHES[case.noise], case.pairs[0]
    motion, error = find_correspondence(*pair.images, search)
    return _correlation(error, real_patch_error(*pair.images, motion, search))


def by_level(case: Case) -> tuple[float, float, float, float]:
    """Compare ε, which noisy images have from a coarser level, with the patch error ε₀ of single pixels.

    Taken from the first pair of a case whose motion is known. The four numbers are: the correlation of ε with ε₀ along
    the found motion; the share of pixels, in per cent, on which the mask of ε₀ rejects the true motion (m > 0); and the
    shares on which ε and ε₀ reject zero motion with the threshold that rejects the true one on 2 %. The shares are of
    the pixels that moved by more than 2 px and were seen in both images.
    """
    search, pair = SEARCHES[case.noise], case.pairs[0]
    assert pair.truth is not None
    assert pair.seen is not None
    truth, pixels = pair.truth.contiguous(), replace(search, error_level=0, half=False)
    moved = pair.seen & (truth.square().sum(1, keepdim=True) > 4)
    motion, error = find_correspondence(*pair.images, search)
    true, still = (
        [patch_error(*pair.images, vectors, one)[moved] for one in (search, pixels)]
        for vectors in (truth, torch.zeros_like(truth))
    )
    shares = [float((s > float(np.quantile(t.numpy(), 0.98))).float().mean()) for t, s in zip(true, still, strict=True)]
    rejected = float((rejection_mask(true[1], 2.0, 1.6) > 0).float().mean())
    found = _correlation(error, patch_error(*pair.images, motion, pixels))
    return found, 100 * rejected, 100 * shares[0], 100 * shares[1]


def constructed(seed: int) -> list[Case]:
    """Make discs with 2 and 10 % noise, waves without noise, and pans; the true motion is known."""
    texture = _texture(_SIZE + 120, seed)
    cases = [Case(f"disc, {100 * d:.0f} %", "", _discs(d, seed)) for d in (0.02, 0.1)]
    cases.append(Case("waves, clean", "", [_waves(amplitude, seed) for amplitude in (0.7, 2.0)]))
    cases += [Case(f"texture, pan {pan}", "", [_panned(texture, pan)]) for pan in ((24, 9), (48, 18), (80, 30))]
    return [case._replace(noise=noise_of(case.pairs[0].current)) for case in cases]


def _read(clip: Clip, samples: int) -> tuple[list[Frame], Tensor]:
    """The frames with the mean of so many noise seeds, and the exposure (1,) of the first frame."""
    names = ("color", "reference", "motion", "previous_forward_motion", "depth", "albedo")
    frames = [clip.frame(i, names, range(samples)).torch() for i in range(len(clip))]
    return frames, torch.from_numpy(estimate_exposure(frames[0]["color"].numpy()))


def _pair(before: Frame, now: Frame, exposure: Tensor, known: bool) -> Pair:
    greys = (matched_grey(frame["color"], exposure) for frame in (now, before))
    clean = (display(frame["reference"], exposure) for frame in (now, before))
    if not known:
        return Pair(*greys, *clean)
    where = dual_motion(now["motion"], now["previous_forward_motion"], now["depth"], before["depth"])
    return Pair(*greys, *clean, truth=now["motion"].nan_to_num(), seen=where.valid & ~where.disoccluded)


def _discs(deviation: float, seed: int, count: int = 2) -> list[Pair]:
    """A shaded disc with a faint pattern and Gaussian noise that moves by (6, 2) px a frame (the paper's Figure 6)."""
    here = pixel_centres(torch.zeros(1, 1, _SIZE, _SIZE))
    clean, within = [], []
    for i in range(count + 1):
        away = here - torch.tensor([200.0 + 6 * i, 240.0 + 2 * i]).view(1, 2, 1, 1)
        radius = away.square().sum(1, keepdim=True).sqrt()
        face = 0.7 + 0.15 * away[:, :1] / 100 + 0.08 * torch.sin(away[:, :1] / 9 + 1) * torch.sin(away[:, 1:] / 7)
        clean.append((100.5 - radius).clamp(0, 1) * face)
        within.append(radius < 100)
    noisy = [(image + deviation * _normal(image, seed + i)).clamp(0, 1) for i, image in enumerate(clean)]
    truth = torch.tensor([-6.0, -2.0]).view(1, 2, 1, 1)
    return [
        Pair(noisy[i], noisy[i - 1], clean[i], clean[i - 1], truth.expand(1, 2, _SIZE, _SIZE), within[i])
        for i in range(1, count + 1)
    ]


def _waves(amplitude: float, seed: int) -> Pair:
    """Trains of sines, bent by a motion of this amplitude, px."""
    here = pixel_centres(torch.zeros(1, 1, _SIZE, _SIZE))
    motion = amplitude * torch.cat([torch.sin(here[:, 1:] / 25 + seed) + 0.3, torch.cos(here[:, :1] / 31)], 1)

    def image(at: Tensor) -> Tensor:
        x, y = at[:, :1], at[:, 1:]
        fine = 0.2 * torch.sin(x / 5.1) * torch.cos(y / 6.3)
        return 0.5 + fine + 0.15 * torch.sin((x - 2 * y) / 17) + 0.1 * torch.sin((3 * x + y) / 43)

    now, before = image(here + motion), image(here)
    return Pair(now, before, now, before, motion, inside(here + motion))


def _texture(size: int, seed: int) -> Tensor:
    """A texture with detail of 4 to 128 px, (1, 1, size, size) in [0, 1]."""
    generator, total = torch.Generator().manual_seed(seed), torch.zeros(1, 1, size, size)
    for octave in range(2, 8):
        coarse = torch.rand(1, 1, size // 2**octave + 2, size // 2**octave + 2, generator=generator) - 0.5
        total += F.interpolate(coarse, (size, size), mode="bicubic", align_corners=True) * 2 ** (0.6 * (octave - 7))
    return (0.5 + 0.35 * total).clamp(0, 1)


def _panned(image: Tensor, pan: tuple[int, int]) -> Pair:
    """Two cut-outs of odd size from an image (1, 1, H, W); the current one lies further by the pan."""
    (x, y), height, width = pan, image.shape[-2] - 31, image.shape[-1] - 81
    now, before = image[..., y : y + height, x : x + width], image[..., :height, :width]
    truth = torch.tensor([float(x), float(y)]).view(1, 2, 1, 1).expand(1, 2, height, width)
    return Pair(now, before, now, before, truth, inside(pixel_centres(now) + truth))


def _normal(like: Tensor, seed: int) -> Tensor:
    return torch.randn(like.shape, generator=torch.Generator().manual_seed(seed))


def _correlation(one: Tensor, other: Tensor) -> float:
    return float(torch.corrcoef(torch.stack([one.flatten(), other.flatten()]))[0, 1])
