"""A BSDF in two parts whose sum is exactly the whole: its diffuse lobe, and all other lobes.

Every BSDF of Mitsuba evaluates its diffuse reflection alone when a type mask asks for it, except `principled`, which
ignores the mask; its diffuse lobe is written out here. Whatever is not the diffuse lobe counts as «others».
"""

from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.types import Interaction, Lanes, Sampler, Struct


def diffuse_albedo(si: Interaction, active: Lanes, *, random: Lanes) -> Lanes:
    """Estimate the albedo (3,) of the diffuse lobe at surface interactions: see Lobes.diffuse_albedo."""
    return Lobes(si, active).diffuse_albedo(random)


class Lobes:
    """The two parts of the BSDF at surface interactions `si`, for the lanes in `active`; directions are local."""

    def __init__(self, si: Interaction, active: Lanes) -> None:
        mi = load_mitsuba()
        self.si, self.active, self.bsdf = si, active, si.bsdf()
        self._whole, self._masked = mi.BSDFContext(), mi.BSDFContext()
        self._masked.type_mask = mi.BSDFFlags.DiffuseReflection.value
        self._principled = active & self.bsdf.has_attribute("metallic", active)
        self._colour, self._roughness = self._principled_diffuse()

    def split(self, wo: Lanes) -> tuple[Lanes, Lanes]:
        """Return (diffuse, others): BSDF times |cos| towards wo, (3,) per steradian each, ≥ 0; delta lobes give 0."""
        dr = load_drjit()
        whole = self.bsdf.eval(self._whole, self.si, wo, self.active)
        diffuse = self.diffuse(wo)
        return diffuse, dr.maximum(whole - diffuse, 0)

    def diffuse(self, wo: Lanes) -> Lanes:
        """Return the diffuse lobe times |cos| towards wo, (3,) per steradian, ≥ 0."""
        dr = load_drjit()
        masked = self.bsdf.eval(self._masked, self.si, wo, self.active & ~self._principled)
        return dr.select(self._principled, self._disney(wo), masked)

    def diffuse_albedo(self, random: Lanes) -> Lanes:
        """Estimate ∫ f_d cos θ dω, (3,), on the side of the surface that si.wi is on; exact for a Lambertian lobe.

        random: two numbers that choose one direction with density cos θ / π. The first is sin² θ, in [0, 1); the second
        is the azimuth, where 1 is a whole turn.
        """
        mi, dr = load_mitsuba(), load_drjit()
        sine, cosine = dr.sqrt(random.x), dr.maximum(dr.sqrt(1 - random.x), 1e-4)
        turn = 2 * dr.pi * random.y
        wo = mi.Vector3f(sine * dr.cos(turn), sine * dr.sin(turn), dr.mulsign(cosine, self.si.wi.z))
        return self.diffuse(wo) * (dr.pi / cosine)

    def pdf(self, wo: Lanes) -> Lanes:
        """Return the density per steradian with which `sample` chooses wo, over all lobes."""
        return self.bsdf.pdf(self._whole, self.si, wo, self.active)

    def sample(self, sampler: Sampler) -> tuple[Struct, Lanes]:
        """Choose one direction as the BSDF does; return (BSDFSample3f, whole BSDF · |cos| / pdf)."""
        chosen, weight = self.bsdf.sample(self._whole, self.si, sampler.next_1d(), sampler.next_2d(), self.active)
        return chosen, weight

    def _principled_diffuse(self) -> tuple[Lanes, Lanes]:
        """Colour and roughness of the diffuse lobe of `principled`; its flat and sheen parts count as «others»."""
        mask, si = self._principled, self.si
        share = 1.0
        for weight in ("metallic", "spec_trans", "flatness"):
            share = share * (1 - self.bsdf.eval_attribute_1(weight, si, mask))
        colour = self.bsdf.eval_attribute_3("base_color", si, mask) * share
        return colour, self.bsdf.eval_attribute_1("roughness", si, mask)

    def _disney(self, wo: Lanes) -> Lanes:
        """Burley's diffuse lobe with retro-reflection (Disney 2015, Eq. 4), as in Mitsuba's principled.cpp."""
        mi, dr = load_mitsuba(), load_drjit()
        wi = self.si.wi
        front = (wi.z > 0) & (wo.z > 0)
        out, into = (dr.clip(1 - z, 0, 1) ** 5 for z in (wo.z, wi.z))
        retro = 2 * self._roughness * dr.square(dr.dot(dr.normalize(wi + wo), wo))
        lobe = (1 - 0.5 * into) * (1 - 0.5 * out) + retro * (out + into + out * into * (retro - 1))
        return dr.select(front, self._colour * (lobe * wo.z * dr.inv_pi), mi.Color3f(0))
