"""The pipeline from Python: results against truth, and hard case 34: the same bits on every run
and thread.
"""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from gelstereo import (
    ContactError,
    DetectError,
    Error,
    Frame,
    ImageError,
    MarkerState,
    Params,
    Pipeline,
    RestRecord,
    RestSurface,
    Rig,
    Scene,
    SimulatedFrame,
    TriangulateError,
)

RIG = Scene().rig


def run(frames: list[SimulatedFrame], preset: str = "balanced") -> list[Frame]:
    pipeline = Pipeline(RIG, Params.preset(preset))
    return [pipeline.process(frame.left, frame.right) for frame in frames]


@pytest.mark.parametrize("preset", Params.presets())
def test_points_are_the_truth_within_the_noise(noisy_press: list[SimulatedFrame], preset: str) -> None:
    results = run(noisy_press, preset)
    sigma_px = Params.preset(preset).to_dict()["detect"]["centre_sigma_px"]
    for result, truth in zip(results, noisy_press, strict=True):
        depth_error = result.points_mm[:, 2] - truth.points_mm[:, 2]
        # Two centres of sigma_px each, and 0.184 mm of depth for a pixel; the rms of 625 is known to 3 %.
        assert np.sqrt(np.mean(depth_error**2)) < 1.1 * np.sqrt(2) * sigma_px * 0.184
        assert (result.state == MarkerState.SEEN).all()
    assert [result.index for result in results] == [0, 1, 2, 3, 4]
    assert results[0].motion_px == 0.0
    assert not results[0].salient.any()
    # By pressure only those that the ball touches, some twenty.
    assert results[-1].salient.sum() > 15


def test_the_results_fit_together(noisy_press: list[SimulatedFrame]) -> None:
    pipeline = Pipeline(RIG)
    assert pipeline.rest is None
    rest = pipeline.process(noisy_press[0].left, noisy_press[0].right)
    last = pipeline.process(noisy_press[-1].left, noisy_press[-1].right)
    surface = pipeline.rest
    assert isinstance(surface, RestSurface)
    assert np.array_equal(surface.points_mm, rest.points_mm)
    assert np.array_equal(surface.indentation_mm(last.points_mm), last.indentation_mm)
    assert np.array_equal(last.patch_points_mm, last.points_mm[last.patch])
    assert not (last.patch & ~last.salient).any()
    assert np.array_equal(last.salient, last.indentation_mm > 0.35)
    moved = np.linalg.norm(last.left_px - rest.left_px, axis=1)
    assert last.motion_px == pytest.approx(moved.mean(), rel=1e-12)


def test_reference_and_reset(noisy_press: list[SimulatedFrame]) -> None:
    pipeline = Pipeline(RIG)
    first = pipeline.process(noisy_press[0].left, noisy_press[0].right)
    pressed = pipeline.process(noisy_press[-1].left, noisy_press[-1].right)
    pipeline.mark_reference()
    assert pipeline.process(noisy_press[-1].left, noisy_press[-1].right).motion_px == 0.0
    assert pressed.motion_px > 0.1
    pipeline.reset()
    again = pipeline.process(noisy_press[0].left, noisy_press[0].right)
    assert again.index == 0
    assert again.digest == first.digest


@pytest.mark.parametrize("preset", Params.presets())
def test_row_34_one_thread_or_several_give_the_same_bits(
    noisy_press: list[SimulatedFrame], preset: str
) -> None:
    reference = [frame.digest for frame in run(noisy_press, preset)]
    assert len(set(reference)) == len(reference)
    with ThreadPoolExecutor(4) as pool:
        for digests in pool.map(lambda _: [frame.digest for frame in run(noisy_press, preset)], range(4)):
            assert digests == reference


@pytest.mark.parametrize("preset", Params.presets())
def test_row_34_two_views_on_two_threads_give_the_same_bits(
    noisy_press: list[SimulatedFrame], preset: str
) -> None:
    reference = [frame.digest for frame in run(noisy_press, preset)]
    pipeline = Pipeline(RIG, Params.preset(preset))
    # The number of threads may change from frame to frame.
    threads = (2, 2, 1, 2, 2)
    results = [
        pipeline.process(f.left, f.right, threads=n) for f, n in zip(noisy_press, threads, strict=True)
    ]
    assert [frame.digest for frame in results] == reference
    with pytest.raises(DetectError, match="right view"):
        pipeline.process(noisy_press[0].left, np.zeros_like(noisy_press[0].right), threads=2)
    assert pipeline.process(noisy_press[0].left, noisy_press[0].right, threads=2).index == len(reference)


@pytest.mark.parametrize("threads", [0, 3])
def test_another_number_of_threads_is_refused(noisy_press: list[SimulatedFrame], threads: int) -> None:
    with pytest.raises(ValueError, match=f"threads is {threads}; valid is 1 or 2"):
        Pipeline(RIG).process(noisy_press[0].left, noisy_press[0].right, threads=threads)  # type: ignore[arg-type]


def test_a_frame_is_kept_when_the_next_one_comes(noisy_press: list[SimulatedFrame]) -> None:
    pipeline = Pipeline(RIG)
    first = pipeline.process(noisy_press[0].left, noisy_press[0].right)
    kept = first.points_mm.copy()
    pipeline.process(noisy_press[-1].left, noisy_press[-1].right)
    assert np.array_equal(first.points_mm, kept)
    assert first.points_mm is first.points_mm
    with pytest.raises(ValueError, match="read-only"):
        first.points_mm[0, 0] = 0.0


def test_frames_that_give_nothing_leave_the_tracks_alone(noisy_press: list[SimulatedFrame]) -> None:
    pipeline, undisturbed = Pipeline(RIG), run(noisy_press[:2], "paper")
    left, right = noisy_press[0].left, noisy_press[0].right
    pipeline.process(left, right)
    bad: list[tuple[object, object, type[Error], str]] = [
        (left[:, :320], right, ImageError, r"left image is 320 x 480"),
        (left, np.zeros_like(right), DetectError, "right view"),
        (left.astype(np.float32), right, ImageError, "float32"),
    ]
    for bad_left, bad_right, error, words in bad:
        with pytest.raises(error, match=words):
            pipeline.process(bad_left, bad_right)  # type: ignore[arg-type]
    assert pipeline.process(noisy_press[1].left, noisy_press[1].right).digest == undisturbed[1].digest


def test_row_17_swapped_images_are_refused(noisy_press: list[SimulatedFrame]) -> None:
    with pytest.raises(TriangulateError, match="swapped"):
        Pipeline(RIG).process(noisy_press[0].right, noisy_press[0].left)


def test_a_pipeline_refuses_what_it_cannot_use() -> None:
    with pytest.raises(TypeError):
        Pipeline(Params())  # type: ignore[arg-type]
    assert Pipeline(RIG).rig == RIG
    assert Pipeline(RIG, Params.preset("balanced")).params == Params.preset("balanced")
    assert isinstance(RIG, Rig)


@pytest.mark.parametrize("preset", Params.presets())
def test_a_pipeline_resumes_from_a_stored_rest_frame(
    noisy_press: list[SimulatedFrame], preset: str, tmp_path: Path
) -> None:
    # Where windows lie depends on the frames before, and centres on that by a part of their noise.
    params = Params.preset(preset).replace({"detect": {"search": "whole"}})
    pipeline = Pipeline(RIG, params)
    assert pipeline.rest_record() is None
    frames = [pipeline.process(f.left, f.right) for f in noisy_press]
    record = pipeline.rest_record()
    assert record is not None and record.rig == RIG
    assert (record.rows, record.cols, bool(record.shown.all())) == (25, 25, True)
    assert np.array_equal(record.rest.points_mm, frames[0].points_mm)
    record.save(tmp_path / "rest.toml")
    stored = RestRecord.load(tmp_path / "rest.toml")
    assert stored == record == pickle.loads(pickle.dumps(record))
    restarted = Pipeline(RIG, params)
    restarted.resume(stored)
    last = noisy_press[-1]
    found = restarted.process(last.left, last.right)
    assert (found.index, found.left.labels, found.right.labels) == (1, "lattice", "lattice")
    assert np.array_equal(found.state, frames[-1].state)
    # The polynomial map is good to a micrometre.
    np.testing.assert_allclose(found.indentation_mm, frames[-1].indentation_mm, atol=1e-3)


@pytest.mark.parametrize("view", ["left", "right"])
def test_a_marker_hidden_from_one_view_is_not_shown(noisy_press: list[SimulatedFrame], view: str) -> None:
    frame, marker = noisy_press[0], 312
    images = {"left": frame.left.copy(), "right": frame.right.copy()}
    x, y = np.rint(getattr(frame, f"{view}_px")[marker]).astype(int)
    gel = int(np.median(images[view]))
    images[view][y - 7 : y + 8, x - 7 : x + 8] = gel
    pipeline = Pipeline(RIG)
    pipeline.process(images["left"], images["right"])
    record = pipeline.rest_record()
    assert record is not None
    assert np.flatnonzero(~record.shown).tolist() == [marker]


def test_a_stored_rest_frame_of_another_sensor_is_refused(noisy_press: list[SimulatedFrame]) -> None:
    pipeline = Pipeline(RIG)
    pipeline.process(noisy_press[0].left, noisy_press[0].right)
    record = pipeline.rest_record()
    assert record is not None
    with pytest.raises(ContactError, match=r"other settings of \[lattice\]"):
        Pipeline(RIG, Params.preset("exact")).resume(record)
    other = Rig.from_toml(RIG.to_toml().replace("fx_px = 560", "fx_px = 561"))
    with pytest.raises(ContactError, match="another rig"):
        Pipeline(other).resume(record)
    with pytest.raises(ContactError, match="has 25 rows x 2 columns"):
        RestRecord.from_toml(record.to_toml().replace("cols = 25", "cols = 2", 1))
    with pytest.raises(ContactError, match="line 1"):
        RestRecord.from_toml("rows = -1")
    with pytest.raises(TypeError):
        pipeline.resume("rest.toml")  # type: ignore[arg-type]
