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
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Frame, MarkerState, Params, Rig, geometry, triangulate

from .bundle import Linearised, Solution, minimise
from .errors import CalibrationError, UndeterminedLayersError

__all__ = ["Combination", "LayersCalibration", "SeatedFrame", "calibrate_layers"]

Array = npt.NDArray[np.float64]

#: How well each kind of parameter must be known, at least: a combination of more than this, by its data sheet and the
#: frames together, is undetermined. A wrong index by 0.01 costs 8 um per mm of height.
SCALES = {"tilt": 0.01, "gap_mm": 0.3, "gel_index": 0.01, "thickness_mm": 0.3, "index": 0.05}

#: Steps of the numerical derivatives: their error is its square, 1e-10, and round-off over it, 1e-8 px.
STEP = 1e-5


@dataclass(frozen=True)
class SeatedFrame:
    """Markers of one stereo frame whose height above the rest plane is known.

    Attributes
    ----------
    height_mm
        Protrusion of the board that the gel is seated on, towards the cameras; 0 for a frame at rest.
    rows, cols
        (N,) place of every marker in the lattice.
    left_px, right_px
        (N, 2) their centres.
    """

    height_mm: float
    rows: npt.NDArray[np.int64]
    cols: npt.NDArray[np.int64]
    left_px: Array
    right_px: Array

    @classmethod
    def from_frame(cls, frame: Frame, height_mm: float = 0.0, *, share: float = 0.9) -> SeatedFrame:
        """Markers of a pipeline's frame: at rest all that are seen, on a board those that lie on it.

        On the board are the markers that rise by ``share`` of its 90 % quantile, together with all their neighbours:
        the gel bends beside an edge.
        """
        use = np.asarray(frame.state) == MarkerState.SEEN
        if height_mm > 0.0:
            heights = np.asarray(frame.indentation_mm).reshape(frame.rows, frame.cols)
            top = heights >= share * np.quantile(heights[heights > 0.5 * heights.max()], 0.9)
            inner = np.zeros_like(top)
            inner[1:-1, 1:-1] = np.logical_and.reduce(
                [
                    top[1 + i : top.shape[0] - 1 + i, 1 + j : top.shape[1] - 1 + j]
                    for i in (-1, 0, 1)
                    for j in (-1, 0, 1)
                ]
            )
            use &= inner.ravel()
        rows, cols = np.divmod(np.flatnonzero(use), frame.cols)
        return cls(height_mm, rows, cols, np.asarray(frame.left_px)[use], np.asarray(frame.right_px)[use])


@dataclass(frozen=True)
class Combination:
    """A direction in the layers' parameters and how well the frames alone determine it.

    Attributes
    ----------
    weights
        Share of every parameter, each in units of its scale (`SCALES`); a unit vector.
    sigma
        Standard deviation along it from the frames alone, in the same units: above 1 they do not determine it.
    total_sigma
        That from frames and priors together.
    """

    weights: Mapping[str, float]
    sigma: float
    total_sigma: float

    def __str__(self) -> str:
        parts = [f"{w:+.2f} {name}" for name, w in self.weights.items() if abs(w) > 0.1]
        return f"{' '.join(parts)}: {self.sigma:.2g} from the frames, {self.total_sigma:.2g} with the priors"


@dataclass(frozen=True)
class LayersCalibration:
    """The rig with its layers, and how well they are known.

    Attributes
    ----------
    rig
        With the layers found.
    values, covariance
        Parameters by name, and their (N, N) covariance in that order. ``tilt_x`` and ``tilt_y`` are the slopes of the
        normal, normal.x / normal.z and normal.y / normal.z.
    t_sensor_lattice
        (4, 4) pose of the rest lattice: x along the columns, y along the rows, z away from the cameras.
    rms_px
        Residual per coordinate; the centres' noise if all is well.
    chi2, degrees_of_freedom
        Sum of squared residuals over the noise that was given, and what it should be.
    combinations
        All independent combinations of the parameters, the least determined first.
    """

    rig: Rig
    values: Mapping[str, float]
    covariance: Array
    t_sensor_lattice: Array
    rms_px: float
    chi2: float
    degrees_of_freedom: int
    combinations: tuple[Combination, ...]

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of every parameter."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)), strict=True))

    def summary(self) -> str:
        """The report in plain text."""
        lines = [f"{name} = {value:.5f} +- {self.sigma[name]:.5f}" for name, value in self.values.items()]
        lines.append(f"residual {self.rms_px:.4f} px rms; chi2 {self.chi2:.0f} of {self.degrees_of_freedom}")
        weak = [str(c) for c in self.combinations if c.sigma > 1.0]
        lines.extend(f"left to the priors: {text}" for text in weak)
        return "\n".join(lines)


def calibrate_layers(
    rig: Rig,
    frames: Sequence[SeatedFrame],
    *,
    pitch_mm: float,
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
    pitch_mm
        Of the printed lattice.
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
    model = _Model(rig, frames, layers, pitch_mm, dict(priors or {}), sigma_px, height_sigma_mm)
    start = model.start()
    # Before the search, which without an answer wanders, and after it.
    _refuse_undetermined(model.combinations(model.linearise(*start)))
    solution = minimise(model.linearise, start)
    combinations = model.combinations(solution.linearised)
    _refuse_undetermined(combinations)
    return model.result(solution, combinations)


def _refuse_undetermined(combinations: Sequence[Combination]) -> None:
    weak = tuple(c for c in combinations if c.total_sigma > 1.0)
    if weak:
        raise UndeterminedLayersError(
            f"the frames do not determine the layers: {'; '.join(map(str, weak))} (in units of {SCALES}); give a prior "
            "for the largest of these, or frames on boards (the higher the better) and with more of the lattice",
            weak,
        )


class _Model:
    """Pixels as a function of the layers, the lattice's pose, the boards' heights and the markers on them."""

    def __init__(
        self,
        rig: Rig,
        frames: Sequence[SeatedFrame],
        layers: Mapping[str, Any],
        pitch_mm: float,
        priors: dict[str, float],
        sigma_px: float,
        height_sigma_mm: float,
    ) -> None:
        _check(frames, pitch_mm, sigma_px, height_sigma_mm)
        self.rig, self.pitch_mm, self.sigma_px, self.height_sigma_mm = (
            rig,
            pitch_mm,
            sigma_px,
            height_sigma_mm,
        )
        self.nominal = _parameters(layers)
        unknown = set(priors) - set(self.nominal)
        if unknown:
            raise CalibrationError(f"there is no parameter {sorted(unknown)}; valid are {list(self.nominal)}")
        self.priors = priors
        self.free = [name for name in self.nominal if priors.get(name) != 0.0]
        self.frames = frames
        self.boards = sorted({f.height_mm for f in frames if f.height_mm > 0.0})
        self.board = np.concatenate(
            [
                np.full(len(f.rows), self.boards.index(f.height_mm) if f.height_mm > 0.0 else -1)
                for f in frames
            ]
        )
        self.on_board = self.board >= 0
        self.height = np.concatenate([np.full(len(f.rows), f.height_mm) for f in frames])
        self.lattice = pitch_mm * np.column_stack(
            [np.concatenate([f.cols for f in frames]), np.concatenate([f.rows for f in frames])]
        ).astype(float)
        self.observed = np.column_stack(
            [np.concatenate([f.left_px for f in frames]), np.concatenate([f.right_px for f in frames])]
        )

    def start(self) -> tuple[Array, Array]:
        """Parameters to begin with: the design, the lattice fitted to the rest frames, the markers on their planes."""
        rig = self._rig(np.array([self.nominal[name] for name in self.free]))
        rays = Params().replace({"triangulate.method": "rays"})
        points = triangulate(rig, self.observed[:, :2], self.observed[:, 2:], rays)
        rest = ~self.on_board
        flat = np.column_stack([self.lattice, np.zeros(len(self.lattice))])
        pose = np.asarray(geometry.rigid_fit(flat[rest], points[rest]))
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        shared = np.concatenate(
            [[self.nominal[n] for n in self.free], geometry.se3_log(pose), np.zeros(len(self.boards))]
        )
        return shared, local[self.on_board, :2]

    def linearise(self, shared: Array, local: Array) -> Linearised:
        """Residuals in units of their noise with derivatives by the shared and by each marker's own parameters."""
        layers, pose, offsets = np.split(shared, [len(self.free), len(self.free) + 6])
        rig, motion = self._rig(layers), np.asarray(geometry.se3_exp(pose))
        place = np.column_stack([self.lattice, -self.height])
        place[self.on_board, :2] = local
        place[self.on_board, 2] -= offsets[self.board[self.on_board]]
        points = place @ motion[:3, :3].T + motion[:3, 3]
        residual = self.observed - _pixels(rig, points)
        by_point = np.stack(
            [(_pixels(rig, points + d) - _pixels(rig, points - d)) / (2 * STEP) for d in STEP * np.eye(3)],
            axis=-1,
        )
        columns = []
        for i in range(len(layers)):
            step = STEP * np.eye(len(layers))[i]
            change = _pixels(self._rig(layers + step), points) - _pixels(self._rig(layers - step), points)
            columns.append(change / (2 * STEP))
        for i in range(6):
            step = STEP * np.eye(6)[i]
            ends = [np.asarray(geometry.se3_exp(pose + s)) for s in (step, -step)]
            moved = [place @ end[:3, :3].T + end[:3, 3] for end in ends]
            columns.append(np.einsum("npk,nk->np", by_point, (moved[0] - moved[1]) / (2 * STEP)))
        up = -by_point @ motion[:3, 2]
        columns += [up * (self.board == k)[:, None] for k in range(len(self.boards))]
        own = by_point[self.on_board] @ motion[:3, :2]
        priors = [(self.free.index(n), self.nominal[n], s) for n, s in self.priors.items() if s > 0.0]
        priors += [(len(self.free) + 6 + k, 0.0, self.height_sigma_mm) for k in range(len(self.boards))]
        return Linearised(
            residual / self.sigma_px,
            np.stack(columns, axis=-1) / self.sigma_px,
            own / self.sigma_px,
            self.on_board,
            np.array([(shared[i] - mean) / -sigma for i, mean, sigma in priors]),
            np.array([np.eye(len(shared))[i] / sigma for i, _, sigma in priors]).reshape(-1, len(shared)),
        )

    def combinations(self, linearised: Linearised) -> tuple[Combination, ...]:
        """Eigenvectors of the layers' information, poses and markers left free, the least determined first."""
        count = len(self.free)
        if count == 0:
            return ()
        scale = np.array([_scale(name) for name in self.free])
        rows = linearised.reduced_jacobian()
        data = rows.T @ rows
        known = np.array([self.height_sigma_mm] * len(self.boards))
        data[count + 6 :, count + 6 :] += np.diag(known**-2)
        alone = _marginal(data, count) * np.outer(scale, scale)
        prior = np.diag([_information(self.priors.get(name)) for name in self.free]) * np.outer(scale, scale)
        values, vectors = np.linalg.eigh(alone + prior)
        found = []
        for value, vector in zip(values, vectors.T, strict=True):
            informed = max(float(vector @ alone @ vector), 1e-300)
            weights = dict(zip(self.free, vector.tolist(), strict=True))
            found.append(Combination(weights, informed**-0.5, float(max(value, 1e-300)) ** -0.5))
        return tuple(sorted(found, key=lambda c: -c.total_sigma))

    def result(self, solution: Solution, combinations: tuple[Combination, ...]) -> LayersCalibration:
        """What the search found."""
        count = len(self.free)
        layers, pose = solution.shared[:count], solution.shared[count : count + 6]
        residual = solution.linearised.marker_residual() * self.sigma_px
        return LayersCalibration(
            rig=self._rig(layers),
            values=dict(zip(self.free, layers.tolist(), strict=True)),
            covariance=solution.covariance[:count, :count],
            t_sensor_lattice=np.asarray(geometry.se3_exp(pose)),
            rms_px=float(np.sqrt((residual**2).mean())),
            chi2=solution.chi2,
            degrees_of_freedom=solution.degrees_of_freedom,
            combinations=combinations,
        )

    def _rig(self, layers: Array) -> Rig:
        return self.rig.with_layers(
            _layers({**self.nominal, **dict(zip(self.free, layers.tolist(), strict=True))})
        )


def _pixels(rig: Rig, points_mm: Array) -> Array:
    return np.column_stack(rig.project(points_mm))


def _parameters(layers: Mapping[str, Any]) -> dict[str, float]:
    x, y, z = layers["normal"]
    found = {"tilt_x": x / z, "tilt_y": y / z, "gap_mm": layers["gap_mm"], "gel_index": layers["gel_index"]}
    for i, plate in enumerate(layers["plates"]):
        found[f"plate_{i}_thickness_mm"] = plate["thickness_mm"]
        found[f"plate_{i}_index"] = plate["index"]
    return found


def _layers(parameters: Mapping[str, float]) -> dict[str, Any]:
    normal = np.array([parameters["tilt_x"], parameters["tilt_y"], 1.0])
    plates = range((len(parameters) - 4) // 2)
    return {
        "normal": (normal / np.linalg.norm(normal)).tolist(),
        "gap_mm": parameters["gap_mm"],
        "gel_index": parameters["gel_index"],
        "plates": [
            {"thickness_mm": parameters[f"plate_{i}_thickness_mm"], "index": parameters[f"plate_{i}_index"]}
            for i in plates
        ],
    }


def _scale(name: str) -> float:
    return next(scale for kind, scale in SCALES.items() if name.startswith(kind) or name.endswith(f"_{kind}"))


def _information(sigma: float | None) -> float:
    return sigma**-2 if sigma else 0.0


def _marginal(information: Array, count: int) -> Array:
    """Information of the first parameters with the others left free (Schur's complement)."""
    a, b, c = information[:count, :count], information[:count, count:], information[count:, count:]
    scale = 1.0 / np.sqrt(np.diag(c))
    return np.asarray(
        a - (b * scale) @ np.linalg.pinv(c * np.outer(scale, scale), rcond=1e-13) @ (b * scale).T
    )


def _check(frames: Sequence[SeatedFrame], pitch_mm: float, sigma_px: float, height_sigma_mm: float) -> None:
    lengths = {"pitch_mm": pitch_mm, "sigma_px": sigma_px, "height_sigma_mm": height_sigma_mm}
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
