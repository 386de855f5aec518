"""From frames of the sensor's own markers to the pose, distance and index of its gel.

The cameras are calibrated in air first. Then gel and plate are put on, and the sensor looks at its own lattice: at
rest, where the pitch is known, and seated on flat boards of known protrusion, under which the markers lie in planes
that are parallel to the rest plane. A bundle adjustment over all pixels gives the layers with their covariance, and
says which combinations of them the frames do not tell.

What the frames tell follows from the information matrix (`LayersCalibration.combinations`). To first order in the
slope of the light, a plate of thickness t and index n acts as t / n of air, and only the lattice's perspective at large
slopes tells the two apart: thickness and index of a plate need priors, as a data sheet gives them. Rest frames alone
leave the gel's index to the same second-order effect; one board fixes it, through the ratio of depth to pitch, and the
highest board does so best, in proportion to its protrusion.

No print is perfect. Every marker has an error of place that all frames at rest share; how large these are is found with
the layers (`gelstereo.calibrate.print_error`), and the pitch is found beside its tolerance. What contradicts the model
all the same is in `LayersCalibration.doubts`.
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

#: Tolerance of the pitch, as a share of it. For a pitch that is off by 0.6 %, tolerances from 0.12 to 2.4 % change no
#: parameter by a tenth of its standard deviation (25 x 25 markers, printed within 8 um): it decides what is doubted.
PITCH_TOLERANCE = 0.005


@dataclass(frozen=True)
class LayersCalibration:
    """The rig with its layers, how well they are known, and what speaks against them.

    Attributes
    ----------
    rig
        With the layers found.
    values, covariance
        Parameters by name, and their (N, N) covariance in that order. ``tilt_x`` and ``tilt_y`` are the slopes of the
        normal, normal.x / normal.z and normal.y / normal.z.
    t_sensor_lattice
        (4, 4) pose of the rest lattice: x along the columns, y along the rows, z away from the cameras.
    pitch_mm, pitch_sigma_mm
        Of the lattice, and its standard deviation.
    print_sigma_mm
        Standard deviation of the markers' places in the rest lattice, along each of its axes.
    rms_px
        Residual per coordinate beside the print's errors; the centres' noise if all is well.
    chi2, degrees_of_freedom
        Sum of squared residuals over the noise that was given and the print's errors, and what it should be, at most.
    combinations
        All independent combinations of the parameters, the least determined first.
    doubts
        What contradicts the model; empty if nothing does. One in a thousand calibrations that follow it has any.
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
    pitch_mm: float,
    pitch_sigma_mm: float | None = None,
    layers: Mapping[str, Any] | None = None,
    priors: Mapping[str, float] | None = None,
    sigma_px: float = 0.03,
    height_sigma_mm: float = 0.002,
) -> LayersCalibration:
    """Find the layers from frames at rest and on boards.

    Parameters
    ----------
    rig
        The cameras, calibrated in air.
    frames
        At least one at rest; boards make the gel's index known.
    pitch_mm, pitch_sigma_mm
        Of the printed lattice as stated, and its standard deviation; half a per cent of it if left out.
    layers
        As designed, in the form of `Rig.layers`: where the search starts, and the middle of every prior; those of the
        rig if left out.
    priors
        Standard deviation of what is known of a parameter beforehand, by its name: ``tilt_x``, ``tilt_y``, ``gap_mm``,
        ``gel_index``, ``plate_0_thickness_mm``, ``plate_0_index`` and so on. 0 holds it fixed.
    sigma_px
        Noise of a centre along each axis.
    height_sigma_mm
        Tolerance of the boards' protrusions.

    Raises
    ------
    UndeterminedLayersError
        Frames and priors together do not determine a combination of the parameters, which is named.
    CalibrationError
        The frames cannot be used, or nothing explains them.
    """
    layers = rig.layers if layers is None else layers
    if layers is None:
        raise CalibrationError("the rig has no layers; give the layers as designed")
    if pitch_sigma_mm is None:
        pitch_sigma_mm = PITCH_TOLERANCE * pitch_mm
    known = Known(dict(priors or {}), pitch_mm, pitch_sigma_mm, height_sigma_mm, sigma_px)
    _check(frames, known)
    model = Model(rig, frames, layers, known)
    start = model.start()
    # Before the search, which without an answer wanders, and after it.
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
    # Where residuals exceed the stated noise, the covariance grows with chi2, but not that of the priors
    # (Birge, "The calculation of errors", 1932).
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


def _refuse_undetermined(combinations: Sequence[Combination]) -> None:
    weak = tuple(c for c in combinations if c.total_sigma > 1.0)
    if weak:
        raise UndeterminedLayersError(
            f"the frames do not determine the layers: {'; '.join(map(str, weak))} (in units of {SCALES}); give a prior "
            "for the largest of these, or frames on boards (the higher the better) and with more of the lattice",
            weak,
        )


def _check(frames: Sequence[SeatedFrame], known: Known) -> None:
    lengths = {
        "pitch_mm": known.pitch_mm,
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
