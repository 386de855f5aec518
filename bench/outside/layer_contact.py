"""Reference for contact detection that knows the gel: pressures of an elastic layer that never pull.

It states how well markers in contact can be told apart at a lattice's pitch. It shares no code and no law
with the core's rules: the layer's response is summed in the Fourier domain (Johnson 1985, section 5.8), and
the pressures follow by non-negative least squares (Lawson and Hanson 1974).
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

Array = npt.NDArray[np.float64]

#: A marker touches if its pressure is more than this share of the second largest. With 0.1, 0.15 and 0.2, the
#: mean F1 is 0.913, 0.910 and 0.901 on gel a, and 0.923, 0.932 and 0.936 on gel c.
SHARE = 0.15
#: Markers under this share of the deepest indentation carry no pressure.
INDENTED = 0.1
#: Samples per pitch, and of the periodic plane along each side.
FINE, SIDE = 8, 1024


@cache
def response(thickness_mm: float, poisson_ratio: float, pitch_mm: float, markers: int) -> Array:
    """Height in mm at all offsets of up to `markers` pitches from a cell of unit pressure (of the shear
    modulus), without friction, on a layer that is bonded to its plate.
    """
    step = pitch_mm / FINE
    wave = 2.0 * np.pi * np.fft.fftfreq(SIDE, step)
    wave_x, wave_y = np.meshgrid(wave, wave)
    length = np.hypot(wave_x, wave_y)
    # Beyond 300 the layer is a half-space to rounding.
    q, kappa = np.minimum(length * thickness_mm, 300.0), 3.0 - 4.0 * poisson_ratio
    share = (2.0 * kappa * np.sinh(2.0 * q) - 4.0 * q) / (
        2.0 * kappa * np.cosh(2.0 * q) + 4.0 * q**2 + 1.0 + kappa**2
    )
    height = (1.0 - poisson_ratio) * share / np.where(length > 0, length, 1.0)
    height[0, 0] = 0.5 * thickness_mm * (1.0 - 2.0 * poisson_ratio) / (1.0 - poisson_ratio)
    over_cell = np.sinc(0.5 * wave_x * pitch_mm / np.pi) * np.sinc(0.5 * wave_y * pitch_mm / np.pi)
    field = np.fft.ifft2(height * over_cell).real * FINE**2
    offsets = FINE * np.arange(1 - markers, markers) % SIDE
    return np.asarray(field[np.ix_(offsets, offsets)])


def touching(
    heights_mm: Array, side: int, pitch_mm: float, thickness_mm: float, poisson_ratio: float
) -> npt.NDArray[np.bool_]:
    """Markers in contact on a square lattice of `side * side` markers, row by row."""
    by_offset = response(thickness_mm, poisson_ratio, pitch_mm, side)
    row, col = np.divmod(np.arange(side * side), side)
    second = np.partition(heights_mm, -2)[-2]
    cells = np.flatnonzero(heights_mm > INDENTED * second)
    far = np.hypot(row[:, None] - row[cells], col[:, None] - col[cells]).min(axis=1) * pitch_mm
    used = np.flatnonzero(far < thickness_mm)
    rows, cols = (index[used][:, None] - index[cells] + side - 1 for index in (row, col))
    pressure, _ = nnls(by_offset[rows, cols], heights_mm[used], maxiter=50 * len(cells))
    found = np.zeros(side * side, dtype=bool)
    if len(cells) > 1:
        found[cells] = pressure > SHARE * np.partition(pressure, -2)[-2]
    return found
