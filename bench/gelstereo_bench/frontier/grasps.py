"""Parts pressed into the simulated gel, for registration: sensed points, truth, and the bound on
pose errors.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gelstereo import (
    Error,
    Localization,
    Params,
    RestSurface,
    Simulator,
    Template,
    localize,
    parts,
    pressure_saliency,
)
from gelstereo.geometry import se3_exp, se3_log
from gelstereo_bench.frontier.scenes import SURFACE_MM, VGA

if TYPE_CHECKING:
    import trimesh

__all__ = [
    "GRASPED",
    "NOISES",
    "SIDE",
    "STARTS",
    "STRAY_MM",
    "Grasp",
    "Noise",
    "Press",
    "Start",
    "grasps",
    "place",
    "simulator_of",
    "surface_normals",
]

Array = npt.NDArray[np.float64]

#: Salient markers by indentation (the paper's threshold); these include the gel's shoulder.
_SALIENT_MM = 0.35
#: Steeper faces are ignored: simulated markers touch them beside an edge, where real gel would hang.
_STEEP_COSINE = 0.35
#: Number of rows and columns of markers.
SIDE = 25
#: Largest displacement of outliers, mm.
STRAY_MM = 1.5
#: Directions with a larger standard deviation in the bound count as free; rotations in mm at the patch's
#: radius.
_OBSERVABLE_MM = 0.06
#: Minimum number of markers truly in contact, and range of the number of salient markers, of a valid contact.
_MIN_TOUCHING, _SALIENT = 20, range(12, 301)


@dataclass(frozen=True)
class Noise:
    """Noise of the sensed points."""

    name: str
    #: Standard deviation along the camera's axis; half of that across it.
    sigma_mm: float
    #: Share of salient points displaced by a random amount up to 1.5 mm.
    outliers: float
    #: Whether markers are salient by pressure, as in the presets balanced and exact, or by indentation, as in
    #: the paper.
    by_pressure: bool = True


@dataclass(frozen=True)
class Start:
    """Largest error of guesses, uniformly distributed."""

    name: str
    angle_deg: float
    shift_mm: float


@dataclass(frozen=True)
class Press:
    """A pressed part, and its orientation."""

    name: str
    make: Callable[[], trimesh.Trimesh]
    #: Range of the distance from the tip to where the part is held, mm.
    held_mm: tuple[float, float]
    #: Whether the part lies on one of its wide faces, normal along its y axis; other parts have a random
    #: roll.
    flat: bool = False
    #: Whether its tip is pressed, rather than its side.
    standing: bool = False


NOISES = (
    Noise("noise 0.03 mm", 0.03, 0.0),
    Noise("noise 0.06 mm, 10 % outliers", 0.06, 0.1),
    Noise("noise 0.03 mm, shoulder", 0.03, 0.0, by_pressure=False),
)
STARTS = (Start("5 deg, 1 mm", 5.0, 1.0), Start("10 deg, 2 mm", 10.0, 2.0), Start("30 deg, 5 mm", 30.0, 5.0))
GRASPED = (
    Press("round peg", parts.peg_round, (0.0, 8.0)),
    Press("square peg", parts.peg_square, (0.0, 8.0)),
    Press("irregular peg", parts.peg_irregular, (17.0, 34.0)),
    Press("USB plug", parts.usb_plug, (0.0, 20.0), flat=True),
    Press("M10 screw", parts.screw_m10, (0.0, 10.0)),
    Press("key", parts.key, (2.0, 24.0), flat=True),
)


@dataclass(frozen=True)
class Grasp:
    """One contact: sensed points and truth. Points and poses are in the sensor frame, mm."""

    part: str
    mesh: trimesh.Trimesh
    template: Template
    points_mm: Array
    covariance_mm2: Array
    #: All markers, including the salient ones.
    all_points_mm: Array
    #: Normals of the part at all markers in order; NaN where a marker is not truly in contact.
    normals: Array
    t_sensor_object: Array

    @cached_property
    def centre_mm(self) -> Array:
        """Centroid of the salient points."""
        return np.asarray(self.points_mm.mean(axis=0))

    @cached_property
    def radius_mm(self) -> float:
        """Root mean square distance of the salient points from their centroid."""
        return float(np.sqrt(np.mean(np.sum((self.points_mm - self.centre_mm) ** 2, axis=1))))

    @cached_property
    def information(self) -> Array:
        """Fisher information (Cramér-Rao) on (ρ ω, v) about the centroid, from the points truly in contact.

        True normals and noise are known. Positions along the surface are not informative.
        """
        touch = np.isfinite(self.normals[:, 0])
        normals, lever = self.normals[touch], self.all_points_mm[touch] - self.centre_mm
        rows = np.column_stack([np.cross(lever, normals) / self.radius_mm, normals])
        variance = np.einsum("ni,ij,nj->n", normals, self.covariance_mm2[0], normals)
        return np.asarray(rows.T @ (rows / variance[:, None]))

    def registered(self, guess: Array, params: Params) -> Localization:
        """Register with all sensed data of the contact.

        Raises
        ------
        RegisterError
            If the rung finds no pose.
        """
        return localize(
            self.points_mm,
            self.template,
            guess=guess,
            all_points_mm=self.all_points_mm,
            covariance_mm2=self.covariance_mm2,
            params=params,
        )

    def localized(self, guess: Array, params: Params) -> Array:
        """As `registered`, but returns only (4, 4) t_sensor_object.

        Raises
        ------
        RegisterError
            If the rung finds no pose.
        """
        return np.asarray(self.registered(guess, params).t_sensor_object)

    def guess(self, start: Start, seed: int) -> Array:
        """Draw a guess: the truth rotated about the patch's centroid and shifted."""
        random = np.random.default_rng([seed, 41])
        turn, move = (vector / np.linalg.norm(vector) for vector in random.normal(size=(2, 3)))
        angle, shift = random.uniform(size=2) * [np.deg2rad(start.angle_deg), start.shift_mm]
        about = np.eye(4)
        about[:3, 3] = self.centre_mm
        motion = se3_exp(np.concatenate([angle * turn, shift * move]))
        return np.asarray(about @ motion @ np.linalg.inv(about) @ self.t_sensor_object, np.float64)

    def score(self, found: Array) -> Score:
        """Compare a pose with the truth, over the determined directions."""
        about = np.eye(4)
        about[:3, 3] = -self.centre_mm
        twist = se3_log(about @ self.t_sensor_object @ np.linalg.inv(found) @ np.linalg.inv(about))
        error = np.concatenate([twist[:3] * self.radius_mm, twist[3:]])
        values, vectors = self._observable
        return self._score(values, vectors, vectors.T @ error)

    def at_bound(self, draws: int, seed: int) -> float:
        """Success rate of an efficient estimator: normal errors with the bound's covariance."""
        values, vectors = self._observable
        errors = np.random.default_rng([seed, 53]).normal(size=(draws, len(values))) / np.sqrt(values)
        return float(np.mean([self._score(values, vectors, along).success for along in errors]))

    @property
    def _observable(self) -> tuple[Array, Array]:
        """Information on the determined directions, (K,), and these directions, (6, K)."""
        values, vectors = np.linalg.eigh(self.information)
        seen = values * _OBSERVABLE_MM**2 >= 1.0
        return values[seen], vectors[:, seen]

    def _score(self, values: Array, vectors: Array, along: Array) -> Score:
        kept = vectors @ along
        return Score(
            len(values),
            float(values @ along**2),
            float(np.rad2deg(np.linalg.norm(kept[:3]) / self.radius_mm)),
            float(np.linalg.norm(kept[3:])),
        )


@dataclass(frozen=True)
class Score:
    """Error over the determined directions."""

    observable: int
    #: Sum over these directions of the squared error, normalised by the bound.
    squared: float
    angle_deg: float
    shift_mm: float

    @property
    def success(self) -> bool:
        """Within 2 degrees and 0.3 mm, the paper's assembly tolerance."""
        return self.angle_deg <= 2.0 and self.shift_mm <= 0.3


def grasps(press: Press, noise: Noise, seeds: range) -> Iterator[Grasp]:
    """Press a part once per seed: across the gel, held within 4 mm of the middle, 0.8 to 1.4 mm deep."""
    mesh = press.make()
    template = Template.from_mesh(mesh, units="mm", spacing_mm=0.3).with_grid()
    simulator = simulator_of(mesh)
    for seed in seeds:
        random = np.random.default_rng([seed, 20211])
        for _ in range(100):
            found = _grasp(press, mesh, template, simulator, noise, random)
            if found is not None:
                yield found
                break
        else:
            raise Error(f"{press.name} does not lie on the gel in a way that can be used (seed {seed})")


def simulator_of(mesh: trimesh.Trimesh) -> Simulator:
    """Simulator of a part that is pressed into the gel."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.stl"
        mesh.export(path)
        indenter = {"kind": "mesh", "path": str(path), "units": "mm"}
        return Simulator(VGA.scene().replace({"indenter": indenter}))


def _grasp(
    press: Press,
    mesh: trimesh.Trimesh,
    template: Template,
    simulator: Simulator,
    noise: Noise,
    random: np.random.Generator,
) -> Grasp | None:
    pose = place(press, mesh, random)
    truth = simulator.press(pose)
    points, touching = np.array(truth.points_mm), np.array(truth.in_contact)
    sigma = noise.sigma_mm * np.array([0.5, 0.5, 1.0])
    points += sigma * random.normal(size=points.shape)
    salient = _salient(simulator, points, noise)
    outlier = salient & (random.uniform(size=len(points)) < noise.outliers)
    points[outlier, 2] += random.uniform(-STRAY_MM, STRAY_MM, size=int(outlier.sum()))
    touching &= ~outlier
    if touching.sum() < _MIN_TOUCHING or int(salient.sum()) not in _SALIENT:
        return None
    normals = np.full_like(points, np.nan)
    normals[touching] = surface_normals(mesh, template, pose, np.asarray(truth.points_mm)[touching])
    normals[~(normals[:, 2] < -_STEEP_COSINE)] = np.nan
    covariance = np.broadcast_to(np.diag(sigma**2), (int(salient.sum()), 3, 3)).copy()
    return Grasp(press.name, mesh, template, points[salient], covariance, points, normals, pose)


def _salient(simulator: Simulator, points_mm: Array, noise: Noise) -> npt.NDArray[np.bool_]:
    """Markers classified as in contact."""
    if not noise.by_pressure:
        return np.asarray(SURFACE_MM - points_mm[:, 2] > _SALIENT_MM)
    rest = RestSurface(simulator.press().points_mm)
    variance = np.full(len(points_mm), noise.sigma_mm**2)
    heights = rest.indentation_mm(points_mm)
    decay_mm = Params().to_dict()["contact"]["decay_mm"]
    salient, _ = pressure_saliency(rest, heights, variance, rows=SIDE, cols=SIDE, decay_mm=decay_mm)
    return np.asarray(salient)


def place(press: Press, mesh: trimesh.Trimesh, random: np.random.Generator) -> Array:
    """Draw a pose: the part's axis across the gel (along its normal if it stands), tilted by up to 3.5
    degrees.
    """
    roll = random.choice([0.5, 1.5]) * np.pi + random.uniform(-0.1, 0.1)
    if not press.flat:
        roll = random.uniform(0.0, 2.0 * np.pi)
    yaw, tilt = random.uniform(0.0, 2.0 * np.pi), random.uniform(-0.06, 0.06)

    def turn(axis: int, angle: float) -> Array:
        twist = np.zeros(6)
        twist[axis] = angle
        return np.asarray(se3_exp(twist), np.float64)

    pose = turn(2, yaw) @ turn(1, (1.0 if press.standing else 0.5) * np.pi + tilt) @ turn(2, roll)
    held = pose[:3, :3] @ [0.0, 0.0, mesh.bounds[1][2] - random.uniform(*press.held_mm)]
    pose[:2, 3] = np.array(VGA.centre_mm) + random.uniform(-4.0, 4.0, size=2) - held[:2]
    depth_mm = random.uniform(0.8, 1.4)
    placed = _samples(mesh) @ pose[:3, :3].T + pose[:3, 3]
    over = np.all(np.abs(placed[:, :2] - VGA.centre_mm) < 10.0, axis=1)
    nearest = placed[over, 2].min() if np.any(over) else placed[:, 2].min()
    pose[2, 3] += SURFACE_MM - depth_mm - nearest
    return pose


def _samples(mesh: trimesh.Trimesh) -> Array:
    """Points distributed over the surface; identical for the same mesh."""
    import trimesh

    points, _ = trimesh.sample.sample_surface(mesh, 20000, seed=1)
    return np.vstack([points, mesh.vertices])


def surface_normals(mesh: trimesh.Trimesh, template: Template, pose: Array, points_mm: Array) -> Array:
    """Normals of the part's faces nearest to points in the sensor frame."""
    back = (points_mm - pose[:3, 3]) @ pose[:3, :3]
    return np.asarray(mesh.face_normals[template.closest(back).triangles] @ pose[:3, :3].T)
