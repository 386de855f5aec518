"""A linear elastic layer, bonded at its back, under a rigid part without friction.

Compliances are those of a layer of thickness h and Poisson's ratio v (Johnson 1985, section 5.7, by Fourier's
transform), with x = k h and a modulus of 1. Pressures follow from p >= 0, u >= depth by conjugate gradients
(Polonsky and Keer 1999). Contact uses the part's height above the displaced surface, so a marker in contact
lies on the part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft2, rfft2
from scipy.interpolate import RectBivariateSpline

Array = npt.NDArray[np.float64]

# Padding of the domain on every side; periodic copies are then at least one layer thickness away.
PADDING_MM = 6.0
# Iterations of the contact solver, and of the update of the part's height at the displaced surface.
CONTACT_STEPS, UPDATES = 150, 4
# Convergence: rms distance of u from the part over the contact.
REST_MM = 2e-4


@dataclass(frozen=True)
class Layer:
    """Thickness and Poisson's ratio."""

    thickness_mm: float
    poisson_ratio: float

    def compliances(self, k: Array) -> tuple[Array, Array]:
        """Normal displacement, and displacement along the wave, under a unit wave of pressure."""
        v = self.poisson_ratio
        # Beyond this, compliances equal those of a half-space, and cosh would overflow.
        x = np.clip(k * self.thickness_mm, 1e-6, 40.0)
        c = 2.0 * (1.0 - v * v) / np.maximum(k, 1e-6 / self.thickness_mm)
        a = 3.0 - 4.0 * v
        below = a * np.cosh(2 * x) + 2 * x * x + 5.0 - 12.0 * v + 8.0 * v * v
        normal = c * (a * np.sinh(2 * x) - 2 * x) / below
        outward = x * x - 0.5 * (1.0 - 2.0 * v) * a * (np.cosh(2 * x) - 1.0)
        return np.asarray(normal), np.asarray(c * outward / ((1.0 - v) * below))


def pressed(layer: Layer, depth: Array, along_mm: Array) -> tuple[Array, Array, Array]:
    """Displacement towards the cameras and along x and y on a square grid; `depth` is negative beside the
    part.
    """
    n, step = len(along_mm), float(along_mm[1] - along_mm[0])
    size = n + 2 * int(PADDING_MM / step)
    kx, ky = 2 * np.pi * np.fft.rfftfreq(size, step)[None, :], 2 * np.pi * np.fft.fftfreq(size, step)[:, None]
    k = np.hypot(kx, ky)
    normal, outward = layer.compliances(k)
    per_k = outward / np.maximum(k, 1e-12)

    def moved(pressure: Array, law: Array) -> Array:
        return np.asarray(irfft2(rfft2(pressure, (size, size)) * law, (size, size))[:n, :n])

    spline = RectBivariateSpline(along_mm, along_mm, depth, kx=1, ky=1)
    y, x = np.meshgrid(along_mm, along_mm, indexing="ij")
    met, pressure = depth, np.zeros_like(depth)
    for _ in range(UPDATES):
        pressure = contact(lambda p: moved(p, normal), met, pressure)
        right, down = (moved(pressure, -1j * axis * per_k) for axis in (kx, ky))
        inside = np.clip(y + down, along_mm[0], along_mm[-1]), np.clip(x + right, along_mm[0], along_mm[-1])
        met = spline(*inside, grid=False)
    return moved(pressure, normal), right, down


def contact(apply, depth: Array, pressure: Array) -> Array:  # type: ignore[no-untyped-def]
    """The pressures that keep a surface outside a part."""
    if not pressure.any():
        pressure = np.where(depth > 0, np.maximum(depth, 0.0), 0.0)
        pressure *= (pressure * depth).sum() / max((pressure * apply(pressure)).sum(), 1e-30)
    way, last, fresh = np.zeros_like(depth), 1.0, 0.0
    for _ in range(CONTACT_STEPS):
        over = apply(pressure) - depth
        active = pressure > 0
        size = float((over[active] ** 2).sum())
        if np.sqrt(size / max(active.sum(), 1)) < REST_MM and not (~active & (over < -REST_MM)).any():
            break
        way = np.where(active, over + fresh * (size / last) * way, 0.0)
        last = max(size, 1e-30)
        length = float((over * way)[active].sum() / max((way * apply(way)).sum(), 1e-30))
        pressure = np.maximum(np.where(active, pressure - length * way, 0.0), 0.0)
        missed = (pressure == 0) & (over < 0)
        fresh = 0.0 if missed.any() else 1.0
        pressure = np.where(missed, -length * over, pressure)
    return pressure
