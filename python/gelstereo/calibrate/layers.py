"""Calibration of the refractive layers: pose, distance and index of the gel, from frames of the sensor's own
markers.

First calibrate the cameras in air. Then mount gel and plate, and take frames of the lattice: at rest, where
the pitch is known, and pressed onto flat boards of known protrusion. Markers on a board lie in a plane
parallel to the rest plane. A bundle adjustment over all pixels estimates the layers with their covariance,
and reports which combinations the frames do not determine.

The information matrix shows what the frames determine (`LayersCalibration.combinations`). To first order in
the slope of the rays, a plate of thickness t and index n is equivalent to t / n of air. Only the lattice's
perspective at large slopes separates the two, so thickness and index of a plate need priors, for example from
a data sheet. The same holds for the gel's index with rest frames alone. One board determines it through the
ratio of depth to pitch; accuracy grows in proportion to the protrusion.

Prints are imperfect. Every marker has a position error that is the same in all rest frames. The standard
deviation of these errors is estimated with the layers (`gelstereo.calibrate.print_error`), and so is the
pitch, with its tolerance as the prior. Remaining contradictions to the model are listed in
`LayersCalibration.doubts`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Rig, geometry

from .bundle import Solution
from .doubts import Doubt, doubts_of
from .errors import CalibrationError, UndeterminedLayersError
from .layers_model import SCALES, Combination, Known, Model, SeatedFrame

__all__ = ["Combination", "Doubt", "LayersCalibration", "SeatedFrame", "calibrate_layers"]

Array = npt.NDArray[np.float64]

#: Relative tolerance of the pitch. For a pitch that is off by 0.6 %, tolerances from 0.12 to 2.4 % change no
#: parameter by more than a tenth of its standard deviation (25 x 25 markers, printed within 8 um). The
#: tolerance only decides which pitch is reported as a doubt.
PITCH_TOLERANCE = 0.005


@dataclass(frozen=True)
class LayersCalibration:
    """The calibrated rig with its layers, their uncertainty, and doubts about them.

    Attributes
    ----------
    rig
        The rig with the estimated layers.
    values, covariance
        Estimates by parameter name, and their (N, N) covariance in the same order. ``tilt_x`` and ``tilt_y``
        are the slopes of the normal, normal.x / normal.z and normal.y / normal.z.
    t_sensor_lattice
        (4, 4) pose of the rest lattice: x along the columns, y along the rows, z away from the cameras.
    pitch_mm, pitch_sigma_mm
        Pitch of the lattice along its rows, and its standard deviation. A rectangular lattice keeps the
        stated ratio of its pitches.
    print_sigma_mm
        Standard deviation of the printed marker positions, along each lattice axis.
    rms_px
        Residual per coordinate without the print's errors; equals the centres' noise if the model holds.
    chi2, degrees_of_freedom
        Sum of squared residuals, divided by the variance of the given noise and of the print's errors; and
        its upper expected value.
    combinations
        All independent combinations of the parameters, the least certain first.
    doubts
        Contradictions to the model; empty if there are none. The false-alarm rate is one in a thousand
        calibrations.
    """

    rig: Rig
    values: Mapping[str, float]
    covariance: Array
    t_sensor_lattice: Array
    pitch_mm: float
    pitch_sigma_mm: float
    print_sigma_mm: float
    rms_px: float
    chi2: float
    degrees_of_freedom: int
    combinations: tuple[Combination, ...]
    doubts: tuple[Doubt, ...]

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of every parameter."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)), strict=True))

    def summary(self) -> str:
        """The report in plain text."""
        lines = [f"{name} = {value:.5f} +- {self.sigma[name]:.5f}" for name, value in self.values.items()]
        lines.append(f"pitch_mm = {self.pitch_mm:.5f} +- {self.pitch_sigma_mm:.5f}")
        lines.append(
            f"markers are printed within {1e3 * self.print_sigma_mm:.1f} um of their places (one sigma)"
        )
        lines.append(f"residual {self.rms_px:.4f} px rms; chi2 {self.chi2:.0f} of {self.degrees_of_freedom}")
        weak = [str(c) for c in self.combinations if c.sigma > 1.0]
        lines.extend(f"left to the priors: {text}" for text in weak)
        lines.extend(f"doubtful, {doubt}" for doubt in self.doubts)
        return "\n".join(lines)


def calibrate_layers(
    rig: Rig,
    frames: Sequence[SeatedFrame],
    *,
    pitch_mm: float | Sequence[float],
    pitch_sigma_mm: float | None = None,
    layers: Mapping[str, Any] | None = None,
    priors: Mapping[str, float] | None = None,
    sigma_px: float = 0.03,
    height_sigma_mm: float = 0.002,
) -> LayersCalibration:
    """Estimate the layers from frames at rest and on boards.

    Parameters
    ----------
    rig
        The cameras, calibrated in air.
    frames
        At least one frame at rest. Frames on boards are needed to determine the gel's index.
    pitch_mm, pitch_sigma_mm
        Stated pitch of the printed lattice, two of a rectangular one: along its rows, and along its columns.
        Standard deviation of the first. Default: half a per cent of the pitch.
    layers
        Design values in the form of `Rig.layers`: initial guess and mean of the priors. Default: the rig's
        layers.
    priors
        Prior standard deviation of parameters by name: ``tilt_x``, ``tilt_y``, ``gap_mm``, ``gel_index``,
        ``plate_0_thickness_mm``, ``plate_0_index`` and so on. 0 holds it fixed.
    sigma_px
        Noise of a centre along each axis.
    height_sigma_mm
        Tolerance of the boards' protrusions.

    Raises
    ------
    UndeterminedLayersError
        Frames and priors together do not determine a combination of the parameters. The message names it.
    CalibrationError
        The frames cannot be used, or no layers explain them.
    """
    layers = rig.layers if layers is None else layers
    if layers is None:
        raise CalibrationError("the rig has no layers; pass the design values as `layers`")
    x_mm, y_mm = _axes(pitch_mm)
    if pitch_sigma_mm is None:
        pitch_sigma_mm = PITCH_TOLERANCE * x_mm
    known = Known(dict(priors or {}), x_mm, pitch_sigma_mm, height_sigma_mm, sigma_px, y_mm / x_mm)
    _check(frames, known)
    model = Model(rig, frames, layers, known)
    start = model.start()
    # Checked before the search, which would diverge for an undetermined problem, and after it.
    _refuse_undetermined(model.combinations(model.linearise(0.0)(*start)))
    solution, print_sigma_mm = model.solve(start)
    combinations = model.combinations(solution.linearised)
    _refuse_undetermined(combinations)
    return _result(model, solution, print_sigma_mm, combinations)


def _result(
    model: Model, solution: Solution, print_sigma_mm: float, combinations: tuple[Combination, ...]
) -> LayersCalibration:
    count = len(model.free)
    chi2 = solution.chi2 + model.scatter_chi2
    degrees = solution.degrees_of_freedom + model.scatter_degrees
    # Where residuals exceed the stated noise, the covariance is scaled by chi2 per degree of freedom; that of
    # the priors is not (Birge, "The calculation of errors", 1932).
    covariance = solution.linearised.covariance(max(chi2 / max(degrees, 1), 1.0) ** 0.5)
    residual = solution.linearised.marker_residual()
    squares = (residual @ residual + model.scatter_chi2) / (len(residual) + model.scatter_degrees)
    return LayersCalibration(
        rig=model.rig_with(solution.shared[:count]),
        values=dict(zip(model.free, solution.shared[:count].tolist(), strict=True)),
        covariance=covariance[:count, :count],
        t_sensor_lattice=np.asarray(geometry.se3_exp(solution.shared[count : count + 6])),
        pitch_mm=float(solution.shared[-1]),
        pitch_sigma_mm=float(np.sqrt(covariance[-1, -1])),
        print_sigma_mm=print_sigma_mm,
        rms_px=model.known.centre_sigma_px * float(np.sqrt(squares)),
        chi2=chi2,
        degrees_of_freedom=degrees,
        combinations=combinations,
        doubts=doubts_of(model, solution, print_sigma_mm),
    )


def _axes(pitch_mm: float | Sequence[float]) -> tuple[float, float]:
    """Pitch along rows and along columns."""
    axes = (
        np.broadcast_to(np.asarray(pitch_mm, float), (2,)) if np.size(pitch_mm) in (1, 2) else np.array([0])
    )
    if not (np.isfinite(axes) & (axes > 0.0)).all():
        raise CalibrationError(
            f"pitch_mm is {pitch_mm}; valid is a finite number above 0, or two, along rows and along columns"
        )
    return float(axes[0]), float(axes[-1])


def _refuse_undetermined(combinations: Sequence[Combination]) -> None:
    weak = tuple(c for c in combinations if c.total_sigma > 1.0)
    if weak:
        raise UndeterminedLayersError(
            f"the frames do not determine the layers: {'; '.join(map(str, weak))} (in units of {SCALES}); "
            "give a prior for the largest of these, or frames on boards (the higher the better) and with "
            "more of the lattice",
            weak,
        )


def _check(frames: Sequence[SeatedFrame], known: Known) -> None:
    lengths = {
        "pitch_sigma_mm": known.pitch_sigma_mm,
        "sigma_px": known.centre_sigma_px,
        "height_sigma_mm": known.height_sigma_mm,
    }
    for name, value in lengths.items():
        if not (value > 0.0 and np.isfinite(value)):
            raise CalibrationError(f"{name} is {value}; valid is a finite number above 0")
    for i, f in enumerate(frames):
        count = len(f.rows)
        if not (len(f.cols) == len(f.left_px) == len(f.right_px) == count):
            raise CalibrationError(
                f"frame {i} has lists of different lengths; every marker is one entry in each"
            )
        if not (f.height_mm >= 0.0 and np.isfinite(f.height_mm)):
            raise CalibrationError(
                f"frame {i} is at {f.height_mm} mm; valid is 0 at rest and above 0 on a board"
            )
        if not (np.isfinite(f.left_px).all() and np.isfinite(f.right_px).all()):
            raise CalibrationError(f"frame {i} has a centre that is NaN or infinite; leave such markers out")
    if sum(len(f.rows) for f in frames if f.height_mm == 0.0) < 12:
        raise CalibrationError(
            "fewer than 12 markers are seen at rest; valid is at least one frame of the whole lattice"
        )
