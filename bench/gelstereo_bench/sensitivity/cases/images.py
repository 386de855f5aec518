"""Pairs of images, simulated and path-traced (half for work), through whole pipelines."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from gelstereo import Detector, Error, MarkerState, Params, Pipeline, Rig, Scene, SimulatedFrame, Simulator
from gelstereo_bench.frontier.scenes import (
    FACING_RAD,
    SURFACE_MM,
    VGA,
    board_shape,
    effects,
    layered_scene,
    press,
)
from gelstereo_bench.sensitivity.figures import Case, Evaluation
from outside.images import Condition, Sequence
from outside.judge import f1, under_glints

__all__ = ["load"]

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

_PRESETS = ("fast", "balanced", "exact")
#: Methods that no preset but the paper's uses, on simulated scenes alone.
_RUNGS: dict[str, tuple[str, dict[str, Any]]] = {
    "paper": ("paper", {}),
    "grey": ("balanced", {"detect": {"centre": "grey", "search": "whole"}}),
    "pressure": ("balanced", {"contact": {"saliency": "pressure", "learn_decay": True}}),
}
_RUNG_SCENES = 3
#: Sequences that show what the others do not: the rest would take as long again.
_PATH_TRACED = ("w1_press_at_once", "w3_glints", "w4_shear", "w6_laws", "w7_light")
#: A marker farther than this from where it should be is wrong, px.
_NEAR_PX = 2.0
#: Of so many frames one also goes to a detector by itself, for the covariance of its centres.
_DETECTED = 3


@dataclass(frozen=True)
class _Frame:
    left: Image
    right: Image
    left_px: Array
    right_px: Array
    points_mm: Array
    #: Markers that count: not under a glint, and within both images.
    clear: npt.NDArray[np.bool_]
    touching: npt.NDArray[np.bool_]

    @cached_property
    def trees(self) -> tuple[Any, Any]:
        """Nearest true centres, in the left view and in the right one."""
        return cKDTree(self.left_px), cKDTree(self.right_px)


@dataclass(frozen=True)
class _Scene:
    rig: Rig
    changes: dict[str, Any]
    frames: list[_Frame]


@dataclass
class _Tally:
    """Over all scenes of one kind, with one preset."""

    markers: int = 0
    seen: int = 0
    wrong: int = 0
    failed: int = 0
    strays: int = 0
    centres: list[Array] = field(default_factory=list)
    depths: list[Array] = field(default_factory=list)
    centre_squared: list[Array] = field(default_factory=list)
    point_squared: list[Array] = field(default_factory=list)
    f1: list[float] = field(default_factory=list)

    def put(self, name: str, out: dict[str, float]) -> None:
        """Write the figures, their units at the end of their names."""

        def rms(parts: list[Array]) -> float:
            values = np.concatenate(parts) if parts else np.empty(0)
            return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")

        def mean(parts: list[Array]) -> float:
            values = np.concatenate(parts) if parts else np.empty(0)
            # A few markers at edges err by hundreds: they would hide all others.
            return float(np.mean(np.minimum(values, 25.0))) if values.size else float("nan")

        out[f"{name}: labelled, %"] = 100.0 * self.seen / max(self.markers, 1)
        out[f"{name}: wrong names"] = self.wrong
        out[f"{name}: failed frames"] = self.failed
        out[f"{name}: strays"] = self.strays
        out[f"{name}: centre error, px"] = rms(self.centres)
        out[f"{name}: depth error, um"] = 1000.0 * rms(self.depths)
        out[f"{name}: centre NEES"] = mean(self.centre_squared)
        out[f"{name}: point NEES"] = mean(self.point_squared)
        out[f"{name}: contact F1, %"] = 100.0 * float(np.mean(self.f1)) if self.f1 else float("nan")


def _simulated(frames: list[SimulatedFrame], scene: Scene, **changes: Any) -> _Scene:
    height, width = frames[0].left.shape
    found = []
    for frame in frames:
        inside = np.ones(len(frame.left_px), bool)
        for pixels in (frame.left_px, frame.right_px):
            inside &= ((pixels >= 5.0) & (pixels <= (width - 6.0, height - 6.0))).all(axis=1)
        truth = (frame.left_px, frame.right_px, frame.points_mm)
        found.append(_Frame(frame.left, frame.right, *truth, inside, np.asarray(frame.in_contact)))
    pitch = {"lattice.pitch_mm": scene.to_dict()["gel"]["pitch_mm"]}
    size = {"lattice.rows": scene.to_dict()["gel"]["rows"], "lattice.cols": scene.to_dict()["gel"]["cols"]}
    return _Scene(scene.rig, {**pitch, **size, **changes}, found)


def _pressed(scene: Scene, depths_mm: list[float], shears_mm: list[float]) -> list[SimulatedFrame]:
    """A ball of 5 mm, pressed and moved sideways; a depth below zero leaves the gel untouched."""
    simulator = Simulator(scene.replace({"indenter": {"kind": "sphere", "radius_mm": 5.0}}))
    pose = np.eye(4)
    pose[:3, 3] = (*scene.to_dict()["gel"]["centre_mm"], SURFACE_MM)
    frames = []
    for index, (depth, shear) in enumerate(zip(depths_mm, shears_mm, strict=True)):
        at = None
        if depth > 0.0:
            at = np.array(simulator.pressed(pose, depth))
            at[0, 3] += shear
        frames.append(
            simulator.press(at, shear_mm=(shear, 0.0), frame=index)
            if depth > 0.0
            else simulator.press(None, frame=index)
        )
    return frames


def _walled(scene: _Scene) -> _Scene:
    """The same with a dark tray around the print, to which light falls off."""
    frames = []
    for frame in scene.frames:
        images = []
        for image, px in ((frame.left, frame.left_px), (frame.right, frame.right_px)):
            inside = np.full(image.shape, 0.35, np.float32)
            (x0, y0), (x1, y1) = px.min(axis=0) - 14.0, px.max(axis=0) + 14.0
            inside[max(int(y0), 0) : int(y1), max(int(x0), 0) : int(x1)] = 1.0
            images.append(np.asarray(np.rint(image * cv2.GaussianBlur(inside, (0, 0), 3.0)), np.uint8))
        left, right = images
        frames.append(replace(frame, left=left, right=right))
    return _Scene(scene.rig, scene.changes, frames)


def _jumping(scene: Scene) -> list[SimulatedFrame]:
    x, y = scene.to_dict()["gel"]["centre_mm"]
    steps = [(0.0, 0.0), (0.6, 0.0), (0.6, 0.55), (-0.2, -0.5)]
    places = [[x + dx, y + dy] for dx, dy in steps]
    return [
        Simulator(scene.replace({"gel": {"centre_mm": place}})).press(None, frame=k)
        for k, place in enumerate(places)
    ]


def simulated_scenes() -> list[_Scene]:
    """Gentle and deep presses, little light, a tray, a jump, bright dots, fine markers, layers, a board."""
    usual = VGA.scene()
    drag = usual.replace({"effects": {**effects(), "drag": {}}})
    dim = {"bright_level": 90, "dark_level": 45}
    dark = usual.replace({"gel": dim, "effects": effects(sensor_noise={"sigma_levels": 5.0})})
    bright = usual.replace({"gel": {"bright_dots": True}})
    fine, layers = VGA.scene(45), layered_scene()
    gentle = _simulated(_pressed(usual, [-1, 0.2, 0.4], [0, 0, 0]), usual)
    board = press(usual, board_shape(1.0), SURFACE_MM + 1.2, SURFACE_MM, FACING_RAD)
    return [
        gentle,
        _walled(gentle),
        _simulated(_pressed(drag, [-1, 0.6, 1.2, 1.2, 1.2], [0, 0, 0, 0.5, 1.0]), drag),
        _simulated(_pressed(dark, [-1, 0.8], [0, 0]), dark),
        _simulated(_jumping(usual), usual),
        _simulated(_pressed(bright, [-1, 0.8], [0, 0]), bright, **{"detect.polarity": "bright"}),
        _simulated(_pressed(fine, [-1, 0.8], [0, 0]), fine),
        _simulated(_pressed(layers, [-1, 0.8], [0, 0]), layers),
        _simulated(board[:: max(1, len(board) // 4)], usual),
    ]


def path_traced_scenes() -> list[_Scene]:
    """Sequences of the half for work, with the usual noise."""
    scenes = []
    for name in _PATH_TRACED:
        stored = Sequence.load(name)
        frames = []
        for k in range(len(stored)):
            left, right = stored.pair(k, Condition())
            left_px, right_px, points_mm = (
                stored.truth[key][k] for key in ("left_px", "right_px", "points_mm")
            )
            touching = stored.truth["touching"][k].astype(bool)
            clear = ~under_glints(stored, k)
            frames.append(_Frame(left, right, left_px, right_px, points_mm, clear, touching))
        scenes.append(
            _Scene(Rig.from_toml(stored.about["rig"]), {"lattice.pitch_mm": stored.about["pitch_mm"]}, frames)
        )
    return scenes


def _judge(scene: _Scene, params: Params, tally: _Tally, out: Evaluation) -> None:
    changed = params.replace(dict(scene.changes))
    pipeline, detector = Pipeline(scene.rig, changed), Detector(changed)
    for index, true in enumerate(scene.frames):
        tally.markers += int(true.clear.sum())
        if index % _DETECTED == 0:
            _judge_detections(detector, true, tally, out)
        try:
            frame = pipeline.process(true.left, true.right)
        except Error:
            tally.failed += 1
            out.see([index])
            continue
        out.see([frame.digest])
        seen = np.asarray(frame.state).ravel() == MarkerState.SEEN
        if len(seen) != len(true.left_px):
            tally.wrong += int(seen.sum())
            continue
        good = seen & true.clear
        wrong = [0, 0]
        for view, (px, true_px) in enumerate(
            ((frame.left_px, true.left_px), (frame.right_px, true.right_px))
        ):
            found_px = np.reshape(px, (-1, 2))
            nearest = true.trees[view].query(found_px[seen])[1]
            wrong[view] = int((nearest != np.flatnonzero(seen)).sum())
            good &= np.linalg.norm(found_px - true_px, axis=1) < _NEAR_PX
        tally.wrong += max(wrong)
        tally.seen += int(good.sum())
        for px, true_px in ((frame.left_px, true.left_px), (frame.right_px, true.right_px)):
            tally.centres.append((np.reshape(px, (-1, 2)) - true_px)[good])
        error = np.reshape(frame.points_mm, (-1, 3)) - true.points_mm
        tally.depths.append(error[good, 2])
        covariance = np.reshape(frame.covariance_mm2, (-1, 3, 3))[good]
        if good.any():
            solved = np.linalg.solve(covariance, error[good][..., None])[..., 0]
            tally.point_squared.append((error[good] * solved).sum(axis=1) / 3.0)
        if true.touching.sum() >= 4:
            tally.f1.append(f1(np.asarray(frame.salient).ravel(), true.touching))


def _judge_detections(detector: Detector, true: _Frame, tally: _Tally, out: Evaluation) -> None:
    try:
        found = detector.detect(true.left)
    except Error:
        tally.strays += 1
        return
    out.see(found.centres_px, found.covariance_px2)
    if not len(found.centres_px):
        return
    far, near = true.trees[0].query(found.centres_px)
    close = far < _NEAR_PX
    tally.strays += int((~close).sum())
    kept = close & true.clear[near]
    error = (found.centres_px - true.left_px[near])[kept]
    covariance = found.covariance_px2.reshape(-1, 2, 2)[kept]
    tally.centre_squared.append(
        (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(axis=1) / 2.0
    )


def _case(name: str, params: Params, scenes: list[_Scene]) -> Case:
    def evaluate() -> Evaluation:
        out, tally = Evaluation(), _Tally()
        for scene in scenes:
            _judge(scene, params, tally, out)
        tally.put(name, out.figures)
        return out

    return Case(evaluate)


def load() -> dict[str, Case]:
    """Render and read all pairs: a case for each preset on each kind, and for the other methods."""
    cases = {}
    simulated = simulated_scenes()
    for kind, scenes in (("simulated", simulated), ("path-traced", path_traced_scenes())):
        for preset in _PRESETS:
            cases[f"{preset}, {kind}"] = _case(f"{preset}, {kind}", Params.preset(preset), scenes)
    for name, (preset, changes) in _RUNGS.items():
        params = Params.preset(preset).replace(changes)
        cases[f"{name}, simulated"] = _case(f"{name}, simulated", params, simulated[:_RUNG_SCENES])
    return cases
