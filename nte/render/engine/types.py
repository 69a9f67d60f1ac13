"""The parts of Mitsuba and Dr.Jit that nte uses, as types.

Mitsuba's classes exist only after a variant is chosen at run time, and types cannot describe the operators of Dr.Jit's
arrays. So arrays of numbers are `Lanes`, which is Any, and a function's docstring says which kind it takes. Classes
with methods are protocols below, with the members that nte uses, so that mypy finds a misspelt one.

A lane is one of the rays, paths or points that a kernel handles side by side. A scalar variant has one lane, and its
numbers are Python's. `active` marks the lanes that count; the others give zeros.
"""

from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any, Protocol, TypeAlias

Lanes: TypeAlias = Any  # numbers, colours, points, directions or pointers, one per lane (mi.Float, mi.Color3f, …)
Struct: TypeAlias = Any  # other values of Mitsuba: flags, transforms, bitmaps, light samples, nodes of a parsed XML
Plugin: TypeAlias = dict[str, Struct]  # a plugin and its nested plugins, as mi.load_dict takes them
Module: TypeAlias = ModuleType  # mitsuba or drjit, whose members are not known to mypy


class Parameters(Protocol):
    """The parameters that mi.traverse returns, by name; changes take effect with `update`."""

    def __getitem__(self, name: str) -> Struct: ...

    def __setitem__(self, name: str, value: Struct) -> None: ...

    def __contains__(self, name: object) -> bool: ...

    def items(self) -> Iterator[tuple[str, Struct]]: ...

    def update(self) -> object: ...


class Named(Protocol):
    """A plugin with a name, which comes from the XML or from nte."""

    def id(self) -> str: ...

    def set_id(self, name: str) -> None: ...

    def class_name(self) -> str: ...


class Shape(Named, Protocol):
    """One shape of a scene, or an instance of a group of them."""

    def is_mesh(self) -> Lanes: ...

    def is_emitter(self) -> bool: ...

    def is_sensor(self) -> bool: ...

    def interior_medium(self) -> object | None: ...

    def exterior_medium(self) -> object | None: ...


class Emitter(Named, Protocol):
    """One light of a scene, or one per lane."""

    def get_shape(self) -> Shape | None: ...

    def set_scene(self, scene: "MitsubaScene") -> None: ...

    def flags(self) -> Lanes: ...

    def eval(self, si: "Interaction", active: Lanes = True) -> Lanes: ...


class Bsdf(Protocol):
    """The material at a surface interaction; directions are local, values are (3,) and include |cos|."""

    def flags(self) -> Lanes: ...

    def eval(self, context: Struct, si: "Interaction", wo: Lanes, active: Lanes = True) -> Lanes: ...

    def pdf(self, context: Struct, si: "Interaction", wo: Lanes, active: Lanes = True) -> Lanes: ...

    def sample(
        self, context: Struct, si: "Interaction", choice: Lanes, direction: Lanes, active: Lanes = True
    ) -> tuple[Struct, Lanes]: ...

    def eval_diffuse_reflectance(self, si: "Interaction", active: Lanes = True) -> Lanes: ...

    def eval_null_transmission(self, si: "Interaction", active: Lanes = True) -> Lanes: ...

    def has_attribute(self, name: str, active: Lanes = True) -> Lanes: ...

    def eval_attribute_1(self, name: str, si: "Interaction", active: Lanes = True) -> Lanes: ...

    def eval_attribute_3(self, name: str, si: "Interaction", active: Lanes = True) -> Lanes: ...


class Ray(Protocol):
    """mi.Ray3f: origin and unit direction, world; calling it with a distance returns the point there."""

    o: Lanes
    d: Lanes
    maxt: Lanes

    def __call__(self, distance: Lanes) -> Lanes: ...


class Frame(Protocol):
    """A local frame; n: its normal, world."""

    n: Lanes


class Interaction(Protocol):
    """mi.SurfaceInteraction3f: where a ray meets a surface."""

    t: Lanes  # distance along the ray
    p: Lanes  # world
    n: Lanes  # geometric normal, world
    wi: Lanes  # direction that the ray came from, in the local frame
    sh_frame: Frame  # of the shading normal
    shape: Shape
    dp_du: Lanes
    dp_dv: Lanes
    dn_du: Lanes
    dn_dv: Lanes

    def is_valid(self) -> Lanes: ...

    def bsdf(self) -> Bsdf: ...

    def emitter(self, scene: "MitsubaScene", active: Lanes = True) -> Emitter: ...

    def to_local(self, direction: Lanes) -> Lanes: ...

    def to_world(self, direction: Lanes) -> Lanes: ...

    def spawn_ray(self, direction: Lanes) -> Ray: ...

    def spawn_ray_to(self, point: Lanes) -> Ray: ...


class Hit(Protocol):
    """mi.PreliminaryIntersection3f: which triangle or solid a ray meets, before anything is interpolated there."""

    t: Lanes
    valid: Lanes
    shape: Shape
    instance: Lanes  # pointer to the instance that contains the shape, 0 if none
    prim_index: Lanes
    prim_uv: Lanes

    def is_valid(self) -> Lanes: ...

    def compute_surface_interaction(self, ray: Ray, flags: Struct = ..., active: Lanes = True) -> Interaction: ...


class Sampler(Protocol):
    """Random numbers in [0, 1), one stream per lane."""

    def seed(self, seed: Lanes, wavefront_size: int) -> None: ...

    def next_1d(self) -> Lanes: ...

    def next_2d(self) -> Lanes: ...

    def clone(self) -> "Sampler": ...

    def set_sample_count(self, count: int) -> None: ...

    def set_samples_per_wavefront(self, count: int) -> None: ...


class Sensor(Named, Protocol):
    """The camera with its film."""

    def sample_ray(self, time: float, wavelength: float, film: Lanes, lens: Lanes) -> tuple[Ray, Lanes]: ...

    def sampler(self) -> Sampler: ...


class Integrator(Protocol):
    """An integrator, which computes the light that arrives along rays."""

    def sample(
        self, scene: "MitsubaScene", sampler: Sampler, ray: Ray, medium: Struct = None, active: Lanes = True
    ) -> tuple[Lanes, Lanes, list[Lanes]]: ...


class MitsubaScene(Protocol):
    """mi.Scene."""

    def shapes(self) -> Sequence[Shape]: ...

    def emitters(self) -> Sequence[Emitter]: ...

    def sensors(self) -> Sequence[Sensor]: ...

    def integrator(self) -> Integrator: ...

    def bbox(self) -> Struct: ...

    def parameters_changed(self, keys: list[str]) -> None: ...

    def ray_intersect(self, ray: Ray, flags: Struct, coherent: bool, active: Lanes = True) -> Interaction: ...

    def ray_intersect_preliminary(self, ray: Ray, coherent: bool, active: Lanes = True) -> Hit: ...

    def ray_test(self, ray: Ray, active: Lanes = True) -> Lanes: ...

    def sample_emitter_direction(
        self, si: Interaction, sample: Lanes, test_visibility: bool, active: Lanes = True
    ) -> tuple[Struct, Lanes]: ...

    def pdf_emitter_direction(self, si: Interaction, sample: Struct, active: Lanes = True) -> Lanes: ...
