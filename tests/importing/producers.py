"""The disc of tests.synthetic as other producers would write it: an engine's EXR files, Blender's, noisebase's."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import yaml

from nte.frames.exr import write_exr
from tests.synthetic import Pixels, disc_frame

SIZE = (48, 64)
MOVING = {"velocity": (5.0, -2.0), "wall_velocity": (-3.0, 1.5), "size": SIZE}
SKY_ROWS = 3  # rows at the top that show no surface
FOV = 50.0  # vertical, degrees


def scene(count: int = 4) -> list[dict[str, Pixels]]:
    """Frames in nte's conventions, with a strip of sky."""
    frames = []
    for i in range(count):
        frame = disc_frame(i, rng=np.random.default_rng(i), **MOVING)  # type: ignore[arg-type]
        for name in ("depth", "normal", "instance", "albedo"):
            frame[name][:, :SKY_ROWS] = 0
        frame["color"] = frame["color"].astype(np.float16).astype(np.float32)
        frames.append(frame)
    return frames


def write_layers(folder: Path, frames: Sequence[dict[str, Pixels]], first: int = 0) -> Path:
    """Numbered EXR files of flat layers: name → (H, W)."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, layers in enumerate(frames, start=first):
        write_exr(folder / f"shot.{i:03d}.exr", {n: np.ascontiguousarray(v, np.float32) for n, v in layers.items()})
    return folder


def named(prefix: str, suffixes: str, values: Pixels) -> dict[str, Pixels]:
    return {f"{prefix}.{suffix}": plane for suffix, plane in zip(suffixes, values, strict=True)}


def rotation(angle: float) -> npt.NDArray[np.float64]:
    """About the y axis, then a little about x."""
    c, s = np.cos(angle), np.sin(angle)
    tilt = np.array([[1, 0, 0], [0, np.cos(0.2), -np.sin(0.2)], [0, np.sin(0.2), np.cos(0.2)]])
    return np.asarray(tilt @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]))


def rays(size: tuple[int, int]) -> Pixels:
    """(3, H, W): x right, y up, z forward, at length 1 along z, for FOV."""
    height, width = size
    half = np.tan(np.radians(FOV) / 2)
    y, x = np.mgrid[:height, :width] + 0.5
    x, y = (x - width / 2) / (height / 2) * half, -(y - height / 2) / (height / 2) * half
    return np.stack([x, y, np.ones_like(x)])


def looked_at_from_aside(frames: Sequence[dict[str, Pixels]]) -> npt.NDArray[np.float64]:
    """Turn the world of `scene` about the camera, in place; returns the view (4, 4) that still faces the wall."""
    view = np.eye(4)
    view[:3, :3] = rotation(0.7)
    for frame in frames:
        towards = np.where(frame["depth"] > 0, frame["normal"] * np.reshape([1, 1, -1], (3, 1, 1)), 0)
        frame["normal"] = np.einsum("ji,jhw->ihw", view[:3, :3], towards).astype(np.float32)
    return view


def engine(folder: Path, frames: Sequence[dict[str, Pixels]]) -> tuple[Path, Path]:
    """An engine of its own mind: (folder of EXR files, channel map). The frames get other normals.

    Motion in uv, y upwards, from the previous frame; normals in camera space; ray length in centimetres.
    """
    view = looked_at_from_aside(frames)
    half = np.tan(np.radians(FOV) / 2)
    projection = np.array(
        [[0.5 / half * SIZE[0] / SIZE[1], 0, 0.5, 0], [0, -0.5 / half, 0.5, 0], [0, 0, 1.001, -0.1], [0, 0, 1, 0]]
    )
    written = []
    for frame in frames:
        uv = frame["motion"] / np.reshape([SIZE[1], -SIZE[0]], (2, 1, 1))
        ray = frame["depth"] * np.linalg.norm(rays(SIZE), axis=0)
        written.append(
            named("beauty", "rgb", frame["color"])
            | named("clean", "RGB", frame["reference"])
            | named("basecolor", "RGB", frame["albedo"])
            | named("N", "XYZ", np.einsum("ij,jhw->ihw", view[:3, :3], frame["normal"]))
            | {"velocity.V": -uv[1], "velocity.U": -uv[0], "object.ID": frame["instance"][0]}
            | {"distance": np.where(frame["depth"] > 0, 100 * ray, np.inf)[0]}
        )
    (folder / "cameras.json").write_text(
        json.dumps([{"view": view.tolist(), "projection": projection.tolist()}] * len(frames))
    )
    about = {
        "channels": {
            "color": "beauty", "reference": "clean", "albedo": ["basecolor.R", "basecolor.G", "basecolor.B"],
            "normal": "N", "depth": "distance", "instance": "object", "motion": ["velocity.U", "velocity.V"],
        },
        "motion": {"points": "from", "y_axis": "up", "unit": "uv"},
        "normal": {"space": "camera"},
        "depth": {"along": "ray", "scale": 0.01},
        "cameras": "cameras.json",
    }  # fmt: skip
    return write_layers(folder / "engine", written, first=1001), write_map(folder / "map.yaml", about)


def write_map(path: Path, about: object) -> Path:
    path.write_text(yaml.safe_dump(about))
    return path


def blender(folder: Path, frames: Sequence[dict[str, Pixels]], old_names: bool = True) -> Path:
    """Multi-layer EXR as Cycles writes it: 4.5's names of passes, or 5.0's. Every other albedo is a metal's."""
    diffuse, glossy, emission, index = (
        ("DiffCol", "GlossCol", "Emit", "IndexOB")
        if old_names
        else ("Diffuse Color", "Glossy Color", "Emission", "Object Index")
    )
    written = []
    for frame in frames:
        metal = frame["instance"] == 2
        forward = frame["forward_motion"]
        passes = (
            named("Combined", "RGBA", np.concatenate([frame["color"], np.ones_like(frame["depth"])]))
            | named(diffuse, "RGB", np.where(metal, 0, frame["albedo"]))
            | named(glossy, "RGB", np.where(metal, frame["albedo"], 0.04 * (frame["depth"] > 0)))
            | named(emission, "RGB", 0 * frame["albedo"])
            | named("Normal", "XYZ", frame["normal"])
            | {"Depth.Z": np.where(frame["depth"] > 0, frame["depth"], 1e10)[0], f"{index}.X": frame["instance"][0]}
            | named("Vector", "XYZW", np.stack([*frame["motion"], *forward]) * np.reshape([1, -1, -1, 1], (4, 1, 1)))
        )
        written.append({f"View Layer.001.{name}": plane for name, plane in passes.items()})
    return write_layers(folder, written, first=1)


def camera_of(index: int) -> dict[str, npt.NDArray[np.float64]]:
    """A camera that pans and travels; `basis` has right, up and forward in its rows."""
    basis = rotation(0.02 * index)
    return {"position": np.array([0.3, -0.1, 0.2]) * index, "basis": basis}


def noisebase_arrays(
    frames: Sequence[dict[str, Pixels]], rendering: tuple[int, int] = (60, 90), samples: int = 6
) -> list[dict[str, npt.NDArray[np.generic]]]:
    """Frames in noisebase's layout, without the frame axis: crops of a larger rendering, at changing places."""
    height, width = SIZE
    rng = np.random.default_rng(5)
    half = np.tan(np.radians(FOV) / 2)
    projection = np.array(
        [[rendering[0] / rendering[1] / half, 0, 0, 0], [0, 1 / half, 0, 0], [0, 0, 1.0001, -0.1], [0, 0, 1, 0]]
    )  # for column vectors, z forward
    centres = np.mgrid[:height, :width][::-1][..., None] + 0.5  # x, y
    found = []
    for i, frame in enumerate(frames):
        offset, before = (np.array([3 + k, 20 - 2 * k]) for k in (i, max(0, i - 1)))  # y, x

        def world(pixels: Pixels, crop: npt.NDArray[np.int64], index: int, depth: Pixels) -> npt.NDArray[np.float64]:
            x, y = (pixels + crop[::-1].reshape(2, 1, 1, 1)).astype(np.float64)
            x, y = (x / rendering[1] * 2 - 1) * half * rendering[1] / rendering[0], (1 - y / rendering[0] * 2) * half
            camera = camera_of(index)
            rays = np.einsum("ji,jhws->ihws", camera["basis"], np.stack([x, y, np.ones_like(x)]))
            return rays * depth[..., None] + camera["position"].reshape(3, 1, 1, 1)

        depth = frame["depth"]
        seen = centres + rng.uniform(-0.5, 0.5, (2, height, width, samples))
        position = world(seen, offset, i, depth)
        motion = world(seen + frame["motion"][..., None], before, max(0, i - 1), depth) - position
        hit = depth[..., None] > 0
        camera = camera_of(i)
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = camera["basis"], -camera["basis"] @ camera["position"]
        rgbe, exposure = encode_rgbe(np.repeat(frame["color"][..., None], samples, 3))
        found.append(
            {
                "color": rgbe,
                "exposure": exposure,
                "reference": frame["reference"],
                "position": np.where(hit, position, np.inf if i % 2 else 0).astype(np.float32),
                "motion": np.where(hit, motion, 0).astype(np.float32),
                "normal": np.repeat(frame["normal"][..., None], samples, 3).astype(np.float16),
                "diffuse": np.repeat(frame["albedo"][..., None], samples, 3).astype(np.float16),
                "camera_position": camera["position"].astype(np.float32),
                "camera_target": (camera["position"] + 4 * camera["basis"][2]).astype(np.float32),
                "camera_up": camera["basis"][1].astype(np.float32),
                "view_proj_mat": (projection @ view).T.astype(np.float32),
                "proj_mat": projection.astype(np.float32),
                "crop_offset": offset.astype(np.int32),
            }
        )
    return found


def encode_rgbe(color: Pixels) -> tuple[npt.NDArray[np.uint8], Pixels]:
    """The inverse of noisebase's decoding: mantissas rounded, exponents upwards."""
    low, high = np.log(color[color > 0]).min(), np.log(color.max())
    with np.errstate(divide="ignore"):
        place = np.clip((np.log(color.max(0)) - low) / (high - low) * 256, 0, 255).astype(np.uint8)
    scale = np.exp((place + 1.0) / 256 * (high - low) + low)
    return np.concatenate([np.rint(color / scale * 255).astype(np.uint8), place[None]]), np.array([low, high], "f")
