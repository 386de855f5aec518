"""Accuracy of marker centres under good and bad conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Detector, Error, Scene, SimulatedFrame, Simulator
from gelstereo.extras import needs
from gelstereo_bench.frontier.bounds import marker_bounds_px
from gelstereo_bench.frontier.rungs import EXACT, FAST, rungs_of
from gelstereo_bench.frontier.scenes import FACING_RAD, FORMATS, SURFACE_MM, VGA, Format, board_shape, effects
from gelstereo_bench.frontier.table import Report, Table, Target, figure

with needs(__name__):
    from scipy.spatial import cKDTree

__all__ = ["CONDITIONS", "FRAMES_PER_SEED", "Condition", "Matches", "match", "measure_centres"]

Array = npt.NDArray[np.float64]

#: Maximum distance of matching detected and true centres.
_MATCH_PX = 3.0

#: Number of frames per condition and seed; they share the static grain of the paint.
FRAMES_PER_SEED = 5


@dataclass(frozen=True)
class Condition:
    """Imaging conditions of markers."""

    name: str
    size: Format = VGA
    gel: Mapping[str, Any] = field(default_factory=dict)
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def scene(self, seed: int) -> Scene:
        """Create the scene without contact."""
        return self.size.scene(gel=self.gel).replace({"seed": seed, "effects": effects(**self.effects)})

    def frames(self, seed: int) -> list[SimulatedFrame]:
        """Frames at rest, under a ball and under a board; each frame has its own noise."""
        x, y = self.size.centre_mm
        ball, board = np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0])
        ball[:3, 3] = board[:3, 3] = (x, y, SURFACE_MM)
        assert FACING_RAD[0] == np.pi  # given by the board's pose
        frames: list[SimulatedFrame] = []
        for shape, pose in (({"kind": "sphere", "radius_mm": 5.0}, ball), (board_shape(0.8), board)):
            simulator = Simulator(self.scene(seed).replace({"indenter": shape}))
            depths_mm = (0.6, 1.2) if frames else (None, 0.6, 1.2)
            for depth_mm in depths_mm:
                at = None if depth_mm is None else simulator.pressed(pose, depth_mm)
                frames.append(simulator.press(at, frame=len(frames)))
        return frames

    def bound_px(self) -> float:
        """Minimum 2-D rms error of an unbiased centre, over the left view's markers in one seed's frames."""
        frames = self.frames(1)
        centres_px = np.concatenate([frame.left_px for frame in frames])
        points_mm = np.concatenate([frame.points_mm for frame in frames])
        bounds = marker_bounds_px(self.scene(1).to_dict(), centres_px, points_mm)
        return float(np.sqrt(np.mean(np.square(bounds))))


#: Grey levels at 35 % of the light, and with 25 levels of contrast; the paint's grain scales with light and
#: contrast.
CONDITIONS = (
    *(Condition(size.name, size) for size in FORMATS[:2]),
    Condition("25 levels of contrast", VGA, {"dark_level": 145}, {"grain": {"sigma_levels": 3.0 * 25 / 120}}),
    Condition(
        "35 % of the light",
        VGA,
        {"dark_level": 18, "bright_level": 60},
        {"grain": {"sigma_levels": 3.0 * 0.35}},
    ),
    Condition("noise of 18 levels", VGA, {}, {"sensor_noise": {"sigma_levels": 18.0}}),
)


@dataclass
class Matches:
    """Detected and true centres over several images."""

    #: (N, 2) detected minus true, px.
    errors_px: Array
    #: (N, 2, 2) covariances stated by the detector.
    covariance_px2: Array
    missed: int
    false: int

    @property
    def rms_px(self) -> float:
        """Two-dimensional root mean square error."""
        return float(np.sqrt((self.errors_px**2).sum(axis=1).mean())) if len(self.errors_px) else float("nan")

    @property
    def largest_px(self) -> float:
        """Largest error."""
        return float(np.linalg.norm(self.errors_px, axis=1).max()) if len(self.errors_px) else float("nan")

    @property
    def complete(self) -> bool:
        """Whether exactly the true markers were detected."""
        return self.missed == 0 and self.false == 0


def match(detector: Detector, frames: Sequence[SimulatedFrame]) -> Matches:
    """Detect the markers of both views of all frames and compare them with the truth.

    True and detected markers match if they are mutual nearest neighbours. Others are missed or false.
    """
    errors, covariances, missed, false = [np.empty((0, 2))], [np.empty((0, 2, 2))], 0, 0
    for frame in frames:
        for image, truth in ((frame.left, frame.left_px), (frame.right, frame.right_px)):
            try:
                markers = detector.detect(image)
            except Error:
                missed += len(truth)
                continue
            found = markers.centres_px
            if len(found) == 0:
                missed += len(truth)
                continue
            distance, nearest = cKDTree(found).query(truth)
            owner = cKDTree(truth).query(found)[1]
            good = (distance < _MATCH_PX) & (owner[nearest] == np.arange(len(truth)))
            errors.append(found[nearest[good]] - truth[good])
            covariances.append(markers.covariance_px2[nearest[good]])
            missed += int((~good).sum())
            false += len(found) - int(good.sum())
    return Matches(np.concatenate(errors), np.concatenate(covariances), missed, false)


def measure_centres(seeds: int, report: Report) -> tuple[Table, list[Target], dict[str, dict[str, Matches]]]:
    """Measure every rung of detection and every preset under every condition.

    Returns the table, the targets, and the matches by condition and method.
    """
    methods = {rung.name: rung for rung in (*rungs_of("detect"), *rungs_of("whole"))}
    found: dict[str, dict[str, Matches]] = {}
    for condition in CONDITIONS:
        report(f"centres: {condition.name}")
        frames = [frame for seed in range(1, seeds + 1) for frame in condition.frames(seed)]
        found[condition.name] = {
            name: match(Detector(rung.params()), frames) for name, rung in methods.items()
        }
    bounds_px = {condition.name: condition.bound_px() for condition in CONDITIONS}
    rows = [
        [name, *(_cell(found[condition][name], bound_px) for condition, bound_px in bounds_px.items())]
        for name in methods
    ]
    rows.append(["*Cramér-Rao bound*", *map(figure, bounds_px.values())])
    table = Table("centres", ["method", *(condition.name for condition in CONDITIONS)], rows)
    return table, _targets(found, bounds_px), found


def _cell(matches: Matches, bound_px: float) -> str:
    ratio = matches.rms_px / bound_px
    text = f"{figure(matches.rms_px)} / {figure(ratio)} / {figure(matches.largest_px)}"
    return text if matches.complete else f"{text}; {matches.missed} missed, {matches.false} false"


def _targets(found: Mapping[str, Mapping[str, Matches]], bounds_px: Mapping[str, float]) -> list[Target]:
    targets = []
    good = [size.name for size in FORMATS[:2]]
    for method, limit_px in ((FAST, 0.05), (EXACT, 0.03)):
        for name in good:
            rms_px = found[name][method].rms_px
            targets.append(Target(f"centres, {method}, {name}, 2-D rms", limit_px, rms_px, "px"))
            if method == EXACT:
                ratio = rms_px / bounds_px[name]
                targets.append(Target(f"centres, {method}, {name}, over the bound", 1.3, ratio, ""))
        worst_px = max(found[name][method].largest_px for name in good)
        targets.append(Target(f"centres, {method}, largest error", 0.2, worst_px, "px"))
        wrong = sum(matches[method].missed + matches[method].false for matches in found.values())
        targets.append(
            Target(f"centres, {method}, missed and false under all conditions", 0, wrong, "markers")
        )
    return targets
