"""The subcommand `nte denoise`."""

import argparse
from pathlib import Path

from nte.cli.parsing import DENOISER, Commands, add_device, add_force, add_provider, command, parse_frames
from nte.errors import NteError
from nte.overlap import sleep_while_waiting
from nte.released import WITH_ALL_FRAMES


def add(commands: Commands) -> None:
    """Add `denoise` to the subcommands of `nte`."""
    parser = command(commands, "denoise", _denoise, "denoise a clip or frames; writes linear OpenEXR")
    parser.add_argument("sources", type=Path, nargs="+", metavar="CLIP_OR_FOLDER_OR_FILES")
    text = f"{DENOISER} (default: {WITH_ALL_FRAMES}, a released model on top of Open Image Denoise)"
    parser.add_argument("--denoiser", default=WITH_ALL_FRAMES, metavar="SPEC", help=text)
    parser.add_argument("--out", type=Path, required=True, help="folder for the frames")
    text = "estimate, or estimate:key=value,…: motion from the images, instead of given vectors"
    parser.add_argument("--motion", metavar="estimate", help=text)
    text = "how to read another renderer's files: a channel map, or the name of one (default: the one that fits)"
    parser.add_argument("--map", metavar="MAP", help=text)
    text = "a change to the map, such as view=left; repeat it for more"
    parser.add_argument("--set", action="append", default=[], metavar="key=value", help=text)
    text = (
        "these frames only, by the numbers in their names, such as 10-20, with their history from up to 32 before them"
    )
    parser.add_argument("--frames", type=parse_frames, metavar="FIRST-LAST", help=text)
    parser.add_argument("--exposure", type=float, help="linear factor of the sequence (default: estimated once)")
    parser.add_argument("--png", action="store_true", help="a picture beside each frame")
    parser.add_argument("--video", type=Path, metavar="FILE.mp4", help="a video of all pictures (.mp4, .webp)")
    parser.add_argument("--fps", type=float, default=24.0, help="frames of the video per second (default: 24)")
    text = "a picture whose left half is noisy: of the middle frame (.png), or a moving one of all (.mp4, .webp)"
    parser.add_argument("--before-after", type=Path, metavar="FILE.png", help=text)
    text = (
        "view transform of the pictures: nte (exposure, x/(1+x), sRGB), standard (sRGB, as the renderer's own; default "
        "for another renderer's frames), or one of OpenColorIO's, such as agx where OCIO names Blender's configuration"
    )
    parser.add_argument("--view", help=text)
    add_device(parser)
    add_provider(parser)
    add_force(parser)


def _denoise(options: argparse.Namespace) -> None:
    sleep_while_waiting()  # before PyTorch is loaded
    from nte.registry import load_denoiser, with_provider
    from nte.sequences.denoise import denoise_files
    from nte.sequences.pictures import PictureSettings

    if options.motion and options.motion.partition(":")[0] != "estimate":
        raise NteError(f"--motion {options.motion}: expected estimate, or estimate:key=value,…")
    spec = f"{options.motion}+{options.denoiser}" if options.motion else options.denoiser
    if options.provider:
        (spec,) = with_provider([spec], options.provider)
    denoiser = load_denoiser(spec, options.device)
    pictures = PictureSettings(options.png, options.video, options.fps, options.before_after, options.view)
    written = denoise_files(
        options.sources, denoiser, options.out, options.exposure, pictures, options.force, options.map, options.set,
        spec=spec, wanted=options.frames,
    )  # fmt: skip
    made = [f"{len(written)} frames in {options.out}", *filter(None, (options.video, options.before_after))]
    print(*made, sep=", ")
