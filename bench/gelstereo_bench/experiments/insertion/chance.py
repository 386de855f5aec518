"""Go or no-go: the probability that a part goes in, from the belief about its pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo import FreeDirection
from gelstereo.geometry import se3_exp
from gelstereo_bench.experiments.insertion.hole import Hole, InsertedEnd
from gelstereo_bench.experiments.insertion.sense import Found

__all__ = ["SAMPLES", "Prior", "adjoint", "chance", "matters", "object_covariance", "weakest"]

Array = npt.NDArray[np.float64]

#: Number of poses drawn per probability; the standard error at one half is then 0.02.
SAMPLES = 512


@dataclass(frozen=True)
class Prior:
    """Prior of a grasp: standard deviations about the middle of the contact."""

    rotation_rad: float = 0.3
    shift_mm: float = 2.0


def adjoint(pose: Array) -> Array:
    """Adjoint matrix (6, 6) of a pose for twists (ω, v): T exp(ξ) T⁻¹ = exp(Ad ξ)."""
    rotation, (x, y, z) = pose[:3, :3], pose[:3, 3]
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = rotation
    out[3:, :3] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ rotation
    return out


def object_covariance(found: Found, prior: Prior, besides: Array | None = None) -> Array:
    """Covariance of a small motion (ω, v) of the part in its own frame, (6, 6), from sensing and prior.

    Along undetermined directions only the prior contributes. `besides` is additional information, (6, 6),
    sensor frame.
    """
    to_centre: Array = np.eye(4)
    to_centre[:3, 3] = -found.centre_mm
    known = np.diag(np.repeat([prior.rotation_rad**-2.0, prior.shift_mm**-2.0], 3))
    carry = adjoint(to_centre)
    elsewhere = 0.0 if besides is None else besides
    sensor = np.linalg.inv(found.information + carry.T @ known @ carry + elsewhere)
    back = adjoint(np.asarray(np.linalg.inv(found.t_sensor_object)))
    return np.asarray(back @ sensor @ back.T)


def chance(hole: Hole, end: InsertedEnd, drawn: Array) -> float:
    """Probability that a part goes in, 0 to 1: the share of sampled motions (ω, v) over the hole, (S, 6),
    that fit.
    """
    motions = np.stack([np.asarray(se3_exp(twist)) for twist in drawn])
    return float(np.mean(hole.rooms_mm(end, motions) >= 0.0))


def matters(hole: Hole, end: InsertedEnd, free: FreeDirection) -> bool:
    """Whether a small motion along a free direction keeps the part out of its hole."""
    # About the part's origin, in the hole's frame.
    twist = np.concatenate([free.omega, free.v - np.cross(free.omega, free.centre_mm)])
    size = _LITTLE_RAD if np.any(free.omega) else _LITTLE_MM
    motions = np.stack([np.asarray(se3_exp(sign * size * twist)) for sign in (-1.0, 1.0)])
    return bool(np.any(hole.rooms_mm(end, motions) < 0.0))


#: Size of the motion: larger than any clearance, and smaller than the prior's standard deviations.
_LITTLE_RAD, _LITTLE_MM = 0.2, 1.0

#: Motions of a part over its hole, except along its axis, which does not matter.
_MOTIONS = ("lean about x", "lean about y", "spin about z", "slide along x", "slide along y")


def weakest(hole: Hole, end: InsertedEnd, covariance: Array) -> str:
    """Name the motion whose uncertainty reduces the inserted end's clearance most, and its standard
    deviation.

    `covariance` is that of a motion (ω, v) in the hole's frame. Each motion is made by one standard deviation
    in both directions, about the middle of the hole, because the part's origin is far from it. A round part's
    spin does not matter.
    """
    about = np.eye(4)
    about[2, 3] = -0.5 * (hole.tip_mm + hole.mouth_mm)
    carry = adjoint(about)
    sigma = np.sqrt(np.maximum(np.diag(carry @ covariance @ carry.T)[:5], 0.0))
    there = adjoint(np.asarray(np.linalg.inv(about)))
    # Rotations are limited to half a turn.
    twists = np.concatenate(
        [sign * np.minimum(sigma, np.pi) * np.eye(6, 5) for sign in (-1.0, 1.0)], axis=1
    ).T
    rooms = hole.rooms_mm(end, np.stack([np.asarray(se3_exp(there @ twist)) for twist in twists]))
    worst = int(np.argmin(np.min(rooms.reshape(2, 5), axis=0)))
    known = f"{np.rad2deg(sigma[worst]):.1f} deg" if worst < 3 else f"{sigma[worst]:.2f} mm"
    return f"{_MOTIONS[worst]}, known to {known}"
