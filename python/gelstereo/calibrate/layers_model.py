"""Pixels of the sensor's own markers as a function of its layers, for `gelstereo.calibrate.layers`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Frame, MarkerState, Params, Rig, geometry, triangulate

from .bundle import Linearised, Solution, minimise
from .errors import CalibrationError
from .print_error import print_variance

__all__ = ["SCALES", "Combination", "Model", "SeatedFrame"]

Array = npt.NDArray[np.float64]

#: Largest acceptable standard deviation of each kind of parameter. A combination with more than this, from
#: priors and frames together, counts as undetermined. An index error of 0.01 costs 8 um per mm of height.
SCALES = {"tilt": 0.01, "gap_mm": 0.3, "gel_index": 0.01, "thickness_mm": 0.3, "index": 0.05}

#: Step of the numerical derivatives: the truncation error is its square, 1e-10; round-off divided by it is
#: 1e-8 px.
STEP = 1e-5

#: Maximum number of alternations between parameters and print error. Two sufficed for print errors from 0 to
#: 60 um, for every twentieth marker mislabelled, and for stated pitches of 0.6 to 1.7 mm with a true 0.85 mm.
ROUNDS = 8


@dataclass(frozen=True)
class SeatedFrame:
    """Markers of one stereo frame with known height above the rest plane.

    Attributes
    ----------
    height_mm
        Protrusion of the board that the gel is seated on, towards the cameras; 0 for a frame at rest.
    rows, cols
        (N,) row and column of every marker in the lattice.
    left_px, right_px
        (N, 2) centres of the markers.
    """

    height_mm: float
    rows: npt.NDArray[np.int64]
    cols: npt.NDArray[np.int64]
    left_px: Array
    right_px: Array

    @classmethod
    def from_frame(cls, frame: Frame, height_mm: float = 0.0, *, share: float = 0.9) -> SeatedFrame:
        """Markers of a pipeline's frame: at rest all visible ones, on a board those that lie on it.

        A marker counts as on the board if it and all its neighbours rise by at least ``share`` of the 90 %
        quantile, because the gel bends beside an edge.
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
    """A direction in the space of the layers' parameters, and its uncertainty.

    Attributes
    ----------
    weights
        Component along each parameter, in units of its scale (`SCALES`); a unit vector.
    sigma
        Standard deviation along the direction from the frames alone, in the same units. Above 1, the frames
        do not determine it.
    total_sigma
        Standard deviation from frames and priors together.
    """

    weights: Mapping[str, float]
    sigma: float
    total_sigma: float

    def __str__(self) -> str:
        parts = [f"{w:+.2f} {name}" for name, w in self.weights.items() if abs(w) > 0.1]
        return f"{' '.join(parts)}: {self.sigma:.2g} from the frames, {self.total_sigma:.2g} with the priors"


@dataclass(frozen=True)
class Known:
    """Prior knowledge, as standard deviations.

    Attributes
    ----------
    layers
        By parameter name; 0 holds the parameter fixed.
    pitch_mm, pitch_sigma_mm
        Stated pitch of the print along its rows, and its tolerance.
    aspect
        Pitch along the columns over that along the rows.
    height_sigma_mm
        Tolerance of a board's protrusion.
    centre_sigma_px
        Noise of a centre along each axis.
    """

    layers: Mapping[str, float]
    pitch_mm: float
    pitch_sigma_mm: float
    height_sigma_mm: float
    centre_sigma_px: float
    aspect: float = 1.0


class Model:
    """Pixels as a function of the layers, the lattice's pose, the boards' heights, the pitch and the markers.

    Shared parameters are the free parameters of the layers, six of the pose, an offset for each board, and
    the pitch. A marker at rest has the same printed position in all frames; these are combined into one frame
    with its mean centres. On a board, friction moves the markers, so they have separate positions in each
    frame.
    """

    def __init__(
        self, rig: Rig, frames: Sequence[SeatedFrame], layers: Mapping[str, Any], known: Known
    ) -> None:
        self.rig, self.known = rig, known
        self.nominal = parameters_of(layers)
        unknown = set(known.layers) - set(self.nominal)
        if unknown:
            raise CalibrationError(f"there is no parameter {sorted(unknown)}; valid are {list(self.nominal)}")
        self.free = [name for name in self.nominal if known.layers.get(name) != 0.0]
        self.boards = sorted({f.height_mm for f in frames if f.height_mm > 0.0})
        rest = [f for f in frames if f.height_mm == 0.0]
        seated = [f for f in frames if f.height_mm > 0.0]
        places, observed, count, scatter = _means(rest)
        self.scatter_chi2 = float((scatter**2).sum()) / known.centre_sigma_px**2
        self.scatter_degrees = 4 * (len(scatter) - len(count))
        self.places = np.concatenate([places, *(_places(f) for f in seated)])
        #: Places in units of the pitch along the rows.
        self.cells = self.places * [1.0, known.aspect]
        self.observed = np.concatenate([observed, *(_centres(f) for f in seated)])
        board = [np.full(len(f.rows), self.boards.index(f.height_mm)) for f in seated]
        self.board = np.concatenate([np.full(len(count), -1), *board])
        self.on_board = self.board >= 0
        self.height = np.append(self.boards, 0.0)[self.board]
        self.root = np.sqrt(np.append(count, np.ones(len(self.board) - len(count))))

    def start(self) -> tuple[Array, Array]:
        """Initial guess: design values, the lattice fitted to the rest frames, the markers on
        their planes.
        """
        rig = self.rig_with(np.array([self.nominal[name] for name in self.free]))
        # With the design values of the layers, the two rays of a marker need not intersect.
        rays = Params().replace({"triangulate.method": "rays", "triangulate.max_epipolar_px": 100.0})
        points = triangulate(rig, self.observed[:, :2], self.observed[:, 2:], rays)
        rest = ~self.on_board
        flat = np.column_stack([self.known.pitch_mm * self.cells, np.zeros(len(self.places))])
        pose = np.asarray(geometry.rigid_fit(flat[rest], points[rest]))
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        layers = [self.nominal[n] for n in self.free]
        shared = [*layers, *geometry.se3_log(pose).tolist(), *[0.0] * len(self.boards), self.known.pitch_mm]
        return np.array(shared), local[self.on_board, :2]

    def solve(self, start: tuple[Array, Array]) -> tuple[Solution, float]:
        """Maximum-likelihood parameters, and the standard deviation of the print's errors, mm.

        The variance and the parameters are estimated in turn until the variance changes by less than a
        thousandth.
        """
        # Initial guess, a hundredth of the pitch; the first round converges from there.
        variance, (shared, own) = (0.01 * self.known.pitch_mm) ** 2, start
        for _ in range(ROUNDS):
            solution = minimise(self.linearise(variance), (shared, own))
            shared, own = solution.shared, solution.own
            before, variance = (
                variance,
                print_variance(solution.linearised, self.known.pitch_mm * float(np.ptp(self.cells))),
            )
            if abs(variance - before) <= 1e-3 * max(variance, before):
                break
        return solution, float(np.sqrt(before))

    def linearise(self, print_variance_mm2: float) -> Callable[[Array, Array], Linearised]:
        """Residuals divided by their noise, with derivatives, for a print error of this variance."""

        def at(shared: Array, local: Array) -> Linearised:
            return self._linearised(shared, local, print_variance_mm2)

        return at

    def _linearised(self, shared: Array, local: Array, print_variance_mm2: float) -> Linearised:
        count = len(self.free)
        layers, pose, offsets, pitch_mm = np.split(shared, [count, count + 6, len(shared) - 1])
        rig, motion = self.rig_with(layers), np.asarray(geometry.se3_exp(pose))
        place = np.column_stack([pitch_mm * self.cells, -self.height])
        place[self.on_board, :2] = local
        place[self.on_board, 2] -= offsets[self.board[self.on_board]]
        points = place @ motion[:3, :3].T + motion[:3, 3]
        residual = self.observed - _pixels(rig, points)
        by_point = np.stack(
            [(_pixels(rig, points + d) - _pixels(rig, points - d)) / (2 * STEP) for d in STEP * np.eye(3)],
            axis=-1,
        )
        columns = []
        for step in STEP * np.eye(count):
            change = _pixels(self.rig_with(layers + step), points) - _pixels(
                self.rig_with(layers - step), points
            )
            columns.append(change / (2 * STEP))
        for step in STEP * np.eye(6):
            ends = [np.asarray(geometry.se3_exp(pose + s)) for s in (step, -step)]
            moved = [place @ end[:3, :3].T + end[:3, 3] for end in ends]
            columns.append(np.einsum("npk,nk->np", by_point, (moved[0] - moved[1]) / (2 * STEP)))
        up = -by_point @ motion[:3, 2]
        columns += [up * (self.board == k)[:, None] for k in range(len(self.boards))]
        own = by_point @ motion[:3, :2]
        columns.append(np.einsum("npk,nk->np", own, self.cells * ~self.on_board[:, None]))
        scale = self.root[:, None] / self.known.centre_sigma_px
        priors = self.priors()
        return Linearised(
            residual * scale,
            np.stack(columns, axis=-1) * scale[:, :, None],
            own * scale[:, :, None],
            np.where(self.on_board, np.inf, print_variance_mm2),
            np.array([(mean - shared[i]) / sigma for i, mean, sigma, _ in priors]),
            np.array([np.eye(len(shared))[i] / sigma for i, _, sigma, _ in priors]),
        )

    def priors(self) -> list[tuple[int, float, float, str]]:
        """Priors: index of the shared parameter, mean, standard deviation and name."""
        count, known = len(self.free), self.known
        found = [(self.free.index(n), self.nominal[n], s, n) for n, s in known.layers.items() if s > 0.0]
        for k, height_mm in enumerate(self.boards):
            found.append(
                (count + 6 + k, 0.0, known.height_sigma_mm, f"height of the board of {height_mm} mm")
            )
        found.append((count + 6 + len(self.boards), known.pitch_mm, known.pitch_sigma_mm, "pitch_mm"))
        return found

    def combinations(self, linearised: Linearised) -> tuple[Combination, ...]:
        """Eigenvectors of the layers' marginal information matrix, the least determined first."""
        count = len(self.free)
        if count == 0:
            return ()
        scale = np.array([_scale(name) for name in self.free])
        rows = linearised.reduced_jacobian()
        data = rows.T @ rows
        for place, _, sigma, _ in self.priors():
            if place >= count:
                data[place, place] += sigma**-2
        alone = _marginal(data, count) * np.outer(scale, scale)
        prior = np.diag([_information(self.known.layers.get(name)) for name in self.free]) * np.outer(
            scale, scale
        )
        values, vectors = np.linalg.eigh(alone + prior)
        found = []
        for value, vector in zip(values, vectors.T, strict=True):
            informed = max(float(vector @ alone @ vector), 1e-300)
            weights = dict(zip(self.free, vector.tolist(), strict=True))
            found.append(Combination(weights, informed**-0.5, float(max(value, 1e-300)) ** -0.5))
        return tuple(sorted(found, key=lambda c: -c.total_sigma))

    def rig_with(self, layers: Array) -> Rig:
        """The rig with these values of the free parameters."""
        return self.rig.with_layers(
            _layers({**self.nominal, **dict(zip(self.free, layers.tolist(), strict=True))})
        )


def _places(frame: SeatedFrame) -> Array:
    return np.column_stack([frame.cols, frame.rows]).astype(float)


def _centres(frame: SeatedFrame) -> Array:
    return np.hstack([frame.left_px, frame.right_px])


def _means(rest: Sequence[SeatedFrame]) -> tuple[Array, Array, Array, Array]:
    """Rows and columns of the markers at rest, mean centres, number of frames, and scatter of the centres
    about the mean.
    """
    places = np.concatenate([_places(f) for f in rest])
    seen = np.concatenate([_centres(f) for f in rest])
    unique, index, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    index = index.ravel()
    mean = np.zeros((len(unique), 4))
    np.add.at(mean, index, seen)
    mean /= count[:, None]
    return unique, mean, count.astype(float), seen - mean[index]


def _pixels(rig: Rig, points_mm: Array) -> Array:
    return np.column_stack(rig.project(points_mm))


def parameters_of(layers: Mapping[str, Any]) -> dict[str, float]:
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
    """Marginal information of the first parameters (Schur complement)."""
    a, b, c = information[:count, :count], information[:count, count:], information[count:, count:]
    scale = 1.0 / np.sqrt(np.diag(c))
    return np.asarray(
        a - (b * scale) @ np.linalg.pinv(c * np.outer(scale, scale), rcond=1e-13) @ (b * scale).T
    )
