"""Recordings of a real stereo-marker sensor, from the wheel pytac3d."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelstereo import (
    MotionKind,
    MotionTracker,
    Params,
    RestSurface,
    SlipStatus,
    SlipTracker,
    pressure_saliency,
)
from gelstereo.recordings import (
    CloudRecording,
    RecordingError,
    contacts,
    episodes,
    fit_cylinder,
    fit_plane,
    fit_sphere,
    load_pytac3d,
    pytac3d_example,
)
from gelstereo_bench.reports.radii import Sharpened, sharpen, vendor_radii_mm
from gelstereo_bench.reports.recordings import (
    PARTS,
    SALIENCY_MM,
    Part,
    measure_part,
    register_part,
    steadiness,
    touching,
)

needs_wheel = pytest.mark.skipif(
    find_spec("PyTac3D") is None,
    reason="the wheel pytac3d is absent (pip install --no-deps pytac3d==3.3.0.9)",
)


def example_folder() -> Path:
    return pytac3d_example("example_1", "AD2-0065L")


@pytest.fixture(scope="module")
def recording() -> CloudRecording:
    return load_pytac3d(example_folder())


@pytest.fixture(scope="module")
def sharpened(recording: CloudRecording) -> Sharpened:
    return sharpen(recording, SALIENCY_MM)


@needs_wheel
def test_recording_is_what_its_description_says(recording: CloudRecording) -> None:
    assert (len(recording), recording.rows, recording.cols) == (252, 20, 20)
    assert recording.pitch_mm == pytest.approx(1.0, abs=0.01)
    assert 25.0 < 1.0 / np.median(np.diff(recording.time_s)) < 35.0


@needs_wheel
def test_contact_is_found_in_the_pressed_episodes_and_nowhere_else(recording: CloudRecording) -> None:
    indentation = recording.indentation_mm()
    runs = episodes(indentation, SALIENCY_MM)
    # Pressed frames by the data's description, touch growing and fading at the ends.
    for run, (first, last) in zip(runs, [(22, 80), (105, 135), (170, 212)], strict=True):
        assert abs(run.start - first) <= 2 and abs(run.stop - 1 - last) <= 2
    salient = (indentation > SALIENCY_MM).sum(axis=1)
    firm = np.concatenate([salient[30:80], salient[112:132], salient[176:210]])
    assert firm.min() >= 40 and firm.max() <= 100
    untouched = np.ones(len(recording), bool)
    untouched[np.concatenate([np.arange(run.start, run.stop) for run in runs])] = False
    assert not salient[untouched].any()


@needs_wheel
def test_contacts_are_counted(recording: CloudRecording) -> None:
    found = touching(recording)
    assert [len(found[frame]) for frame in (40, 120, 190, 95, 150)] == [2, 1, 1, 0, 0]


@needs_wheel
@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_template_registers_to_its_episode(sharpened: Sharpened, part: Part) -> None:
    frames = register_part(sharpened.sharp, part, every=3, whole=sharpened.whole)
    assert len(frames) >= 8
    assert all(f.result.converged for f in frames)
    assert {len(f.result.free) for f in frames} == {part.free}
    residual_mm = np.array([f.residual_mm for f in frames])
    # Rest noise is 3 um; what is above it is the gel's shoulder and the unknown part. Most frames stay within
    # ten times the noise, none leaves a tenth of a millimetre.
    assert np.median(residual_mm) < 0.03
    assert residual_mm.max() < 0.1


@needs_wheel
def test_recorder_smooths_over_four_frames_and_lost_two(sharpened: Sharpened) -> None:
    assert sharpened.window == 4
    assert np.flatnonzero(sharpened.smooth.lost_before).tolist() == [7, 127]
    # The data's description: 0.6 um across, 2.9 um along, which includes no share lost to creep.
    np.testing.assert_allclose(1e3 * sharpened.noise_mm, [0.7, 0.7, 3.4], rtol=0.15)


@needs_wheel
@pytest.mark.parametrize("part", PARTS[:3], ids=lambda part: part.name)
def test_one_radius_through_all_frames_is_the_template_s(sharpened: Sharpened, part: Part) -> None:
    measured = measure_part(sharpened, part)
    assert measured.joint.converged and all(fit.converged for fit in measured.sharp)
    assert part.radius_mm is not None
    assert measured.joint.radius_mm == pytest.approx(part.radius_mm, abs=0.01)
    assert measured.joint.sigma_mm < measured.sigma_mm < 0.3


@needs_wheel
@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
def test_cylinder_wanders_less_than_by_the_vendor(sharpened: Sharpened) -> None:
    pytest.importorskip("cv2")
    measured = measure_part(sharpened, PARTS[2])
    vendor = vendor_radii_mm(sharpened.smooth, example_folder(), "cylinder")
    theirs = np.array([vendor[frame][0] for frame in measured.frames])
    ours = np.array([fit.radius_mm for fit in measured.sharp])
    smooth = np.array([fit.radius_mm for fit in measured.smooth])
    assert ours.std() < 0.5 * theirs.std()
    assert ours.std() < 0.5 * smooth.std()
    assert theirs.min() > 4.2 and theirs.max() < 7.0
    assert np.ptp(ours) < 0.5 * np.ptp(theirs)


@needs_wheel
@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_poses_scatter_by_the_noise_as_predicted(sharpened: Sharpened, part: Part) -> None:
    by_noise, over_time, motion_mm = steadiness(sharpened, part)
    assert by_noise.frames >= 50
    # Means over four frames leave 14 independent ones, by three directions: 11 %, three of that.
    assert by_noise.ratio == pytest.approx(1.0, abs=0.33)
    # A hand moves the part; the scatter over time is that, not noise.
    assert motion_mm > 0.01
    assert over_time.ratio > 2.0 * by_noise.ratio


@needs_wheel
def test_two_balls_have_two_radii_in_every_frame(sharpened: Sharpened) -> None:
    small, large = (measure_part(sharpened, part) for part in PARTS[:2])
    large_by_frame = dict(zip(large.frames, large.sharp, strict=True))
    both = [
        (fit, large_by_frame[f])
        for f, fit in zip(small.frames, small.sharp, strict=True)
        if f in large_by_frame
    ]
    assert len(both) >= 50
    assert all(b.radius_mm > 1.5 * a.radius_mm for a, b in both)


@needs_wheel
@pytest.mark.parametrize("sensor", ["HDL1-GWH0021", "HDL1-GWH0022"])
def test_both_fingers_of_a_grasp_touch_in_every_frame(sensor: str) -> None:
    grasp = load_pytac3d(pytac3d_example("example_2", sensor))
    assert grasp.pitch_mm == pytest.approx(1.09, abs=0.02)
    assert episodes(grasp.indentation_mm(), SALIENCY_MM) == [range(len(grasp))]
    assert all(len(found) >= 1 for found in touching(grasp))


def run(tracker: SlipTracker | MotionTracker, sharpened: Sharpened, frames: range) -> list[Any]:
    """Answers in the frames with contact, with the noise of the rest frames; the patch is from heights."""
    recording = sharpened.sharp
    rest, count = RestSurface(recording.rest_mm), len(recording.rest_mm)
    # Sharpening raises the noise to 1.4 times.
    sigma_mm = np.sqrt(2.0) * np.asarray(sharpened.noise_mm)
    covariance, variance = np.tile(np.diag(sigma_mm**2), (count, 1, 1)), np.full(count, sigma_mm[2] ** 2)
    decay_mm = Params().to_dict()["contact"]["decay_mm"]
    found = []
    for points in recording.points_mm[frames.start : frames.stop]:
        heights = rest.indentation_mm(points)
        patch, _ = pressure_saliency(rest, heights, variance, rows=20, cols=20, decay_mm=decay_mm)
        answer = tracker.run(points, covariance, patch.tolist())
        found.append(answer[1] if isinstance(answer, tuple) else answer)
    return [answer for answer in found if answer is not None]


def strained(strain_sigma_mm: float = 0.0, strain_share: float = 0.0) -> Params:
    slip = {"method": "rigid", "strain_sigma_mm": strain_sigma_mm, "strain_share": strain_share}
    return Params().replace(slip=slip)


def slip_statuses(
    sharpened: Sharpened, frames: range, strain_sigma_mm: float = 0.0, strain_share: float = 0.0
) -> list[SlipStatus]:
    rest = RestSurface(sharpened.sharp.rest_mm)
    tracker = SlipTracker(rest, strained(strain_sigma_mm, strain_share), cols=sharpened.sharp.cols)
    return [SlipStatus(slip.status) for slip in run(tracker, sharpened, frames)]


@needs_wheel
def test_a_rolling_cylinder_is_no_gross_slip(sharpened: Sharpened) -> None:
    """Nor is a face that is pressed. The sensor needs `slip.strain_sigma_mm`: noise at rest does not tell how
    far markers are from rigid motion, and by it alone both are gross slips.
    """
    for frames in (range(100, 140), range(165, 216)):
        by_noise = slip_statuses(sharpened, frames)
        assert len(by_noise) > 30 and by_noise.count(SlipStatus.GROSS) > 0.8 * len(by_noise)
        found = slip_statuses(sharpened, frames, 0.03)
        assert SlipStatus.GROSS not in found
        assert found.count(SlipStatus.STUCK) > 0.7 * len(found)
        # A deviation that grows with the depth is enough, and hides less slip of simulated parts.
        assert SlipStatus.GROSS not in slip_statuses(sharpened, frames, strain_share=0.06)


@needs_wheel
@pytest.mark.parametrize("strain_share", [0.04, 0.06])
def test_a_rolling_cylinder_rolls(sharpened: Sharpened, strain_share: float) -> None:
    rest = RestSurface(sharpened.sharp.rest_mm)
    tracker = MotionTracker(rest, strained(strain_share=strain_share), cols=sharpened.sharp.cols)
    kinds = [MotionKind(motion.kind) for motion in run(tracker, sharpened, range(100, 140))]
    assert kinds.count(MotionKind.ROLLS) > 0.8 * len(kinds)
    assert not {MotionKind.SLIDES, MotionKind.ROLLS_AND_SLIDES} & set(kinds)


@needs_wheel
def test_unknown_recording_names_those_there_are() -> None:
    with pytest.raises(RecordingError, match="example_1/AD2-0065L"):
        pytac3d_example("example_1", "nobody")


def test_folder_without_arrays_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no 3D_Positions\.npy"):
        load_pytac3d(tmp_path)
    for name in ("3D_Positions", "3D_Displacements"):
        np.save(tmp_path / f"{name}.npy", np.zeros((3, 7, 3)))
    np.save(tmp_path / "sendTimestamp.npy", np.arange(3.0))
    with pytest.raises(RecordingError, match=r"valid is \(frames, 400, 3\)"):
        load_pytac3d(tmp_path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"time_s": np.array([0.0, 2.0, 1.0])}, "time runs backwards at frame 2"),
        ({"time_s": np.zeros(2)}, "2 times for 3 frames"),
        ({"rest_mm": np.zeros((5, 3))}, "rest frame has shape"),
        ({"rest_mm": np.full((4, 3), np.nan)}, "rest frame contain NaN"),
    ],
)
def test_contradicting_arrays_are_refused(change: dict[str, np.ndarray], words: str) -> None:
    arrays = {
        "points_mm": np.zeros((3, 4, 3)),
        "rest_mm": np.zeros((4, 3)),
        "time_s": np.arange(3.0),
    } | change
    with pytest.raises(RecordingError, match=words):
        CloudRecording("made up", 2, 2, **arrays)


RADII = st.floats(1.0, 20.0)
SEEDS = st.integers(0, 2**32 - 1)


@given(RADII, SEEDS)
def test_sphere_fit_finds_exact_spheres(radius_mm: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    directions = random.normal(size=(30, 3)) * [0.5, 0.5, 0.1] - [0.0, 0.0, 1.0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    centre = random.uniform(-20.0, 20.0, 3)
    fit = fit_sphere(centre + radius_mm * directions)
    assert fit.radius_mm == pytest.approx(radius_mm, rel=1e-6)
    np.testing.assert_allclose(fit.centre_mm, centre, atol=1e-5)


@given(RADII, SEEDS)
def test_cylinder_fit_finds_exact_cylinders(radius_mm: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    angle = random.uniform(-0.8, 0.8, 60)
    along = random.uniform(-3.0, 3.0, 60) * radius_mm
    local = np.column_stack([along, radius_mm * np.sin(angle), -radius_mm * np.cos(angle)])
    yaw, tilt = random.uniform(-np.pi, np.pi), random.uniform(-0.3, 0.3)
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    fit = fit_cylinder(local @ (about_z @ about_y).T)
    assert fit.radius_mm == pytest.approx(radius_mm, rel=1e-6)
    assert abs(fit.axis @ (about_z @ about_y)[:, 0]) == pytest.approx(1.0, abs=1e-9)


def test_plane_fit_faces_the_camera_and_few_points_are_refused() -> None:
    x, y = np.random.default_rng(3).uniform(-5.0, 5.0, (2, 40))
    fit = fit_plane(np.column_stack([x, y, 20.0 + 0.1 * x]))
    assert fit.rms_mm < 1e-12
    np.testing.assert_allclose(fit.normal, np.array([0.1, 0.0, -1.0]) / np.hypot(0.1, 1.0), atol=1e-12)
    with pytest.raises(RecordingError, match="3 points for a sphere; at least 4"):
        fit_sphere(np.eye(3))


def test_watershed_splits_two_bumps_and_keeps_a_rough_one_whole() -> None:
    row, col = np.mgrid[0:20, 0:20]

    def bump(r: float, c: float, height: float) -> np.ndarray:
        return height * np.exp(-((row - r) ** 2 + (col - c) ** 2) / 8.0)

    two = contacts((bump(5, 5, 1.0) + bump(13, 13, 0.7)).ravel(), 20, 20, 0.2)
    assert [round(contact.depth_mm, 1) for contact in two] == [1.0, 0.7]
    assert not set(two[0].salient) & set(two[1].salient)
    assert 5 * 20 + 5 in two[0].core and 13 * 20 + 13 in two[1].core
    rough = 1.0 + np.random.default_rng(1).uniform(-0.05, 0.05, (20, 20))
    assert len(contacts(rough.ravel(), 20, 20, 0.35)) == 1
    assert contacts(np.zeros(400), 20, 20, 0.35) == []
