"""Depth, position and normals of one frame must show the same surfaces, and what is nearer hides what is behind it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.checking import CheckReport, check
from nte.checking.geometry import GeometryTally
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.importing.convert import unit
from tests.checking.room import FOCAL, SIZE, Floats, camera, distances, room_frame
from tests.synthetic import Pixels, smooth_texture, write_clip

Change = Callable[[dict[str, Pixels], int], dict[str, Pixels]]
RNG = np.random.default_rng(0)
FRAMES = [room_frame(i) for i in range(4)]
Z_TURNED = np.array([[1.0], [1.0], [-1.0]])  # view space that looks along −z


def checked(folder: Path, change: Change, without: tuple[str, ...] = (), **info: object) -> CheckReport:
    frames = []
    for i, right in enumerate(FRAMES):
        frame = right | {name: np.asarray(values, np.float32) for name, values in change(right, i).items()}
        frames.append({name: values for name, values in frame.items() if name not in without})
    return check(Clip(write_clip(folder / "clip", frames, **info)))


def cameras(change: Callable[[Floats, Floats], tuple[Floats, Floats]]) -> list[dict[str, object]]:
    """The cameras of the room for clip.json, with `change` applied to each view and projection."""
    found: list[dict[str, object]] = []
    for i in range(len(FRAMES)):
        place, axes = camera(i)
        view, projection = np.eye(4), np.zeros((4, 4))
        view[:3, :3], view[:3, 3] = axes, -axes @ place
        projection[[0, 1, 2, 3], [0, 1, 2, 2]] = FOCAL / SIZE[1], -FOCAL / SIZE[0], 1, 1
        projection[:2, 2], projection[2, 3] = 0.5, -0.1
        view, projection = change(view, projection)
        found.append({"view": view.tolist(), "projection": projection.tolist()})
    return found


def sky_at(value: float) -> Change:
    return lambda f, i: {"depth": np.where(f["depth"] > 0, f["depth"], value)}


def inverse(f: dict[str, Pixels], i: int) -> dict[str, Pixels]:
    return {"depth": np.divide(0.1, f["depth"], out=0 * f["depth"], where=f["depth"] > 0)}


def buffer(f: dict[str, Pixels], i: int) -> dict[str, Pixels]:
    """Near plane at 0.1 and far plane at 100; the sky is at the far plane."""
    return {"depth": np.where(f["depth"] > 0, (100 - 10 / np.maximum(f["depth"], 0.1)) / 99.9, 1)}


def in_view(f: dict[str, Pixels], i: int, turned: Pixels | float = 1.0) -> dict[str, Pixels]:
    return {"normal": np.einsum("ij,jhw->ihw", camera(i)[1] * turned, f["normal"])}


@pytest.mark.parametrize(
    "change",
    [
        lambda f, i: {},
        lambda f, i: {"position": f["position"].astype(np.float16)},
        lambda f, i: {n: f[n] * np.reshape([1, 1, -1], (3, 1, 1)) for n in ("position", "normal")},  # left-handed
        lambda f, i: {"normal": unit(f["normal"] + 0.3 * RNG.normal(size=(3, *SIZE)) * (f["depth"] > 0))},
        lambda f, i: {n: f[n] * 1e-3 for n in ("position", "depth")},
    ],
    ids=["right", "half floats", "left-handed", "bumpy", "small units"],
)
def test_nothing_is_said_of_surfaces_that_agree(tmp_path: Path, change: Change) -> None:
    report = checked(tmp_path, change)
    assert report.verdict == "plausible"
    assert [f.found for f in report.findings if not f.found.startswith(("aliased", "noisy"))] == []


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda f, i: {"depth": distances(f)}, "depth: is the distance from the camera, as position shows"),
        (inverse, "depth: is inverse or a z-buffer, as position shows"),
        (buffer, "depth: is inverse or a z-buffer, as position shows"),
        (lambda f, i: {"depth": 100 * f["depth"]}, "depth: is 100 times as long as position shows"),
        (lambda f, i: {"depth": f["depth"][:, ::-1]}, "depth: does not belong to position"),
        (in_view, "normal: not perpendicular to the surfaces of position"),
        (lambda f, i: in_view(f, i, Z_TURNED), "normal: not perpendicular to the surfaces of position"),
        (lambda f, i: {"normal": f["normal"][[0, 2, 1]]}, "normal: not perpendicular to the surfaces of position"),
        (sky_at(1e3), "pixels there is a depth and no normal: 1000 to 1000, beyond all surfaces"),
        (sky_at(1e10), "pixels there is a depth and no normal: 1e+10 to 1e+10, beyond all surfaces"),
    ],
)
def test_what_does_not_agree_fails(tmp_path: Path, change: Change, told: str) -> None:
    report = checked(tmp_path, change)
    assert report.verdict == "implausible"
    assert told in report.reason


def test_a_depth_without_an_instance_beyond_the_others_is_a_doubt(tmp_path: Path) -> None:
    """It may be the sky at a far plane, or a background that was given no id."""
    without = ("normal", "position")
    sky = checked(tmp_path / "sky", sky_at(1e3), without)
    some = checked(tmp_path / "some", lambda f, i: {"instance": f["instance"] * (f["depth"] < 4)}, without)
    for report in (sky, some):
        assert report.verdict == "undecidable"
        assert "there is a depth and no instance" in report.reason


def test_a_wall_alone_says_nothing_of_sides(tmp_path: Path) -> None:
    """Where all points lie in a plane, depth has no gradient across it."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] / 32
    wall = {"position": np.stack([x, y, 4 + x]), "depth": (4 + x)[None], "instance": np.ones((1, *SIZE))}
    wall["normal"] = np.reshape([0.5**0.5, 0, -(0.5**0.5)], (3, 1, 1)) * np.ones((1, *SIZE))
    for name, normal in (("towards", wall["normal"]), ("away", -wall["normal"])):
        frame = {key: np.float32(values) for key, values in (wall | {"normal": normal}).items()}
        report = check(Clip(write_clip(tmp_path / name, [FRAMES[0] | frame] * 2)))
        assert [f.found for f in report.findings if f.channel in ("normal", "depth")] == []


@pytest.mark.parametrize("yaw", [0.0, 0.2, 0.5, 0.9])
def test_a_slanted_wall_alone_is_no_z_buffer(yaw: float) -> None:
    """In a plane one of the three coordinates is a function of the others, up to rounding."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    ray = np.stack([(x - SIZE[1] / 2) / 83, (y - SIZE[0] / 2) / 83, np.ones(SIZE)])
    facing = np.array([-0.459, 0.138, -0.877])
    depth = -5 / np.einsum("i,ihw->hw", facing, ray)
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    world = np.einsum("ij,jhw->ihw", turn, depth * ray) + np.reshape([0.2, 1.6, -5], (3, 1, 1))
    channels = {"depth": depth[None], "position": world}
    tally = GeometryTally()
    tally.add(Frame({name: torch.tensor(np.float32(values))[None] for name, values in channels.items()}))
    assert list(tally.judge()) == []


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.3), (60.0, 20.0, 700.0)])
def test_rods_before_a_facing_wall_have_its_scale(place: tuple[float, float, float]) -> None:
    """All of the wall fits any function exactly; what little stands before it, up to rounding."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    ray = np.stack([(x - SIZE[1] / 2) / 83, (y - SIZE[0] / 2) / 83, np.ones(SIZE)])
    depth = np.where(x % 20 < 1, 2.5 + 0.2 * np.sin(x + y), 4.0)
    channels = {"depth": depth[None], "position": depth * ray + np.reshape(place, (3, 1, 1))}
    tally = GeometryTally()
    tally.add(Frame({name: torch.tensor(np.float32(values))[None] for name, values in channels.items()}))
    assert list(tally.judge()) == []


@pytest.mark.parametrize("without", [(), ("position",)])
def test_cameras_that_are_right_agree_with_surfaces(tmp_path: Path, without: tuple[str, ...]) -> None:
    report = checked(tmp_path, lambda f, i: {}, without, cameras=cameras(lambda v, p: (v, p)))
    assert report.verdict == "plausible"
    assert [f for f in report.findings if f.channel in ("cameras", "normal", "depth")] == []


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda v, p: (np.linalg.inv(v), p), "cameras: do not see position in its own pixels, but"),
        (lambda v, p: (np.diag([1, 1, -1, 1]) @ v, p), "but behind the camera"),
        (lambda v, p: (v, np.diag([1, -1, 1, 1]) @ p), "cameras: do not see position in its own pixels, but"),
        (lambda v, p: (v, p + 0.05 * np.eye(4)[[0]].T @ np.eye(4)[[2]]), "pixels, but 4.8 px beside them"),
    ],
    ids=["camera to world", "looks backwards", "y up", "shifted"],
)
def test_cameras_see_positions_in_their_own_pixels(
    tmp_path: Path, change: Callable[[Floats, Floats], tuple[Floats, Floats]], told: str
) -> None:
    report = checked(tmp_path, lambda f, i: {}, cameras=cameras(change))
    assert report.verdict == "implausible"
    assert told in report.reason


@pytest.mark.parametrize("turned", [1.0, Z_TURNED])
def test_normals_of_another_space_are_told_by_depth_and_cameras(tmp_path: Path, turned: Pixels | float) -> None:
    """V-Ray's normals have z out of the screen; the cameras given with them may look along +z."""
    right = cameras(lambda v, p: (v, p))
    report = checked(tmp_path, lambda f, i: in_view(f, i, turned), ("position",), cameras=right)
    assert "normal: not perpendicular to the surfaces of depth and cameras, but one rotation" in report.reason


def test_positions_without_depth_are_compared_with_normals_and_cameras(tmp_path: Path) -> None:
    matrices = cameras(lambda v, p: (v, p))
    right = checked(tmp_path / "right", lambda f, i: {}, ("depth",), cameras=matrices)
    assert [f for f in right.findings if f.channel in ("cameras", "normal", "position")] == []
    normals = checked(tmp_path / "normals", lambda f, i: in_view(f, 0), ("depth",), cameras=matrices)
    assert "normal: not perpendicular to the surfaces of position, but one rotation" in normals.reason
    inverse = cameras(lambda v, p: (np.linalg.inv(v), p))
    seen_by = checked(tmp_path / "cameras", lambda f, i: {}, ("depth",), cameras=inverse)
    assert "cameras: do not see position in its own pixels" in seen_by.reason


@pytest.mark.parametrize("turned", [360, 240])
def test_a_panorama_has_no_view_axis(tmp_path: Path, turned: float) -> None:
    """It sees points all around, so its depth can only be the distance: of a room like a shoe box, here."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    down, around = np.pi * y / SIZE[0], np.radians(turned) * x / SIZE[1]
    ray = np.stack([np.sin(down) * np.cos(around), np.cos(down), np.sin(down) * np.sin(around)])
    away = np.abs(ray) / np.reshape([3.0, 1.5, 4.0], (3, 1, 1))
    distance = 1 / away.max(0)
    normal = -np.sign(ray) * (np.arange(3).reshape(3, 1, 1) == away.argmax(0))
    channels = {"color": 0 * ray + 1, "normal": normal, "position": distance * ray + 5, "depth": distance[None]}
    frame = {name: values.astype(np.float32) for name, values in channels.items()}
    report = check(Clip(write_clip(tmp_path / "clip", [frame] * 2)))
    assert [f.found for f in report.findings if f.channel in ("depth", "normal", "position")] == []


@pytest.mark.parametrize("without", [(), ("position",)])
def test_normals_that_are_negated_are_a_doubt(tmp_path: Path, without: tuple[str, ...]) -> None:
    """Or all things are seen from behind, as a room from outside."""
    right = cameras(lambda v, p: (v, p))
    report = checked(tmp_path, lambda f, i: {"normal": -f["normal"]}, without, cameras=right)
    assert report.verdict == "undecidable"
    assert "normal: point away from the camera in nearly all pixels" in report.reason


def test_a_surface_that_is_seen_from_behind_is_a_note(tmp_path: Path) -> None:
    report = checked(tmp_path, lambda f, i: {"normal": np.where(f["instance"] == 1, -1, 1) * f["normal"]})
    assert report.verdict == "plausible"
    assert "point away from the camera in most pixels, as position shows" in [f.found for f in report.findings]


def corner(signs: tuple[int, int, int]) -> dict[str, Pixels]:
    """A floor, a back wall and a right wall, with the sign of the normals of each."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    ray = np.stack([(x - 30) / 70, (32 - y) / 70, 0 * x + 1])
    down, right = (np.where(slope > 0, slope, 1e-9) for slope in (-ray[1], ray[0]))
    walls = np.stack([1.5 / down, 6 + 0 * x, 2 / right])
    depth, which = walls.min(0), walls.argmin(0)
    normals = np.multiply([[0, 1, 0], [0, 0, -1], [-1, 0, 0]], np.reshape(signs, (3, 1)))
    channels = {"normal": normals[which].transpose(2, 0, 1), "position": depth * ray, "depth": depth[None]}
    return {name: values.astype(np.float32) for name, values in channels.items()}


@pytest.mark.parametrize("signs", [(1, 1, 1), (1, 1, -1), (-1, 1, 1), (1, -1, -1), (-1, -1, -1)])
def test_walls_whose_normals_point_outwards_are_a_note(tmp_path: Path, signs: tuple[int, int, int]) -> None:
    """The walls of a model may face either way: half a turn would right them, but they do not lie in another space."""
    room = corner(signs)
    report = check(Clip(write_clip(tmp_path / "clip", [{"color": np.ones((3, *SIZE), np.float32), **room}] * 2)))
    found = [(f.found.split(" in ")[0], f.fault) for f in report.findings if f.channel == "normal"]
    assert found == ([("point away from the camera", False)] if min(signs) < 0 else [])


@pytest.mark.parametrize("without", [("position",), ("position", "normal")])
def test_an_inverse_depth_turns_around_what_hides_what(tmp_path: Path, without: tuple[str, ...]) -> None:
    assert checked(tmp_path / "right", lambda f, i: {}, without).verdict == "plausible"
    report = checked(tmp_path / "inverse", inverse, without)
    assert report.verdict == "implausible"
    assert "depth: what hides is farther away than what it hides, in" in report.reason


def pan_frame(index: int, depth: float = 10.0, phase: float = 0.0) -> dict[str, Pixels]:
    """A wall that a camera pans along: nothing is hidden."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    texture = smooth_texture(x - 3 * index, y + index, phase)
    motion = np.reshape([-3.0, 1.0], (2, 1, 1)) * np.ones((1, *SIZE))
    channels = {"color": texture, "albedo": texture, "depth": np.full((1, *SIZE), depth), "motion": motion}
    return {name: values.astype(np.float32) for name, values in channels.items()}


def test_what_comes_from_nowhere_is_no_inverse_depth(tmp_path: Path) -> None:
    """After a cut to a close-up everything is before what was farther, and so is an object that was not there."""
    cut = [pan_frame(i) for i in range(4)] + [pan_frame(i, depth=2.0, phase=2.0) for i in range(4, 8)]
    appears = [pan_frame(i) for i in range(8)]
    for i in range(4, 8):
        appears[i]["depth"][:, 20:40, 20 + 3 * i : 40 + 3 * i] = 3.0
        appears[i]["albedo"][:, 20:40, 20 + 3 * i : 40 + 3 * i] = 0.5
    for name, frames in (("cut", cut), ("appears", appears)):
        report = check(Clip(write_clip(tmp_path / name, frames)))
        assert report.verdict == "plausible", report.reason


def test_a_far_plane_without_normals_is_a_note(tmp_path: Path) -> None:
    report = checked(tmp_path, sky_at(1e4), ("position", "normal", "instance"))
    assert any("of the pixels have exactly the greatest depth, 1e+04" in f.found for f in report.findings)
    assert report.verdict == "plausible"


def test_a_z_buffer_without_position_is_never_plausible(tmp_path: Path) -> None:
    """Here its near plane is so close that rounding hides how planes bend."""
    report = checked(tmp_path, buffer, ("position", "normal", "instance"))
    assert report.verdict == "undecidable"
    assert any("z-buffer" in f.found and f.doubt for f in report.findings)


@pytest.mark.parametrize("count", [lambda z: z, lambda z: z + 5, lambda z: z - 1, lambda z: 100 - z, lambda z: 30 - z])
@pytest.mark.parametrize("jittered", [False, True])
def test_depth_from_another_plane_is_told_with_positions(
    tmp_path: Path, count: Callable[[Pixels], Pixels], jittered: bool
) -> None:
    """It is a linear function of position as well, and only the pixels tell where the camera is."""

    def change(f: dict[str, Pixels], i: int) -> dict[str, Pixels]:
        depth, position = moved_in_its_pixel(f, i) if jittered else (f["depth"], f["position"])
        return {"depth": np.where(f["depth"] > 0, count(depth), 0), "position": position}

    report = checked(tmp_path, change)
    right = count(np.float32(1)) == 1
    assert ("depth: counted from a plane" in report.reason) != right
    assert report.verdict == ("plausible" if right else "implausible")
    assert not [f for f in report.findings if f.channel == "normal"]  # whose side wrong depth cannot tell


def moved_in_its_pixel(f: dict[str, Pixels], i: int) -> tuple[Pixels, Pixels]:
    """Depth and position of a frame, seen up to half a pixel beside the pixels' centres; not at silhouettes."""
    inside = np.abs(np.stack(np.gradient(f["depth"][0]))).max(0) < 0.3
    by = RNG.uniform(-0.5, 0.5, (2, 1, *SIZE)) * inside
    position = f["position"] + (by * np.stack(np.gradient(f["position"], axis=(2, 1)))).sum(0)
    place, axes = camera(i)
    return np.einsum("j,jhw->hw", axes[2], position - place.reshape(3, 1, 1))[None], position
