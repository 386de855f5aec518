"""Error, success and time of registration."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Params, Pipeline, Scene, Template, localize
from gelstereo.extras import needs
from gelstereo.geometry import se3_exp, se3_log
from gelstereo_bench.frontier import baseline_register
from gelstereo_bench.frontier.rungs import Rung, rungs_of
from gelstereo_bench.frontier.scenes import PARTS, Part, part_press
from gelstereo_bench.frontier.sensing import Row
from gelstereo_bench.frontier.table import Report
from gelstereo_bench.frontier.timing import InstructionCounter, time_side_by_side

with needs(__name__):
    from scipy.spatial import cKDTree

__all__ = ["SUCCESS_MM", "Patch", "measure_registration", "observable_error_mm"]

Array = npt.NDArray[np.float64]
#: Function from a patch and a guess to a pose.
Method = Callable[["Patch", Array], Array]

#: Half of the paper's assembly tolerance of 0.3 mm.
SUCCESS_MM = 0.15
#: Directions count as free if moving the part by 1 mm moves its surface by less than this, rms mm.
_OBSERVABLE = 0.1
_START_DEG, _START_MM = 5.0, 1.0


@dataclass(frozen=True)
class Patch:
    """A sensed patch of a part, and the truth."""

    part: Part
    template: Template
    points_mm: Array
    t_sensor_object: Array

    @classmethod
    def simulate(cls, part: Part) -> Patch:
        """Press the part and take the salient points of the balanced pipeline.

        All of them are used, including the shoulder: a threshold relative to the deepest would lose the
        shallower of several contacts.
        """
        press = part_press(part)
        pipeline = Pipeline(Scene().rig, Params.preset("balanced"))
        for frame in press:
            result = pipeline.process(frame.left, frame.right)
        truth = press[-1].t_sensor_object
        if truth is None:
            raise Error(f"the scene of {part.name} has no part")
        return cls(part, part.template(), result.points_mm[result.salient], np.array(truth))

    def start(self, seed: int) -> Array:
        """Draw a guess: rotated about the patch's centroid by 5 degrees and shifted by 1 mm, in random
        directions.
        """
        random = np.random.default_rng([seed, 20211])
        turn, move = (vector / np.linalg.norm(vector) for vector in random.normal(size=(2, 3)))
        centre = np.eye(4)
        centre[:3, 3] = self.points_mm.mean(axis=0)
        motion = se3_exp(np.concatenate([np.deg2rad(_START_DEG) * turn, _START_MM * move]))
        return np.asarray(centre @ motion @ np.linalg.inv(centre) @ self.t_sensor_object, np.float64)

    @cached_property
    def radius_mm(self) -> float:
        """Root mean square distance of the points from their centroid."""
        lever = self.points_mm - self.points_mm.mean(axis=0)
        return float(np.sqrt(np.mean(np.sum(lever**2, axis=1))))

    @cached_property
    def determined(self) -> Array:
        """(6, K) orthonormal directions, rotation before translation, that the contact determines.

        Rotations are about the centroid and scaled by the patch's radius.
        """
        lever = self.points_mm - self.points_mm.mean(axis=0)
        pose = self.t_sensor_object
        true_points = self.template.points_mm @ pose[:3, :3].T + pose[:3, 3]
        nearest = cKDTree(true_points).query(self.points_mm)[1]
        normals = self.template.normals[nearest] @ pose[:3, :3].T
        rows = np.column_stack([np.cross(lever, normals) / self.radius_mm, normals])
        values, vectors = np.linalg.eigh(rows.T @ rows / len(rows))
        return np.asarray(vectors[:, np.sqrt(np.maximum(values, 0.0)) > _OBSERVABLE])


def observable_error_mm(patch: Patch, found: Array) -> float:
    """Rms error over the directions that the contact determines, mm.

    The error twist about the patch's centroid, with rotation scaled by the patch's radius, is projected on
    the directions in which the true surface under the patch moves along its normals.
    """
    to_centre = np.eye(4)
    to_centre[:3, 3] = -patch.points_mm.mean(axis=0)
    twist = se3_log(to_centre @ found @ np.linalg.inv(patch.t_sensor_object) @ np.linalg.inv(to_centre))
    scaled = np.concatenate([twist[:3] * patch.radius_mm, twist[3:]])
    along = patch.determined.T @ scaled
    return float(np.sqrt(np.mean(along**2)))


def measure_registration(rounds: int, starts: int, counter: InstructionCounter, report: Report) -> list[Row]:
    """Measure error and success over parts and starts, and the time of one registration."""
    patches = [Patch.simulate(part) for part in PARTS]
    methods: dict[str, Method] = {rung.name: _native(rung) for rung in rungs_of("register")}
    native = set(methods)
    methods |= _baselines(Params().to_dict()["register"])
    yardstick = "SciPy: FilterReg, point to point (baseline)"
    errors = []
    instructions: dict[str, int | None] = {}
    for name, method in methods.items():
        report(f"register: {name}")
        # RANSAC in Python takes half a second per start.
        enough = starts if name in native or "RANSAC" not in name else max(1, starts // 8)
        found = [[_error_mm(method, patch, seed) for seed in range(enough)] for patch in patches]
        errors.append((name, *_summary(found)))
        if name in native:
            rung = next(rung for rung in rungs_of("register") if rung.name == name)
            instructions[name] = _count(counter, rung, patches[0])
    calls = {name: _one_of(method, patches) for name, method in methods.items()}
    times = time_side_by_side(calls, rounds)
    reference_ms = times[yardstick].median_ms
    return [
        Row(
            "register",
            name,
            text,
            value,
            times[name],
            instructions.get(name),
            reference_ms / times[name].median_ms,
            name not in native,
        )
        for name, text, value in errors
    ]


def _summary(found: list[list[float]]) -> tuple[str, float]:
    """Format the rms error of the successes and the success rate by part."""
    good = np.array([error for errors in found for error in errors if error < SUCCESS_MM])
    rates = " / ".join(f"{100 * np.mean(np.array(errors) < SUCCESS_MM):.0f}" for errors in found)
    rms_um = 1e3 * float(np.sqrt(np.mean(good**2))) if len(good) else float("nan")
    text = f"{rms_um:.0f} um rms" if len(good) else "no success"
    return f"{text}, {rates} % succeed", rms_um


def _error_mm(method: Method, patch: Patch, seed: int) -> float:
    try:
        return observable_error_mm(patch, method(patch, patch.start(seed)))
    except (Error, np.linalg.LinAlgError):
        return float("inf")


def _one_of(method: Method, patches: list[Patch]) -> Callable[[int], object]:
    def call(turn: int) -> object:
        patch = patches[turn % len(patches)]
        return method(patch, patch.start(turn))

    return call


def _native(rung: Rung) -> Method:
    params = rung.params()
    return lambda patch, guess: (
        localize(patch.points_mm, patch.template, guess=guess, params=params).t_sensor_object
    )


def _baselines(register: Mapping[str, Any]) -> dict[str, Method]:
    advanced, widths = register["advanced"], register["filterreg"]
    common = {name: advanced[name] for name in ("max_iterations", "step_tolerance")}
    soft = {"sigma_start_mm": widths["max_sigma_mm"], "sigma_floor_mm": widths["min_sigma_mm"]}
    soft["outlier_share"] = advanced["outlier_share"]
    near = {"max_distance_mm": advanced["max_distance_mm"]}
    random = {**register["ransac_icp"], "search_radius_mm": advanced["search_radius_mm"]}

    def method(function: Callable[..., Array], settings: Mapping[str, Any]) -> Method:
        return lambda patch, guess: function(
            patch.points_mm,
            patch.template.points_mm,
            patch.template.normals,
            guess,
            spacing_mm=patch.template.spacing_mm,
            **settings,
        )

    filterreg, icp = baseline_register.filterreg, baseline_register.icp
    return {
        "SciPy: FilterReg, point to point (baseline)": method(filterreg, {**common, **soft}),
        "SciPy: FilterReg, point to plane": method(filterreg, {**common, **soft, "plane": True}),
        "SciPy: ICP, point to plane": method(icp, {**common, **near, "plane": True}),
        "SciPy: RANSAC + ICP": method(baseline_register.ransac_icp, {**common, **near, **random}),
    }


def _count(counter: InstructionCounter, rung: Rung, patch: Patch) -> int | None:
    # The program receives only points; the rungs on the part's surface need its triangles.
    if not counter.present or rung.name.startswith("surface"):
        return None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = [folder / file for file in ("params.toml", "template.txt", "patch.txt", "guess.txt")]
        rung.params().save(files[0])
        rows = np.column_stack([patch.template.points_mm, patch.template.normals])
        np.savetxt(files[1], rows, header=repr(patch.template.spacing_mm), comments="", fmt="%.17g")
        np.savetxt(files[2], patch.points_mm, fmt="%.17g")
        np.savetxt(files[3], patch.start(0), fmt="%.17g")
        return counter.count("register", files)
