"""Motion vectors for a clip that has none, estimated from its images and written as a clip with error and mask."""

from pathlib import Path

from nte.errors import NteError
from nte.files import refuse_to_replace, remove
from nte.filters.estimated import EstimateOptions, Estimator, Noise
from nte.frames.clip import Clip, as_layers
from nte.frames.clip_files import frame_path
from nte.frames.clip_info import write_clip_info
from nte.frames.exr import read_layers, write_exr
from nte.frames.usable import known_cap, light_cap, usable_frame
from nte.motion.correspondence import rejection_mask
from nte.progress import Progress
from nte.unfinished import begin, finish, is_unfinished
from nte.writers import only_writer

KAPPA, ETA = 2.0, 1.6  # parameters of the mask, the same as those of align_accumulate
_REPLACED = ("motion.", "forward_motion.", "motion_error.", "motion_mask.")


def estimate_clip(
    source: Path, out: Path, noise: Noise = "auto", guides: bool = False, known: bool = False, device: str = "cpu",
    force: bool = False,
) -> list[Path]:  # fmt: skip
    """Write the clip `source` with estimated motion to the folder `out`; return the frames' files.

    `motion` is the estimate (px, current → previous), `motion_error` its patch error, and `motion_mask` is 1 where the
    motion must not be trusted: its error is large, it leads out of the previous frame, or the frame is the first one,
    whose motion is 0. `forward_motion` is dropped, as it would contradict; all other layers stay. noise, guides and
    known are options of `EstimateOptions`. Only noise seed 0 is written. Raises NteError if channels are missing, if
    `out` is the clip itself, and if files exist without `force`, unless the same estimation was killed there.
    """
    clip = Clip(source)
    estimator = Estimator(EstimateOptions(noise, guides, known), device=device, errors=True)
    missing = [name for name in estimator.needs if name not in clip.channels]
    if missing:
        raise NteError(f"{source}: {', '.join(missing)} is missing, which the search needs; it has {clip.channels}")
    written = [frame_path(out, i) for i in range(len(clip))]
    if out.resolve() == source.resolve():
        raise NteError(f"{out}: is the clip itself: choose another folder")
    command = {"estimate": source, "noise": noise, "guides": guides, "known": known}
    state, cap = None, None
    with only_writer(out), Progress("estimate", len(clip), "frame") as progress:
        refuse_to_replace((*written, out / "clip.json"), force or is_unfinished(out, command))
        begin(out, command)
        remove(out / "clip.json")  # until its frames are all there
        for index, path in enumerate(written):
            frame = clip.frame(index, estimator.needs)
            cap = light_cap(frame, cap)
            found, state = estimator.step(usable_frame(frame, estimator.needs, known_cap(cap)), state)
            assert found.error is not None
            mask = rejection_mask(found.error, KAPPA, ETA).where(found.valid, 1.0)
            layers = read_layers(frame_path(source, index))
            kept = {name: plane for name, plane in layers.items() if not name.startswith(_REPLACED)}
            channels = {"motion": found.motion, "motion_error": found.error, "motion_mask": mask}
            write_exr(path, kept | as_layers({name: values[0].cpu().numpy() for name, values in channels.items()}))
            progress.advance(1)
        write_clip_info(out, {**clip.info, "seeds": 1})
        finish(out)
    return written
