"""Surfaces that come back: rods that roll around, and contacts that are recognized.

`python -m gelstereo_bench.reports.motion` runs it with the other tables of docs/motion.md.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import trimesh

from gelstereo import MotionTracker, Params, PartMotion, RestSurface, Scene, Simulator, Stick
from gelstereo.geometry import se3_exp, se3_log
from gelstereo.part_surface import PartSurface, RecognitionStatus

__all__ = ["PARTS", "RODS", "Frames", "Rolled", "follow", "loop_rows", "profile", "recognition_rows", "roll"]

Array = npt.NDArray[np.float64]
#: True markers, whether each touches, and the part's pose.
Surface = tuple[Array, Array, Array]
Frames = list[tuple[Array, npt.NDArray[np.uint8], Array]]

_SIGMA_MM = np.array([0.0015, 0.0015, 0.005])
_COLS, _FRICTION = 25, 1.5
_LENGTH_MM, _RADIUS_MM = 30.0, 2.5
#: Frames of a full turn, and of all: a tenth of a turn more.
_TURN, _FRAMES = 120, 132
#: Squared error, in variances, of a right answer: 99.99 % of six components.
_RIGHT = 27.9
_GROWN = np.array([np.radians(0.5), 0.05])
RODS = ("cylinder", "oval", "rib", "shaft with a flat")
PARTS = ("ball", "peg", "edge", "rib")


def profile(rod: str, radius_mm: float, count: int = 240) -> Array:
    """(N, 2) outline of a rod, counter-clockwise, mm."""
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    out, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    if rod in ("cylinder", "oval"):
        # A convex outline by its support function h: h n + h' t.
        share = 0.1 * (rod == "oval")
        height, slope = 1.0 + share * np.sin(2.0 * angle), 2.0 * share * np.cos(2.0 * angle)
        return np.asarray(radius_mm * (height * out + slope * along).T)
    # Angles from the rib and from the middle of the flat, one of whose ends is pressed first.
    rib, flat = (np.angle(np.exp(1j * (angle - np.radians(at)))) for at in (250.0, 228.6))
    if rod == "rib":
        far = 1.0 + 0.12 * np.exp(-0.5 * (rib * radius_mm / 0.5) ** 2)
    else:
        far = np.minimum(1.0, 0.75 / np.maximum(np.cos(flat), 1e-9))
    return np.asarray(radius_mm * (far * out).T)


def _extruded(outline: Array) -> trimesh.Trimesh:
    """A rod along z about the origin, with its ends closed by fans."""
    count, half = len(outline), 0.5 * _LENGTH_MM
    rings = [np.column_stack([outline, np.full(count, z)]) for z in (-half, half)]
    points = np.vstack([*rings, [[0.0, 0.0, -half], [0.0, 0.0, half]]])
    one = np.arange(count)
    two, low, high = (one + 1) % count, np.full(count, 2 * count), np.full(count, 2 * count + 1)
    sides = [(one, two, count + two), (one, count + two, count + one)]
    faces = [*sides, (low, two, one), (high, count + one, count + two)]
    return trimesh.Trimesh(points, np.vstack([np.column_stack(face) for face in faces]))


def _simulator(indenter: dict[str, object]) -> Simulator:
    return Simulator(Scene().replace(indenter=indenter, effects={"elastic_layer": {"friction": _FRICTION}}))


def _lying(x_mm: float) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
    pose[:3, 3] = x_mm, 0.0, 40.0
    return pose


def _rod(rod: str, folder: str) -> tuple[Simulator, Array]:
    outline = profile(rod, _RADIUS_MM)
    if rod == "cylinder":
        return _simulator({"kind": "cylinder", "radius_mm": _RADIUS_MM, "length_mm": _LENGTH_MM}), outline
    path = Path(folder) / "rod.stl"
    _extruded(outline).export(path)
    return _simulator({"kind": "mesh", "path": str(path), "units": "mm"}), outline


def _turned(pose: Array, about_mm: Array, turn: Array) -> Array:
    to, back = np.eye(4), np.eye(4)
    to[:3, 3], back[:3, 3] = about_mm, -about_mm
    return np.asarray(to @ se3_exp(np.array([*turn, 0.0, 0.0, 0.0])) @ back @ pose)


def roll(rod: str) -> tuple[Array, Frames]:
    """Markers at rest, and the frames of a rod that rolls 1.1 turns, about its lowest line in each frame."""
    with tempfile.TemporaryDirectory() as folder:
        simulator, outline = _rod(rod, folder)
        around_mm = np.sum(np.linalg.norm(np.diff(outline, axis=0, append=outline[:1]), axis=1))
        pose, corners = _lying(4.0 - 0.55 * around_mm), np.column_stack([outline, np.tile([0, 1], (240, 1))])
        rest, frames = simulator.advance(None, frame=0).points_mm, []
        for index in range(1, _FRAMES + 2):
            pose = np.asarray(simulator.pressed(pose, 0.3 * _RADIUS_MM))
            frame = simulator.advance(pose, frame=index)
            assert frame.loads is not None
            frames.append((frame.points_mm, frame.loads.stick, pose))
            placed = corners @ pose.T
            lowest = placed[np.argmin(placed[:, 2]), :3]
            pose = _turned(pose, lowest, np.array([0.0, 2.0 * np.pi / _TURN, 0.0]))
    return rest, frames


@dataclass(frozen=True)
class Rolled:
    """What was found of a rod that rolled around. Squared errors are in variances, of six components."""

    #: Degrees, after a full turn, as corrected by the last frame; None if its keyframe was forgotten.
    turn: float | None
    #: Squared error of the last pose.
    squared: float
    #: Loops that were closed, and those by which the error grew by half a degree or 0.05 mm.
    loops: int
    false: int


def _error(motion: Array, about_mm: Array, truth: Array) -> Array:
    to = np.eye(4)
    to[:3, 3] = -about_mm
    return np.asarray(se3_log(to @ truth @ np.linalg.inv(motion) @ np.linalg.inv(to)))


def follow(rest_mm: Array, frames: Frames, seed: int, loop_keyframes: int) -> Rolled:
    """Follow a rod from markers with noise in the true contact."""
    random = np.random.default_rng(seed)
    params = Params().replace(motion={"loop_keyframes": loop_keyframes})
    tracker = MotionTracker(RestSurface(rest_mm), params, cols=_COLS)
    covariance = np.tile(np.diag(_SIGMA_MM**2), (len(rest_mm), 1, 1))
    motions: list[PartMotion] = []
    squares: list[float] = []
    false, before = 0, np.zeros(2)
    for points, stick, pose in frames:
        noisy = points + _SIGMA_MM * random.normal(size=rest_mm.shape)
        motion = tracker.run(noisy, covariance, (stick != Stick.FREE).tolist())
        assert motion is not None
        off = _error(motion.pose, motion.about_mm, pose @ np.linalg.inv(frames[0][2]))
        squares.append(float(off @ np.linalg.solve(motion.covariance, off)) if motions else 0.0)
        closed = bool(motions) and motion.loops > motions[-1].loops
        now = np.array([np.linalg.norm(off[:3]), np.linalg.norm(off[3:])])
        false += closed and bool(np.any(now > before + _GROWN))
        before = now
        motions.append(motion)
    at = motions[_TURN]
    known = dict(zip(*tracker.keyframes()[:2], strict=True)) if loop_keyframes else {}
    keyframe_pose = known.get(at.keyframe) if loop_keyframes else at.keyframe_pose
    turn = None
    if keyframe_pose is not None:
        pose = at.pose @ np.linalg.inv(at.keyframe_pose) @ keyframe_pose
        off = _error(pose, at.about_mm, frames[_TURN][2] @ np.linalg.inv(frames[0][2]))
        turn = float(np.degrees(np.linalg.norm(off[:3])))
    return Rolled(turn, squares[-1], motions[-1].loops, false)


def loop_rows(count: int) -> list[list[str]]:
    """Full turns of each rod, without and with loops."""
    rows = []
    for rod in RODS:
        rest, frames = roll(rod)
        row = [rod, str(count)]
        for loop_keyframes in (0, 32):
            found = [follow(rest, frames, seed, loop_keyframes) for seed in range(count)]
            degrees = [each.turn for each in found if each.turn is not None]
            row += [f"{np.median(degrees):.2f}", f"{max(degrees):.2f}"]
            row.append(f"{np.mean([each.squared for each in found]):.0f}")
        rows.append([*row, str(sum(each.loops for each in found)), str(sum(each.false for each in found))])
    return rows


def _pressed(
    simulator: Simulator, start: Array, random: np.random.Generator
) -> tuple[Array, PartSurface, Surface]:
    """A part pressed and rocked: its pose at touch, its grown surface, and that of the first frame."""
    rest = simulator.advance(None, frame=0).points_mm
    tracker = MotionTracker(RestSurface(rest), Params(), cols=_COLS)
    covariance = np.tile(np.diag(_SIGMA_MM**2), (len(rest), 1, 1))
    touch = pose = np.asarray(simulator.pressed(start, 0.8))
    surface, first = PartSurface(), None
    for index in range(1, 6):
        frame = simulator.advance(pose, frame=index)
        assert frame.loads is not None
        points = frame.points_mm + _SIGMA_MM * random.normal(size=rest.shape)
        tracker.run(points, covariance, (frame.loads.stick != Stick.FREE).tolist())
        found = tracker.surface()
        first = first if first is not None and len(first[0]) else found
        surface.add(*found)
        pose = _turned(pose, pose[:3, 3], np.array([0.01, 0.01, 0.0]))
    assert first is not None
    return touch, surface, first


def _part(part: str, folder: str) -> tuple[Simulator, Array]:
    """A part and its pose above the gel."""
    up = np.eye(4)
    up[:3, 3] = 4.0, 0.0, 40.0
    if part == "ball":
        return _simulator({"kind": "sphere", "radius_mm": 4.0}), up
    if part == "peg":
        return _simulator({"kind": "cylinder", "radius_mm": 3.0, "length_mm": 20.0}), _lying(4.0)
    if part == "edge":
        box = _simulator({"kind": "box", "size_mm": [8.0, 8.0, 8.0]})
        return box, _turned(up, up[:3, 3], np.array([0.0, 0.15, 0.0]))
    return _rod("rib", folder)[0], _lying(4.0)


def recognition_rows(count: int) -> list[list[str]]:
    """Contacts of parts that come back, and of other parts, on the surface of an earlier contact."""
    random = np.random.default_rng(4)
    tally = {part: [0, 0, 0, 0] for part in PARTS}
    for _ in range(count):
        known: dict[str, PartSurface] = {}
        seen: dict[str, Surface] = {}
        for part in PARTS:
            with tempfile.TemporaryDirectory() as folder:
                simulator, start = _part(part, folder)
                first, known[part], _ = _pressed(simulator, start, random)
                moved = _turned(start, start[:3, 3], random.normal(size=3) * [0.05, 0.05, 0.1])
                moved[:2, 3] += random.uniform(-1.5, 1.5, 2)
                second, _, seen[part] = _pressed(simulator, moved, random)
            if not (len(known[part]) and len(seen[part][0])):
                continue  # Lines have no normals, and are not recognized.
            truth, middle = second @ np.linalg.inv(first), np.eye(4)
            middle[:3, 3] = seen[part][0].mean(axis=0)
            offset = se3_exp(random.normal(size=6) * [*[0.1] * 3, *[0.5] * 3])
            found = known[part].recognize(*seen[part], guess=middle @ offset @ np.linalg.inv(middle) @ truth)
            if found.status == RecognitionStatus.FOUND:
                off = _error(found.t_contact_part, found.about_mm, truth)
                tally[part][0 if off @ np.linalg.solve(found.covariance, off) < _RIGHT else 1] += 1
        shown = [part for part in PARTS if len(known[part]) and len(seen[part][0])]
        for part in shown:
            for other in (other for other in shown if other != part):
                guess = np.eye(4)
                guess[:3, 3] = seen[other][0].mean(axis=0) - known[part].points_mm.mean(axis=0)
                found = known[part].recognize(*seen[other], guess=guess)
                tally[part][2] += 1
                tally[part][3] += found.status == RecognitionStatus.FOUND
    return [[p, str(count), str(r), str(f), f"{w} of {o}"] for p, (r, f, o, w) in tally.items()]
