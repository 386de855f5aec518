"""The skin over a print that lies below it, under the pressure of a contact.

`gelstereo.skin_over` takes the gel between print and skin to keep its volume, and its area to be the
print's. Both are approximations. A gel with a Poisson's ratio below 0.5 is compressed where the part presses,
and the skin, held by the part, is stretched less than the print. The pressure is estimated from the motion of
the same markers, so that both can be allowed for:

    distance = depth * J / (w a + (1 - w) b),    w = (1/2 - z/3) / (1 - z),    z = depth / thickness

J is the volume over that at rest, a and b are the area ratios of print and skin. w weights them so that the
mean over the gel between them is met if it moves sideways by a parabola over the thickness, as an
incompressible layer does that is held on both sides. J is where a neo-Hookean gel under this pressure, which
is stretched evenly by this area, is in equilibrium.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from gelstereo._native import ForceEstimator, Params, RestSurface, skin_over

__all__ = ["PressedSkin", "pressed_skin"]

Array = npt.NDArray[np.float64]
Layout = Literal["square", "hexagonal"]

#: Newton steps for the volume, at most 0.5 in its logarithm: enough for -1 to 10 moduli, to rounding.
_STEPS = 12
#: The skin's area follows from the skin. Two rounds are within 0.5 um of ten on bench/outside, half w.
_ROUNDS = 2


def pressed_skin(
    rest: RestSurface,
    points_mm: npt.ArrayLike,
    covariance_mm2: npt.ArrayLike,
    pressure_over_young: npt.ArrayLike,
    *,
    cols: int,
    depth_mm: float,
    thickness_mm: float,
    poisson_ratio: float,
    depth_sigma_mm: float = 0.0,
    layout: Layout = "square",
) -> tuple[Array, Array]:
    """Skin over markers that lie so deep below it, under a known pressure.

    Parameters
    ----------
    rest : RestSurface
        Of the markers, row by row.
    points_mm : (N, 3) array_like
        The same markers now, sensor frame.
    covariance_mm2 : (N, 3, 3) array_like
    pressure_over_young : (N,) array_like
        Pressure on the gel around each marker, over Young's modulus.
    cols : int
        Markers in a row.
    depth_mm, depth_sigma_mm : float
        Depth of the print below the skin, and its standard deviation.
    thickness_mm : float
        Of the gel, from its plate to the skin.
    poisson_ratio : float
    layout : {"square", "hexagonal"}

    Returns
    -------
    points_mm : (N, 3) float64
    covariance_mm2 : (N, 3, 3) float64
        Those of `gelstereo.skin_over`.

    Raises
    ------
    ContactError
        If the number of markers differs or a coordinate is not finite.
    ValueError
        If another argument is not valid.
    """
    markers = np.asarray(points_mm, np.float64)
    pressure = np.asarray(pressure_over_young, np.float64)
    if not 0.0 <= depth_mm < thickness_mm:
        raise ValueError(f"depth_mm is {depth_mm}; valid is 0 to below the thickness, {thickness_mm} mm")
    if not 0.0 <= poisson_ratio <= 0.5:
        raise ValueError(f"poisson_ratio is {poisson_ratio}; valid is 0 to 0.5")
    skin, covariance = skin_over(
        rest,
        markers,
        covariance_mm2,
        cols=cols,
        depth_mm=depth_mm,
        depth_sigma_mm=depth_sigma_mm,
        layout=layout,
    )
    if pressure.shape != (len(markers),) or not np.isfinite(pressure).all():
        raise ValueError(
            f"pressure_over_young has shape {pressure.shape}; valid is one finite number for each of "
            f"{len(markers)} markers"
        )
    if depth_mm == 0.0:
        return np.asarray(skin), np.asarray(covariance)
    share = depth_mm / thickness_mm
    weight = (0.5 - share / 3.0) / (1.0 - share)
    skin_rest = _below(rest, depth_mm)
    away = np.asarray(skin) - markers
    lengths = np.linalg.norm(away, axis=1)
    toward, of_print = away / lengths[:, None], depth_mm / lengths
    for _ in range(_ROUNDS):
        area = weight * of_print + (1.0 - weight) * _area_ratio(skin_rest, skin, cols, layout)
        distance = depth_mm * _volume(pressure, area, poisson_ratio) / area
        skin = markers + distance[:, None] * toward
    return np.asarray(skin), np.asarray(covariance)


class PressedSkin:
    """The skin over a print, with the pressure that its own motion shows.

    Estimates the forces on the skin of `gelstereo.skin_over`, and gives the skin of `pressed_skin` under
    them. Points are those of the print: of a `Pipeline` whose `lattice.depth_mm` is 0.

    Parameters
    ----------
    rest : RestSurface
        Of the markers, row by row.
    params : Params
        `lattice.depth_mm`, `lattice.depth_sigma_mm` and `lattice.layout`, and `force` as for
        `gelstereo.ForceEstimator`, with the method ``ridge`` or ``bounded``.
    cols : int
        Markers in a row.
    covariance_mm2 : (N, 3, 3) array_like
        Of the markers at rest.

    Raises
    ------
    ValueError
        If the method is another one, or the depth is not below the thickness.
    ForceError, ParamsError
        As `gelstereo.ForceEstimator`.
    """

    def __init__(
        self, rest: RestSurface, params: Params, *, cols: int, covariance_mm2: npt.ArrayLike
    ) -> None:
        settings = params.to_dict()
        force, lattice = settings["force"], settings["lattice"]
        if force["method"] not in ("ridge", "bounded"):
            raise ValueError(f'force.method is "{force["method"]}"; valid are "ridge" and "bounded"')
        self._rest, self._cols = rest, cols
        self._depth_mm, self._depth_sigma_mm = lattice["depth_mm"], lattice["depth_sigma_mm"]
        self._layout: Layout = lattice["layout"]
        self._force = ForceEstimator(
            _below(rest, self._depth_mm), params, cols=cols, covariance_mm2=covariance_mm2
        )
        self._young_kpa, self._ratio = force["young_kpa"], force["poisson_ratio"]
        self._thickness_mm = force["thickness_mm"]
        if self._depth_mm >= self._thickness_mm:
            raise ValueError(
                f"lattice.depth_mm is {self._depth_mm}; valid is below force.thickness_mm, "
                f"{self._thickness_mm} mm"
            )

    def run(
        self, points_mm: npt.ArrayLike, covariance_mm2: npt.ArrayLike, patch: npt.ArrayLike
    ) -> tuple[Array, Array]:
        """The skin over the markers of one frame.

        Parameters
        ----------
        points_mm : (N, 3) array_like
            Of the print, sensor frame.
        covariance_mm2 : (N, 3, 3) array_like
        patch : (N,) array_like of bool
            Whether the part touches the gel over each marker, as `Frame.patch`.

        Returns
        -------
        points_mm : (N, 3) float64
        covariance_mm2 : (N, 3, 3) float64
        """
        law: dict[str, float] = {"depth_mm": self._depth_mm, "depth_sigma_mm": self._depth_sigma_mm}
        skin, _ = skin_over(
            self._rest, points_mm, covariance_mm2, cols=self._cols, layout=self._layout, **law
        )
        # With the markers' covariances: those of the skin include the law's error, which blurs pressures.
        touching = [bool(each) for each in np.asarray(patch)]
        traction_kpa, _ = self._force.run(skin, covariance_mm2, touching)
        pressure = np.asarray(traction_kpa) @ np.asarray(self._rest.normal) / self._young_kpa
        return pressed_skin(
            self._rest,
            points_mm,
            covariance_mm2,
            pressure,
            cols=self._cols,
            thickness_mm=self._thickness_mm,
            poisson_ratio=self._ratio,
            layout=self._layout,
            **law,
        )


def _below(rest: RestSurface, depth_mm: float) -> RestSurface:
    """The skin at rest; the normal leads to the cameras."""
    return RestSurface(np.asarray(rest.points_mm) - depth_mm * np.asarray(rest.normal))


def _area_ratio(rest: RestSurface, points_mm: npt.ArrayLike, cols: int, layout: Layout) -> Array:
    """Area of the cell around each point, over that at rest."""
    nothing = np.zeros((len(rest.points_mm), 3, 3))
    over, _ = skin_over(rest, points_mm, nothing, cols=cols, depth_mm=1.0, layout=layout)
    return np.asarray(1.0 / np.linalg.norm(np.asarray(over) - np.asarray(points_mm), axis=1))


def _volume(pressure: Array, area: Array, poisson_ratio: float) -> Array:
    """Volume over that at rest under a pressure over Young's modulus, by the area ratio.

    The energy is that of bench/outside/fem.py: shear / 2 (I - 3) + bulk / 4 (J^2 - 1 - 2 ln J), with I of the
    stretches at constant volume. The stress across the layer is minus the pressure. It rises with the
    volume's logarithm, so that Newton's method finds it.
    """
    over_bulk, shear = 3.0 * (1.0 - 2.0 * poisson_ratio), 0.5 / (1.0 + poisson_ratio)
    log = np.zeros_like(area)
    for _ in range(_STEPS):
        along, across = np.exp(log / 3.0) / area**2, area * np.exp(-5.0 * log / 3.0)
        stress = np.sinh(log) + over_bulk * (shear * (along - across) * 2.0 / 3.0 + pressure)
        slope = np.cosh(log) + over_bulk * shear * (along + 5.0 * across) * 2.0 / 9.0
        log = log - np.clip(stress / slope, -0.5, 0.5)
    return np.asarray(np.exp(log))
