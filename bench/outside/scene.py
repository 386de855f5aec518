"""The sensor as a Mitsuba scene: cameras, layers, print, tray, mount and light strips.

Needs Mitsuba 3 and LLVM (`requirements.txt`). Import after `mitsuba.set_variant`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from .optics import Camera, Optics
from .prints import MIDDLE_MM, Skin

Array = npt.NDArray[np.float64]
Node = dict[str, Any]


class Clear(mi.BSDF):
    """A smooth interface of two dielectrics with transmission only, or reflection only.

    `path` selects one of both at random; rendering them separately avoids the noise of that choice.
    """

    def __init__(self, props: mi.Properties) -> None:
        mi.BSDF.__init__(self, props)
        self.eta = props["int_ior"] / props["ext_ior"]
        self.bounces = props.get("bounces", False)
        kind = mi.BSDFFlags.DeltaReflection if self.bounces else mi.BSDFFlags.DeltaTransmission
        self.m_components = [kind | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide]
        self.m_flags = self.m_components[0]

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> tuple[Any, Any]:
        cosine = mi.Frame3f.cos_theta(si.wi)
        share, cosine_across, eta_it, eta_ti = mi.fresnel(cosine, mi.Float(self.eta))
        sampled = dr.zeros(mi.BSDFSample3f)
        sampled.pdf = 1.0
        sampled.sampled_component = mi.UInt32(0)
        sampled.sampled_type = mi.UInt32(+self.m_flags)
        if self.bounces:
            sampled.wo, sampled.eta = mi.reflect(si.wi), 1.0
            return sampled, mi.Spectrum(share) & active
        sampled.wo, sampled.eta = mi.refract(si.wi, cosine_across, eta_ti), eta_it
        # Radiance decreases with the square of the refractive index when light leaves the medium.
        return sampled, mi.Spectrum((1 - share) * dr.square(eta_ti)) & active

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return mi.Spectrum(0.0)

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return mi.Float(0.0)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
        return mi.Spectrum(0.0), mi.Float(0.0)

    def to_string(self) -> str:
        return "Clear[]"


class Sight(mi.SamplingIntegrator):
    """Radiance directly from lights and emitting surfaces, after at most `turns` smooth interfaces."""

    def __init__(self, props: mi.Properties) -> None:
        mi.SamplingIntegrator.__init__(self, props)
        self.turns = props.get("turns", 2)

    def sample(
        self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
    ) -> tuple[Any, Any, list[Any]]:
        ray = mi.Ray3f(ray)
        found, weight, context = mi.Spectrum(0.0), mi.Spectrum(1.0), mi.BSDFContext()
        active = mi.Bool(active)
        for turn in range(self.turns + 1):
            si = scene.ray_intersect(ray, active)
            found += weight * si.emitter(scene).eval(si, active)
            bsdf = si.bsdf(ray)
            active &= si.is_valid() & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta)
            if turn == self.turns:
                break
            sampled, share = bsdf.sample(context, si, mi.Float(0.5), mi.Point2f(0.5), active)
            weight *= share
            ray = si.spawn_ray(si.to_world(sampled.wo))
        return found, mi.Bool(True), []


mi.register_bsdf("clear", Clear)
mi.register_integrator("sight", Sight)


@dataclass(frozen=True)
class Surroundings:
    """Surroundings of the gel. Light strips are in the air, `strip_y_mm` and `strip_x_mm` from the middle."""

    strip_x_mm: float = 13.0
    strip_y_mm: float = 11.2
    strip_z_mm: float = 14.0
    wall: float = 0.06
    ledge: float = 0.25

    def strips(self) -> list[tuple[Array, Array, str]]:
        """Middle, half sizes (mm) and group of every light: rows of chips along x (a) and along y (b)."""
        chips = []
        for k in range(-3, 4):
            for side in (-1, 1):
                along = 2.6 * k
                chips.append(
                    (np.array([along, side * self.strip_y_mm, self.strip_z_mm]), np.array([0.55, 0.3]), "a")
                )
                chips.append(
                    (np.array([side * self.strip_x_mm, along, self.strip_z_mm]), np.array([0.3, 0.55]), "b")
                )
        return chips


def epsilon_mm(height_mm: float) -> float:
    """Offset along the normal that Mitsuba's single precision adds to a ray's origin at this height.

    `Interaction::offset_p` of Mitsuba 3: (1 + largest coordinate) times 1500 ulp / 2. Heights are the largest
    coordinates.
    """
    return (1.0 + abs(height_mm)) * float(np.finfo(np.float32).eps) / 2 * 1500


def rectangle(middle: Array, half: Array, up: bool = False, **extra: Node) -> Node:
    """A rectangle parallel to the layers; its front looks away from the cameras, or `up` to them."""
    t = mi.ScalarTransform4f().translate(middle.tolist()).scale([half[0], half[1], 1.0])
    return {"type": "rectangle", "to_world": t.rotate([1, 0, 0], 180) if up else t, **extra}


def interfaces(optics: Optics, kind: str = "dielectric", **extra: Any) -> Node:
    """Both faces of the acrylic; the second is moved to compensate the ray offset at the first."""
    ends = ((optics.gap_mm, 1.0, optics.plate_index), (optics.back_mm, optics.plate_index, optics.gel_index))
    shapes, shift = {}, 0.0
    for k, (height, before, beyond) in enumerate(ends):
        middle = np.array([*MIDDLE_MM, height + shift])
        # The rectangle's normal points to the cameras: outside is before it.
        bsdf = {"type": kind, "int_ior": beyond, "ext_ior": before, **extra}
        shapes[f"interface_{k}"] = rectangle(middle, np.array([40.0, 40.0]), up=True, bsdf=bsdf)
        shift += epsilon_mm(height)
    return shapes


def lost_mm(optics: Optics) -> float:
    """Total ray offset on the path to the print."""
    return epsilon_mm(optics.gap_mm) + epsilon_mm(optics.back_mm)


def lights(around: Surroundings, levels: dict[str, float]) -> Node:
    """Light chips that face the layers, of radiance `levels[group]`."""
    return {
        f"chip_{k}": rectangle(
            middle + np.array([*MIDDLE_MM, 0.0]), half, emitter={"type": "area", "radiance": levels[group]}
        )
        for k, (middle, half, group) in enumerate(around.strips())
    }


@dataclass(frozen=True)
class Ring:
    """A square ring around the print, parallel to the layers; inner and outer are half sides."""

    front_mm: float
    depth_mm: float
    inner_mm: float
    outer_mm: float
    reflectance: float

    def sides(self) -> list[tuple[Array, Array]]:
        """Middle (from the print's, x and y) and half sides of the ring's four bars."""
        middle, half = 0.5 * (self.inner_mm + self.outer_mm), 0.5 * (self.outer_mm - self.inner_mm)
        long, short = np.array([half, self.outer_mm]), np.array([self.inner_mm, half])
        return [
            (np.array([middle, 0.0]), long),
            (np.array([-middle, 0.0]), long),
            (np.array([0.0, middle]), short),
            (np.array([0.0, -middle]), short),
        ]


def rings(optics: Optics, around: Surroundings, half_mm: float) -> dict[str, Ring]:
    """Walls around the gel, a brighter ledge outside them, and a mount with a window in front of
    the acrylic.
    """
    rim = half_mm + 1.0
    return {
        "wall": Ring(optics.back_mm + 0.01, optics.thickness_mm + 1.0, half_mm + 0.15, rim, around.wall),
        "ledge": Ring(optics.back_mm + 1.4, 0.4, rim, 16.0, around.ledge),
        "mount": Ring(optics.gap_mm - 4.5, 1.0, half_mm + 3.6, 16.0, 0.04),
    }


def tray(parts: dict[str, Ring]) -> Node:
    """The rings as blocks."""
    shapes: Node = {}
    for name, ring in parts.items():
        bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": ring.reflectance}}
        depth = 0.5 * ring.depth_mm
        for k, (middle, half) in enumerate(ring.sides()):
            place = mi.ScalarTransform4f().translate([*(middle + MIDDLE_MM), ring.front_mm + depth])
            shapes[f"{name}_{k}"] = {"type": "cube", "to_world": place.scale([*half, depth]), "bsdf": bsdf}
    return shapes


def glowing(parts: dict[str, Ring], irradiances: dict[str, Array], reach_mm: float) -> Node:
    """The rings' fronts, with radiance from their irradiance. Maps are square, rows along y, `reach_mm` in
    each direction.
    """
    shapes: Node = {}
    for name, ring in parts.items():
        image = irradiances[name] * ring.reflectance / np.pi
        scale = len(image) / (2 * reach_mm)
        for k, (middle, half) in enumerate(ring.sides()):
            (left, top), (right, bottom) = (
                np.rint((middle + side * half + reach_mm) * scale) for side in (-1, 1)
            )
            cut = image[int(top) : max(int(bottom), int(top) + 1), int(left) : max(int(right), int(left) + 1)]
            texture = mi.Bitmap(np.ascontiguousarray(cut[..., None], dtype=np.float32))
            radiance = {"type": "bitmap", "bitmap": texture, "raw": True, "wrap_mode": "clamp"}
            at = np.array([*(middle + MIDDLE_MM), ring.front_mm])
            # Scaled by -1 along y instead of rotated, so that the texture's rows stay along y.
            place = mi.ScalarTransform4f().translate(at.tolist()).scale([*half, -1.0])
            shapes[f"{name}_front_{k}"] = {
                "type": "rectangle",
                "to_world": place,
                "flip_normals": False,
                "emitter": {"type": "area", "radiance": radiance},
            }
    return shapes


def skin(surface: Skin, optics: Optics, texture: Array | None, reflectance: float = 0.0) -> Any:
    """The print: emitting `texture` (rows along y), or diffuse white for light reflected by it."""
    props = mi.Properties()
    if texture is not None:
        image = np.ascontiguousarray(texture[..., None], dtype=np.float32)
        radiance = {"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True, "wrap_mode": "clamp"}
        props["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
    props["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": reflectance})
    vertices = surface.vertices_mm.reshape(-1, 3) + np.array([0.0, 0.0, lost_mm(optics)])
    n = len(surface.vertices_mm)
    triangles = surface.triangles()
    mesh = mi.Mesh(
        "skin", n * n, len(triangles), has_vertex_normals=False, has_vertex_texcoords=True, props=props
    )
    unit = np.linspace(0.0, 1.0, n)
    v, u = np.meshgrid(unit, unit, indexing="ij")
    changed = mi.traverse(mesh)
    changed["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
    changed["faces"] = mi.UInt32(triangles.ravel())
    changed["vertex_texcoords"] = mi.Float(np.stack((u, v), axis=-1).astype(np.float32).ravel())
    changed.update()
    return mesh


def sensor(camera: Camera, focus_mm: float, samples: int, shrink: int = 1) -> Node:
    """A thin lens. Mitsuba's has no principal point, so the film is wider and the image is
    cropped from it.
    """
    (width, height), (cx, cy) = camera.size_px, camera.c_px
    # Continuous coordinates of the axis are half a pixel more than those of pixel centres.
    left, right, top, bottom = cx + 0.5, width - cx - 0.5, cy + 0.5, height - cy - 0.5
    half_width, half_height = max(left, right), max(top, bottom)
    whole_px = (round(2 * half_width) // shrink, round(2 * half_height) // shrink)
    to_world = np.eye(4)
    # Mitsuba's x axis points to the left of the image and its y axis up.
    to_world[:3, :3] = camera.rotation @ np.diag([-1.0, -1.0, 1.0])
    to_world[:3, 3] = camera.centre_mm
    return {
        "type": "thinlens",
        "fov": float(np.degrees(2 * np.arctan(half_width / camera.f_px))),
        "fov_axis": "x",
        "aperture_radius": camera.aperture_mm,
        "focus_distance": focus_mm,
        "near_clip": 0.1,
        "far_clip": 200.0,
        "to_world": mi.ScalarTransform4f(to_world),
        "film": {
            "type": "hdrfilm",
            "width": whole_px[0],
            "height": whole_px[1],
            "crop_width": width // shrink,
            "crop_height": height // shrink,
            "crop_offset_x": round(half_width - left) // shrink,
            "crop_offset_y": round(half_height - top) // shrink,
            "pixel_format": "luminance",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "multijitter", "sample_count": samples},
    }
