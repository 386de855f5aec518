"""Motion without a model beside the simulator's truth, and through simulated images."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import pytest

import gelstereo as gs
from gelstereo import MotionKind, MotionSource, MotionStatus
from gelstereo.geometry import se3_exp, se3_log

Array = npt.NDArray[np.float64]

SIGMA_MM = np.array([0.0015, 0.0015, 0.005])


def about(centre: Array, turn: Array, shift: Array) -> Array:
    there, back = np.eye(4), np.eye(4)
    there[:3, 3], back[:3, 3] = centre, -centre
    return np.asarray(there @ se3_exp(np.concatenate([turn, shift])) @ back)


def error(motion: gs.Motion, truth: Array) -> tuple[float, float, float]:
    """Degrees, millimetres, and the squared error normalised by the covariance, over its 6 components."""
    to = np.eye(4)
    to[:3, 3] = -motion.about_mm
    off = se3_log(to @ truth @ np.linalg.inv(motion.pose) @ np.linalg.inv(to))
    squared = float(off @ np.linalg.solve(motion.covariance, off)) / 6.0
    return float(np.degrees(np.linalg.norm(off[:3]))), float(np.linalg.norm(off[3:])), squared


def follow(indenter: dict[str, object], start: Array, depth_mm: float, moves: list[Array]) -> list[gs.Motion]:
    """The motion of a part that is pressed and then moved, from true markers in contact with noise."""
    scene = gs.Scene().replace(indenter=indenter, effects={"elastic_layer": {"friction": 1.5}})
    simulator, random = gs.Simulator(scene), np.random.default_rng(2)
    rest = simulator.advance(None, frame=0).points_mm
    tracker = gs.MotionTracker(gs.RestSurface(rest), gs.Params(), cols=25)
    covariance = np.tile(np.diag(SIGMA_MM**2), (len(rest), 1, 1))
    pose = np.asarray(simulator.pressed(start, depth_mm))
    found = []
    for index, move in enumerate([np.eye(4), *moves], 1):
        pose = move @ pose
        frame = simulator.advance(pose, frame=index)
        assert frame.loads is not None
        patch = [bool(stick != gs.Stick.FREE) for stick in frame.loads.stick]
        points = frame.points_mm + SIGMA_MM * random.normal(size=rest.shape)
        motion = tracker.run(points, covariance, patch)
        assert motion is not None
        found.append(motion)
    return found


def lying_peg(x_mm: float) -> Array:
    pose = about(np.zeros(3), np.array([np.pi / 2, 0.0, 0.0]), np.zeros(3))
    pose[:3, 3] = x_mm, 0.0, 40.0
    return pose


def test_a_peg_that_rolls_half_a_turn_is_followed() -> None:
    """0.5 degrees a turn is the aim. All markers of the first contact leave it."""
    radius_mm, count = 4.0, 60
    peg = {"kind": "cylinder", "radius_mm": radius_mm, "length_mm": 30.0}
    spin = np.array([0.0, np.pi / count, 0.0])
    scene = gs.Scene().replace(indenter=peg, effects={"elastic_layer": {}})
    centre = np.asarray(gs.Simulator(scene).pressed(lying_peg(-3.0), 0.8))[:3, 3]
    up = np.array([0.0, 0.0, radius_mm])
    moves, truth = [], [np.eye(4)]
    for _ in range(count):
        moves.append(about(centre - up, spin, np.zeros(3)))
        centre = (moves[-1] @ [*centre, 1.0])[:3]
        truth.append(moves[-1] @ truth[-1])
    found = follow(peg, lying_peg(-3.0), 0.8, moves)
    degrees, mm, squared = error(found[-1], truth[-1])
    assert degrees < 0.5 and mm < 0.05 and squared < 4.0, (degrees, mm, squared)
    assert found[-1].keyframe > 3 and found[-1].kind == MotionKind.ROLLS
    assert all(motion.status != MotionStatus.PREDICTED for motion in found)


def test_a_plate_that_is_twisted_is_followed() -> None:
    plate = {"kind": "box", "size_mm": [8.0, 6.0, 6.0]}
    start = np.eye(4)
    start[:3, 3] = 4.0, 0.0, 40.0
    twist = about(np.array([4.0, 0.0, 40.0]), np.array([0.0, 0.0, 0.01]), np.zeros(3))
    found = follow(plate, start, 0.4, [twist] * 6)
    assert found[0].status == MotionStatus.STARTED and np.array_equal(found[0].pose, np.eye(4))
    for index, motion in enumerate(found[1:], 1):
        degrees, mm, squared = error(motion, np.linalg.matrix_power(twist, index))
        assert degrees < 0.15 and mm < 0.01 and squared < 4.0, (index, degrees, mm, squared)
        assert (motion.status, motion.determined) == (MotionStatus.TRACKED, 6)
        assert motion.kind == MotionKind.RESTS and motion.source in (MotionSource.MARKERS, MotionSource.BOTH)
        step = np.degrees(np.linalg.norm(se3_log(motion.step @ np.linalg.inv(twist))[:3]))
        assert step < 0.2


def test_a_pose_after_keyframes_is_their_product() -> None:
    """Independent of the core: a pose is the motion since the keyframe after the keyframe's pose."""
    peg = {"kind": "cylinder", "radius_mm": 3.0, "length_mm": 30.0}
    roll = np.array([0.0, 0.06, 0.0])
    moves, centre = [], np.array([-3.0, 0.0, 31.0])
    for _ in range(20):
        moves.append(about(centre - [0.0, 0.0, 3.0], roll, np.zeros(3)))
        centre = (moves[-1] @ [*centre, 1.0])[:3]
    found = follow(peg, lying_peg(-3.0), 0.7, moves)
    for before, after in itertools.pairwise(found):
        np.testing.assert_allclose(after.step @ before.pose, after.pose, atol=1e-12)
        if after.keyframe > before.keyframe:
            np.testing.assert_allclose(after.keyframe_pose, before.pose, atol=1e-12)
            continue
        assert np.array_equal(after.keyframe_pose, before.keyframe_pose)
    assert found[-1].keyframe > 1
    # Uncertainty grows along the chain.
    sigma = [np.sqrt(motion.covariance[1, 1]) for motion in found[1:]]
    assert sigma[-1] > 1.5 * sigma[0]


@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_frames_of_a_pipeline_are_followed(layout: str) -> None:
    scene = gs.Scene().replace(
        gel={"layout": layout},
        indenter={"kind": "sphere", "radius_mm": 6.0},
        effects={"elastic_layer": {"friction": 20.0}, "sensor_noise": {}},
    )
    sensor = gs.Simulator(scene)
    params = gs.Params.preset("balanced").replace({"lattice.layout": layout})
    pipeline = gs.Pipeline(scene.rig, params)
    image = sensor[0]
    rest = pipeline.process(image.left, image.right)
    tracker = gs.MotionTracker(gs.RestSurface(rest.points_mm), params, cols=rest.cols)
    assert tracker.process(rest) is None
    pose = np.eye(4)
    pose[:3, 3] = 4.0, 0.0, 40.0
    pose = np.asarray(sensor.pressed(pose, 0.9))
    motion = None
    for index in range(8):
        dragged = pose.copy()
        dragged[0, 3] += 0.02 * index
        frame = sensor.advance(dragged, frame=index + 1)
        motion = tracker.process(pipeline.process(frame.left, frame.right))
    assert motion is not None and motion.status == MotionStatus.TRACKED and motion.kind == MotionKind.RESTS
    _, mm, squared = error(motion, about(np.zeros(3), np.zeros(3), np.array([0.14, 0.0, 0.0])))
    assert mm < 0.01 and squared < 4.0
    assert repr(motion) == f"<PartMotion: TRACKED, RESTS, keyframe 0, {motion.stuck} markers stick>"
    assert motion.slip.status == gs.SlipStatus.STUCK and motion.contact == 0
    tracker.restart()
    again = tracker.process(pipeline.process(frame.left, frame.right))
    assert again is not None and again.status == MotionStatus.STARTED and again.contact == 1


def test_settings_and_lists_are_checked() -> None:
    x, y = np.meshgrid(np.arange(9) * 0.9, np.arange(9) * 0.9)
    rest = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 30.0)])
    with pytest.raises(gs.ContactError, match="81 markers do not fill rows of 7"):
        gs.MotionTracker(gs.RestSurface(rest), gs.Params(), cols=7)
    with pytest.raises(gs.ParamsError, match=r"motion\.keyframe_share is 1; valid is 0 to 0.999"):
        gs.Params().replace(motion={"keyframe_share": 1.0})
    tracker = gs.MotionTracker(gs.RestSurface(rest), gs.Params(), cols=9)
    assert repr(tracker) == "<MotionTracker: 81 markers>"
    covariance = np.tile(np.diag(SIGMA_MM**2), (81, 1, 1))
    with pytest.raises(gs.ContactError, match="a list has 80 entries"):
        tracker.run(rest[1:], covariance, [True] * 81)
    assert tracker.run(rest, covariance, [False] * 81) is None
    for names, kind in (
        (gs._native.motion_statuses(), MotionStatus),
        (gs._native.motion_sources(), MotionSource),
        (gs._native.motion_kinds(), MotionKind),
    ):
        assert names == {value.name: value.value for value in kind}


def test_keyframes_are_those_of_the_frames_until_a_loop_is_closed() -> None:
    """Rolled there and back: keyframes have the poses of their frames, with covariances that are positive."""
    peg = {"kind": "cylinder", "radius_mm": 3.0, "length_mm": 30.0}
    moves, centre = [], np.array([-3.0, 0.0, 31.0])
    for step in range(40):
        turn = np.array([0.0, 0.06 if step < 20 else -0.06, 0.0])
        moves.append(about(centre - [0.0, 0.0, 3.0], turn, np.zeros(3)))
        centre = (moves[-1] @ [*centre, 1.0])[:3]
    scene = gs.Scene().replace(indenter=peg, effects={"elastic_layer": {"friction": 1.5}})
    simulator, random = gs.Simulator(scene), np.random.default_rng(2)
    rest = simulator.advance(None, frame=0).points_mm
    tracker = gs.MotionTracker(gs.RestSurface(rest), gs.Params(), cols=25)
    covariance = np.tile(np.diag(SIGMA_MM**2), (len(rest), 1, 1))
    pose, loops, poses = np.asarray(simulator.pressed(lying_peg(-3.0), 0.9)), 0, {}
    assert tracker.keyframes()[1].shape == (0, 4, 4)
    for index, move in enumerate([np.eye(4), *moves], 1):
        pose = move @ pose
        frame = simulator.advance(pose, frame=index)
        assert frame.loads is not None
        points = frame.points_mm + SIGMA_MM * random.normal(size=rest.shape)
        motion = tracker.run(points, covariance, [bool(s) for s in frame.loads.stick])
        assert motion is not None
        poses.setdefault(motion.keyframe, motion.keyframe_pose)
        numbers, found, covariances, about_mm = tracker.keyframes()
        assert numbers[-1] == motion.keyframe and np.all(np.diff(numbers) > 0)
        # The keyframe of this frame has its corrected pose.
        np.testing.assert_allclose(found[-1], motion.keyframe_pose, atol=1e-9)
        if motion.loops == 0:
            np.testing.assert_allclose(found, [poses[n] for n in numbers], atol=1e-9)
        assert covariances.shape == (len(numbers), 6, 6) and about_mm.shape == (len(numbers), 3)
        assert all(np.linalg.eigvalsh(c)[0] > -1e-12 for c in covariances)
        loops = motion.loops
    assert loops > 0 and motion.keyframe > 1
