"""The data that kernels read of an XML scene: shapes of any kind, on two levels where something moves, and any BSDF."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Concatenate

from nte.render.engine.arrays import to_jit
from nte.render.engine.backend import load_drjit, load_mitsuba, undisturbed
from nte.render.engine.keys import key_of, numbers_by_key, shape_key
from nte.render.engine.places import Indices
from nte.render.engine.stage import Arrays, Result, Scenery
from nte.render.engine.types import Emitter, Hit, Interaction, Lanes, Ray
from nte.render.engine.xml.levels import Levels
from nte.render.engine.xml.rest import Rest


@dataclass(eq=False, kw_only=True)
class XmlScenery(Scenery):
    """A Mitsuba scene from an XML file as it is now. Vectorised variants only."""

    places: Rest
    distant_lights: Sequence[str]  # names of the lights that are not shapes
    levels: list[Levels] = field(default_factory=list)  # scenes over the same shapes; the last is the current one

    @cached_property
    def instances(self) -> Indices:
        """Return the table from keys of shapes to instance numbers; instances that move a shape have its number."""
        shapes = list(self.shapes)
        for made in self.levels:
            shapes += made.moving.values()
        number = {name: index + 1 for index, name in enumerate(shape.id() for shape in self.shapes)}
        moved = [number[name] for made in self.levels for name in made.moving]
        return numbers_by_key([key_of(shape) for shape in shapes], [*range(1, 1 + len(self.shapes)), *moved])

    def instance_of(self, emitter: Emitter) -> int:
        """Return the instance number of a light; lights that are not shapes are numbered after the shapes."""
        if emitter.get_shape():
            return super().instance_of(emitter)
        return 1 + len(self.shapes) + self.distant_lights.index(emitter.id())

    def frozen(self, function: Callable[Concatenate[Scenery, Arrays], Result]) -> Callable[Arrays, Result]:
        """Trace the function in every frame: Dr.Jit cannot see all state of every plugin that an XML may name."""
        return undisturbed()(partial(function, self))

    def met(self, hit: Hit, ray: Ray) -> list[Lanes]:
        """Return what a ray meets: its place there, after the key of the shape or of the instance that moves it."""
        mi, dr = load_mitsuba(), load_drjit()
        si = self.places.interaction(hit, ray)
        instance = dr.reinterpret_array(mi.UInt32, hit.instance)
        level = self.levels[-1].still if self.levels else None
        still = dr.opaque(mi.UInt32, 0 if level is None else key_of(level))
        key = dr.select((instance != 0) & (instance != still), instance, shape_key(si.shape))
        return [dr.select(hit.is_valid(), key, 0), *self.places.columns_of(hit, ray, si)]

    def carried(self, hit: Hit) -> Hit:
        """Return a hit of rays that were traced at another time, as if they were traced now.

        Each time has instances of its own, so the hit's instance is replaced by the current one.
        """
        if not self.levels:
            return hit
        mi, dr, here = load_mitsuba(), load_drjit(), [key_of(instance) for instance in self.levels[-1].instances()]
        keys = [key_of(instance) for made in self.levels for instance in made.instances()]
        table = to_jit(mi.UInt32, numbers_by_key(keys, here * len(self.levels)))
        carried: Hit = mi.PreliminaryIntersection3f(hit)
        key = dr.gather(mi.UInt32, table, dr.reinterpret_array(mi.UInt32, hit.instance))
        carried.instance = dr.reinterpret_array(mi.ShapePtr, key)
        return carried

    def albedo(self, si: Interaction, hit: Lanes) -> Lanes:
        """Return the diffuse reflectance (3,); for a metal or glass, the share of light that it reflects or transmits.

        A BSDF without a diffuse lobe is sampled once, in one direction. The weight is the Fresnel reflectance of a
        metal, and 1 where the BSDF reflects or transmits.
        """
        mi, dr, bsdf = load_mitsuba(), load_drjit(), si.bsdf()
        lobes = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.DiffuseTransmission
        other = hit & ~mi.has_flag(bsdf.flags(), lobes)
        context = mi.BSDFContext(mi.TransportMode.Importance)  # radiance would be scaled by η² in glass
        _, weight = bsdf.sample(context, si, 0.5, mi.Point2f(0.5), other)
        return dr.select(other, dr.clip(weight, 0, 1), bsdf.eval_diffuse_reflectance(si, hit))

    def roughness(self, si: Interaction, hit: Lanes) -> Lanes:
        """Return perceptual roughness in [0, 1]: √α if the BSDF has α, 0 for mirrors and clear glass, 1 if diffuse."""
        mi, dr, bsdf = load_mitsuba(), load_drjit(), si.bsdf()
        smooth = hit & ~mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse | mi.BSDFFlags.Glossy)
        found = dr.select(smooth, mi.Float(0), 1)
        # For two values, as brushed metal has, α is their geometric mean.
        for names, power in ((("alpha_u", "alpha_v"), 0.25), (("alpha",), 0.5), (("roughness",), 1.0)):
            known, value = hit, mi.Float(1)
            for name in names:
                known = known & bsdf.has_attribute(name, hit)
                value = value * bsdf.eval_attribute_1(name, si, known)
            found = dr.select(known, value**power, found)
        return found
