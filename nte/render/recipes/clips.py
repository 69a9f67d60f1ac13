"""Rendering of a recipe into clips: resumable, in any order, on any number of processes."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from nte.cluster import on_cluster
from nte.files import make_folder, remove
from nte.frames.channels import channels_of
from nte.frames.clip import write_frame
from nte.frames.clip_info import write_clip_info
from nte.jobs import in_processes, require_jobs, tick
from nte.progress import Progress
from nte.render.components.frame import noisy, references
from nte.render.engine.backend import load_mitsuba, require_arrays
from nte.render.engine.stage import Stage
from nte.render.passes.gbuffer import guides
from nte.render.passes.radiance import radiance
from nte.render.passes.rays import Mirrors
from nte.render.passes.shutter import blurred, centre_motion
from nte.render.recipes.jobs import RENDERING
from nte.render.recipes.output import claim, files_of, is_whole, remove_leftovers
from nte.render.recipes.recipe import ClipPlan, make_stage, plan, read_recipe
from nte.render.world.scene import Pixels
from nte.render.world.seeds import derive_generator, derive_seed
from nte.render.world.transforms import Floats
from nte.shipped import shipped
from nte.version import __version__
from nte.writers import only_writer

FPS = 24
Channels = dict[str, Pixels]
GUIDES = (
    "albedo", "normal", "roughness", "emission", "depth", "position", "instance", "motion", "forward_motion",
)  # fmt: skip
REFERENCES = ("reference_a", "reference_b")
COMPONENTS = channels_of("components", noisy=True)
SHUTTER_CHANNELS = channels_of("shutter", noisy=True)
COMPONENT_REFERENCES = channels_of("components", noisy=False)


def render_recipe(
    recipe_path: Path | str,
    out: Path | str,
    jobs: int = 1,
    force: bool = False,
    progress: bool = True,
    scheduler: str | None = None,
    wanted: Callable[[str], bool] = lambda folder: True,
) -> list[Path]:
    """Render every clip of a recipe below `out` and return the clips' folders.

    Continue where an earlier run stopped: whole frames are kept. The result has the same bytes for any number of jobs,
    workers and interruptions.

    jobs: number of processes; a single process already uses all cores. force: see output.claim. progress: show progress
    on stderr. scheduler: address of a Dask scheduler, whose workers render instead; they must see `out` under the same
    path (nte.cluster.on_cluster). wanted: says of a clip's folder, such as test/apples_000, whether to render it; the
    others can follow later. Raises NteError for a faulty recipe, a folder that is not ours, or a full disk.
    """
    require_jobs(jobs)
    out, path = Path(out), shipped(Path(recipe_path))
    load_mitsuba()  # before anything is read or written, because it may be missing
    recipe = read_recipe(path)
    plans = [unit for unit in plan(recipe, path.parent) if wanted(unit.folder)]
    for key in ("components", "shutter", "unshadowed"):
        if any(getattr(unit.group, key) for unit in plans):
            require_arrays(key)
    with only_writer(out), Progress("render", sum(p.group.frames for p in plans), "frame", progress) as told:
        claim(out, recipe, force, path.parent)

        units = {unit.folder: unit for unit in plans}
        work = partial(render_clip, out=out.absolute(), advance=tick)

        def whole(name: str, _: None) -> None:
            told.advance(units[name].group.frames)
            told.say(name)

        if scheduler is not None:
            on_cluster(RENDERING, work, units, out, scheduler, whole)
        elif jobs > 1:
            in_processes(RENDERING, work, units, jobs, lambda name, _: told.say(name), told.advance)
        else:
            for unit in plans:
                render_clip(unit, out, told.advance)
                told.say(unit.folder)
    return [out / p.folder for p in plans]


def render_clip(unit: ClipPlan, out: Path, advance: Callable[[int], None] = lambda frames: None) -> None:
    """Render the missing frames of one clip, then write clip.json. Call advance(1) after each frame."""
    group, folder = unit.group, out / unit.folder
    missing = [index for index in range(group.frames) if not _is_done(unit, folder, index)]
    advance(group.frames - len(missing))
    if not missing and (folder / "clip.json").is_file():
        return
    make_folder(folder)
    remove(folder / "clip.json")  # its presence would mark the clip as finished
    stage = make_stage(unit)
    for index in missing:
        _render_frame(unit, stage, folder, index)
        advance(1)
    remove_leftovers(folder)
    write_clip_info(folder, _info(unit, stage))


def _render_frame(unit: ClipPlan, stage: Stage, folder: Path, index: int) -> None:
    """Write the files of one frame: those of further seeds first, so that the main file completes the frame."""
    render = _with_components if unit.group.components else _blurred if unit.blurred else _colour_only
    channels, seeds = render(unit, stage, index)
    files = files_of(folder, index, unit.group.seeds)
    for path, noisy_channels in reversed(list(zip(files, seeds, strict=True))):
        write_frame(path, channels | noisy_channels if path == files[0] else noisy_channels)


def _colour_only(unit: ClipPlan, stage: Stage, index: int) -> tuple[Channels, list[Channels]]:
    """Guides and references, and the noisy channels of each seed."""
    group = unit.group
    with stage.at(index) as moment:

        def render(channel: str, spp: int, seed: int = 0) -> Pixels:
            return radiance(moment, spp, _seed(unit, index, channel, seed))

        channels = guides(moment, _places(unit, stage, index), cast(Mirrors, group.mirrors))
        motion = {"shutter_motion": centre_motion(moment, group.shutter)} if unit.sharp else {}
        seeds = [{"color": render("color", group.spp, seed), **motion} for seed in range(group.seeds)]
        channels.update({half: render(half, group.reference_spp // 2) for half in REFERENCES})
    return channels, seeds


def _places(unit: ClipPlan, stage: Stage, index: int) -> Floats | None:
    """Places of the guides' samples in the pixels and on the lens; None: those of `pattern`, over the whole pixel."""
    if unit.group.guides == "averaged":
        return None
    if unit.group.guides == "centred":
        return np.full((1, 4), 0.5)
    rng = derive_generator(unit.seed, unit.name, index, "guides")
    return rng.random((stage.width * stage.height, 1, 4))


def _blurred(unit: ClipPlan, stage: Stage, index: int) -> tuple[Channels, list[Channels]]:
    """Guides and references, and the noisy channels of each seed, with a pixel's samples spread over the shutter."""
    with stage.at(index) as moment:
        channels = guides(moment)
    keys = [_seed(unit, index, "color", seed) for seed in range(unit.group.seeds)]
    halves = [_seed(unit, index, half, 0) for half in REFERENCES]
    seeds, references = blurred(stage, index, unit.group.shutter, unit.group.reference_spp, keys, halves)
    channels.update(zip(REFERENCES, references, strict=True))
    return channels, seeds


def _with_components(unit: ClipPlan, stage: Stage, index: int) -> tuple[Channels, list[Channels]]:
    """Guides and references, and the noisy channels of each seed, with the light components and their references."""
    keys = [_seed(unit, index, "color", seed) for seed in range(unit.group.seeds)]
    channels, seeds = noisy(stage, index, keys)
    first, second = (_seed(unit, index, half, 0) for half in REFERENCES)
    with stage.at(index) as moment:
        channels.update(references(moment, unit.group.reference_spp, (first, second)))
    return channels, seeds


def _seed(unit: ClipPlan, index: int, channel: str, seed: int) -> int:
    return derive_seed(unit.seed, unit.name, index, channel, seed)


def _is_done(unit: ClipPlan, folder: Path, index: int) -> bool:
    main, *others = files_of(folder, index, unit.group.seeds)
    more = unit.group.components
    over_shutter = SHUTTER_CHANNELS if unit.blurred else ("shutter_motion",) if unit.sharp else ()
    per_seed = ("color", *over_shutter, *(COMPONENTS if more else ()))
    once = (*GUIDES, *REFERENCES, *(COMPONENT_REFERENCES if more else ()))
    return is_whole(main, (*once, *per_seed), unit) and all(is_whole(path, per_seed, unit) for path in others)


def _info(unit: ClipPlan, stage: Stage) -> dict[str, object]:
    """The content of clip.json. It has no time, host or path, so the same recipe gives the same bytes."""
    group, camera = unit.group, stage.camera
    projection = camera.projection(group.width, group.height).tolist()
    return {
        "width": group.width, "height": group.height, "frames": group.frames, "fps": FPS,
        "spp": group.spp, "seeds": group.seeds, "reference_spp": group.reference_spp,
        "clean_guides": group.guides == "averaged",
        **({"shutter": group.shutter} if group.shutter else {}),
        "cameras": [{"view": camera.view(i).tolist(), "projection": projection} for i in range(group.frames)],
        "origin": {"generator": "nte render", "version": __version__, "recipe": unit.recipe,
                   "seed": unit.seed, "clip": unit.name},
    }  # fmt: skip
