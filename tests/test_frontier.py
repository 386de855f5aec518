"""The harness that measures every rung of every ladder."""

from __future__ import annotations

import importlib
import os
import re
import shutil
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import numpy.typing as npt
import pytest

import gelstereo
from gelstereo.cli import main
from gelstereo.geometry import se3_exp
from gelstereo_bench.frontier.baseline_fast import FastBaseline
from gelstereo_bench.frontier.covariance import Calibration
from gelstereo_bench.frontier.grasps import GRASPED
from gelstereo_bench.frontier.localization import measure_localization
from gelstereo_bench.frontier.nearest import PARTS as NEAREST_PARTS
from gelstereo_bench.frontier.nearest import SAMPLES, SCIPY, methods, points_around
from gelstereo_bench.frontier.page import SECTIONS, check_page, write_page
from gelstereo_bench.frontier.registering import Patch, observable_error_mm
from gelstereo_bench.frontier.rivals import Apart, rivals
from gelstereo_bench.frontier.rungs import RUNGS, rungs_of
from gelstereo_bench.frontier.runners import geometry_of, write_input
from gelstereo_bench.frontier.saliency import Score
from gelstereo_bench.frontier.scenes import BOARDS_MM, FORMATS, LATTICES, PARTS, VGA, Part, sphere_press
from gelstereo_bench.frontier.sequences import SEQUENCES
from gelstereo_bench.frontier.speed import BASELINE, Growth, Speed, speed_targets
from gelstereo_bench.frontier.table import Table, Target
from gelstereo_bench.frontier.timing import InstructionCounter, Stopwatch, Times, time_side_by_side
from gelstereo_bench.frontier.tracking import Named, score
from gelstereo_bench.reports.markdown import ReportError, replace_between, table

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def docs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page as the quick run writes it."""
    folder = tmp_path_factory.mktemp("docs")
    shutil.copy(ROOT / "docs" / "accuracy-vs-time.md", folder)
    assert main(["frontier", "--quick", "--docs", str(folder)]) == 0
    return folder


def section(page: str, name: str) -> list[list[str]]:
    """Cells of the table between a section's markers, without its head."""
    text = re.search(rf"<!-- begin {name} -->\n(.*?)<!-- end {name} -->", page, re.DOTALL)
    assert text is not None
    return [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text[1].strip().splitlines()[2:]
    ]


@pytest.mark.long
def test_quick_run_lists_every_rung_beside_a_baseline(docs: Path) -> None:
    page = (docs / "accuracy-vs-time.md").read_text()
    assert all(section(page, name) for name in SECTIONS if name not in ("conditions", "stages", "growth"))
    for stage in ("detect", "label", "register", "whole"):
        rows = section(page, stage)
        names = [row[0] for row in rows]
        assert names[: len(rungs_of(stage))] == [rung.name for rung in rungs_of(stage)]  # type: ignore[arg-type]
        assert sum("(baseline)" in name for name in names) == 1
        assert next(row[-1] for row in rows if "(baseline)" in row[0]) == "1.0"
        assert all(float(row[2]) > 0.0 and float(row[3]) >= float(row[2]) for row in rows)
    assert "simulated" in re.search(r"begin conditions -->\n(.*)\n", page)[1]  # type: ignore[index]
    picture = docs / "pictures" / "accuracy-vs-time.png"
    assert picture.stat().st_size > 20_000


def test_a_page_that_does_not_exist_is_begun(tmp_path: Path) -> None:
    page = tmp_path / "accuracy-vs-time.md"
    check_page(page)
    write_page(page, [Table("boards", ["mm", "um"], [["0.4", "1"]])], [Target("x", 2.0, 3.0, "mm")], 3)
    assert "| 0.4 | 1 |" in page.read_text()
    assert "| x | <= 2 mm | 3.00 mm | **no** |" in page.read_text()


def test_a_page_without_room_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    (tmp_path / "accuracy-vs-time.md").write_text("<!-- begin boards -->\n<!-- end boards -->\n")
    with pytest.raises(ReportError, match="begin targets") as refused:
        check_page(tmp_path / "accuracy-vs-time.md")
    assert "boards" not in str(refused.value)


def test_a_page_is_never_half_written(tmp_path: Path) -> None:
    page = tmp_path / "accuracy-vs-time.md"
    check_page(page)
    before = page.read_text()
    tables = [Table("boards", ["mm"], [["1"]]), Table("no such section", ["mm"], [["1"]])]
    with pytest.raises(ReportError):
        write_page(page, tables, [], 3)
    assert page.read_text() == before
    assert [path.name for path in tmp_path.iterdir()] == [page.name]


def test_a_count_of_rounds_below_one_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--rounds", "0"], ["--starts", "-1"], ["--starts", "many"]):
        with pytest.raises(SystemExit) as stopped:
            main(["frontier", *words])
        assert stopped.value.code == 2
        assert "valid is an integer of 1 or more" in capsys.readouterr().err


@pytest.mark.long
def test_quick_run_measures_the_papers_boards_within_its_bound(docs: Path) -> None:
    rows = section((docs / "accuracy-vs-time.md").read_text(), "boards")
    assert [float(row[0]) for row in rows] == list(BOARDS_MM)
    for row in rows:
        for cell in row[1:]:
            assert abs(float(cell.split()[0])) < 60.0, row


@pytest.mark.parametrize(
    ("stage", "ladder"),
    [
        ("detect", "detect.background"),
        ("detect", "detect.centre"),
        ("detect", "detect.threshold"),
        ("whole", "detect.search"),
        ("label", "label.method"),
        ("points", "triangulate.method"),
        ("contact", "contact.saliency"),
        ("register", "register.method"),
    ],
)
def test_every_variant_of_every_ladder_is_measured(stage: str, ladder: str) -> None:
    group, name = ladder.split(".")
    with pytest.raises(gelstereo.ParamsError) as error:
        gelstereo.Params().replace({group: {name: "no such rung"}})
    variants = set(re.findall(r"`(\w+)`", str(error.value).split("expected", 1)[1]))
    assert len(variants) >= 2
    measured = {rung.params().to_dict()[group][name] for rung in RUNGS if rung.stage == stage}
    assert measured == variants, "add the missing rung to gelstereo/frontier/rungs.py"


def test_every_preset_is_measured() -> None:
    assert {rung.preset for rung in rungs_of("whole")} == set(gelstereo.Params.presets())


def test_squared_errors_of_right_covariances_lie_in_their_band() -> None:
    random = np.random.default_rng(20211)
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    errors = random.multivariate_normal([0.0, 0.0], covariance, 20_000)
    covariances = np.broadcast_to(covariance, (20_000, 2, 2))
    right = Calibration.of(errors, covariances, 1)
    assert right.calibrated and right.inside == pytest.approx(0.95, abs=0.005)
    # Half the variance, twice the squared error.
    promises = Calibration.of(errors, 0.5 * covariances, 1)
    assert promises.mean == pytest.approx(2.0 * right.mean) and not promises.calibrated
    # Of five alike, one counts: the band is wider by the root of five.
    few = Calibration.of(errors, covariances, 5)
    width = (few.band[1] - few.band[0]) / (right.band[1] - right.band[0])
    assert width == pytest.approx(np.sqrt(5.0), rel=0.01)


def test_f1_is_the_harmonic_mean_of_precision_and_recall_of_all_frames_together() -> None:
    truth = np.array([True, True, False, False])

    def f1(*frames: tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]) -> float:
        score = Score()
        for found, true in frames:
            score.add(found, true)
        return score.f1

    nothing = truth & False
    assert f1((truth, truth)) == 1.0 and f1((~truth, truth)) == 0.0 and f1((nothing, nothing)) == f1() == 1.0
    everything = np.ones(4, bool)
    assert f1((everything, truth)) == pytest.approx(2.0 / (1.0 / 0.5 + 1.0 / 1.0))
    # Two right of four found and of four true; the mean of the frames' own would be a third.
    assert f1((everything, truth), (nothing, truth)) == 0.5


def test_growth_finds_what_times_are_made_of() -> None:
    speeds = []
    for size in FORMATS:
        for markers in LATTICES:
            ms = 0.1 + 2.0 * size.megapixels + 1e-3 * 0.3 * markers**2
            speeds.append(Speed(size, markers, "x", {"track": Times(ms, ms)}))
    growth = Growth.of(speeds, "track")
    assert growth is not None
    found = (growth.base_ms, growth.ns_per_pixel, growth.us_per_marker)
    np.testing.assert_allclose(found, (0.1, 2.0, 0.3), rtol=1e-9)
    assert growth.residual < 1e-9
    assert Growth.of(speeds, "afresh") is None


def truthful(shot):  # type: ignore[no-untyped-def]
    """A method that knows everything, and counts from another corner."""
    turn = np.rot90(np.arange(625).reshape(25, 25)).ravel()
    return Named(shot.left_px[turn], shot.right_px[turn], shot.visible[turn].copy(), 25)


@pytest.mark.parametrize("task", SEQUENCES, ids=lambda task: task.name)
def test_a_truthful_method_has_all_names_right(task) -> None:  # type: ignore[no-untyped-def]
    runs = task.make()
    assert all(0 < run.calm < len(run.shots) for run in runs)
    found = score(task, runs, lambda first: truthful)
    assert found.switched == found.unseen == found.refused == 0
    assert found.right == sum(int(shot.visible.sum()) for run in runs for shot in run.shots)
    assert set(found.reacquired) == {0}


def test_wrong_names_held_markers_and_refusals_are_told_apart() -> None:
    task = SEQUENCES[0]
    runs = task.make()
    frames = len(runs[0].shots)

    def mistaken(shot):  # type: ignore[no-untyped-def]
        named = truthful(shot)
        if shot is runs[0].shots[3]:  # two neighbours change places in one view
            named.right_px[[40, 41]] = named.right_px[[41, 40]]
        if shot is runs[0].shots[5]:
            named.seen[100:110] = False
        if shot is runs[0].shots[-3]:  # the first calm frame
            raise gelstereo.LabelError("too hard")
        return named

    found = score(task, runs, lambda first: mistaken)
    assert (found.switched, found.unseen, found.refused) == (2, 10 + 625, 1)
    assert found.right == 625 * (frames - 1) - 12
    assert found.reacquired == [1]


def test_sequences_are_as_hard_as_they_say() -> None:
    runs = {task.name: task.make() for task in SEQUENCES}
    pitch_px = 0.9 * VGA.rig().left_matrix[0, 0] / 28.7

    def steps(name: str) -> list[float]:
        """Largest motion between frames, in pitches."""
        shots = [run.shots for run in runs[name]]
        pairs = [(a, b) for run in shots for a, b in pairwise(run)]
        return [float(np.linalg.norm(b.left_px - a.left_px, axis=1).max()) / pitch_px for a, b in pairs]

    assert max(steps("jumps of 1.3 pitches")) == pytest.approx(1.3, rel=1e-6)
    assert 0.5 < max(steps("two of three frames dropped")) < 0.7
    first, *rest = (shot.left_px for shot in runs["shear to 2 pitches"][0].shots)
    assert max(np.abs(px - first).max() for px in rest) > 1.95 * pitch_px
    assert runs["20 % not printed"][0].shots[0].visible.sum() == 500
    assert min(shot.visible.sum() for shot in runs["two border rows leave the view"][0].shots) <= 575
    assert len(runs["lattice turned by 0 to 345 deg"]) == 24


@pytest.mark.parametrize("size", FORMATS[:2], ids=lambda size: size.name)
def test_the_fast_baseline_finds_and_follows_all_markers(size) -> None:  # type: ignore[no-untyped-def]
    press = sphere_press(scene=size.scene())
    fast = FastBaseline(geometry_of(size.rig()), gelstereo.Params.preset("balanced").to_dict())
    names = (press[0].left_px, press[0].right_px)
    for frame in press:
        found = fast.process(frame.left, frame.right, names if frame.index == 0 else None)
    assert found.seen.all()
    rms_px = np.sqrt(((found.left_px - press[-1].left_px) ** 2).sum(axis=1).mean())
    assert rms_px < 0.07  # grey centroids: 0.054 and 0.079 px were measured independently
    assert found.salient.sum() > 30


def ball_patch() -> Patch:
    """Points of a ball's cap that faces the camera, exactly where they should be."""
    import trimesh

    part = Part("ball", trimesh.creation.icosphere(5, 5.0), (0.0, 0.0, 0.0))
    truth = se3_exp([0.1, 0.2, -0.3, 4.0, 1.0, 32.0])
    template = part.template()
    points_mm = template.points_mm @ truth[:3, :3].T + truth[:3, 3]
    return Patch(part, template, points_mm[points_mm[:, 2] < points_mm[:, 2].min() + 1.0], truth)


def test_pose_error_ignores_what_a_ball_cannot_tell() -> None:
    patch = ball_patch()
    assert observable_error_mm(patch, patch.t_sensor_object) < 1e-12
    about_centre = np.eye(4)
    about_centre[:3, 3] = patch.t_sensor_object[:3, 3]
    spun = about_centre @ se3_exp([0.02, -0.03, 0.04, 0.0, 0.0, 0.0]) @ np.linalg.inv(about_centre)
    # Turning a ball about its centre moves its surface by the triangles' sagitta only.
    assert observable_error_mm(patch, spun @ patch.t_sensor_object) < 1e-2
    lifted = se3_exp([0.0, 0.0, 0.0, 0.0, 0.0, 0.3]) @ patch.t_sensor_object
    # 0.3 mm along one of three observable directions.
    assert observable_error_mm(patch, lifted) == pytest.approx(0.3 / np.sqrt(3.0), rel=0.02)


def test_starts_are_fixed_and_as_far_off_as_they_say() -> None:
    patch = ball_patch()
    np.testing.assert_array_equal(patch.start(3), patch.start(3))
    centroid = patch.points_mm.mean(axis=0)
    for seed in range(5):
        motion = patch.start(seed) @ np.linalg.inv(patch.t_sensor_object)
        angle = np.arccos((np.trace(motion[:3, :3]) - 1.0) / 2.0)
        assert angle == pytest.approx(np.deg2rad(5.0), rel=1e-6)
        moved = motion[:3, :3] @ centroid + motion[:3, 3] - centroid
        # The translation of exp is V(w) v: within half the rotation angle of 1 mm.
        assert np.linalg.norm(moved) == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_parts_press_enough_markers(part: Part) -> None:
    patch = Patch.simulate(part)
    assert len(patch.points_mm) >= 15


def test_methods_take_turns() -> None:
    seen: list[str] = []
    times = time_side_by_side({name: lambda turn, name=name: seen.append(name) for name in "ab"}, 3)
    assert seen == ["a", "b"] * 5  # two rounds warm up
    assert times["a"].p99_ms >= times["a"].median_ms > 0.0
    turns: list[tuple[str, int]] = []
    time_side_by_side({name: lambda turn, name=name: turns.append((name, turn)) for name in "ab"}, 2, 3)
    assert turns[-12:] == [(name, 3 * turn + k) for turn in range(2) for name in "ab" for k in range(3)]


@pytest.mark.skipif(
    shutil.which("valgrind") is None or shutil.which("cargo") is None, reason="valgrind or cargo is absent"
)
@pytest.mark.long
def test_instructions_are_counted_and_repeat_exactly(tmp_path: Path) -> None:
    counter = InstructionCounter(ROOT)
    assert counter.present
    import cv2

    gelstereo.Params.preset("balanced").save(tmp_path / "params.toml")
    image = np.full((60, 80), 200, np.uint8)
    image[20:25, 30:35] = 40
    cv2.imwrite(str(tmp_path / "image.pgm"), image)
    files = [tmp_path / "params.toml", tmp_path / "image.pgm", tmp_path / "image.pgm"]
    first = counter.count("detect", files)
    assert first is not None and first > 80 * 60
    assert counter.count("detect", files) == first
    assert counter.count("no such stage", files) is None
    assert counter.count_each("no such stage", files) == []
    press = sphere_press()[:3]
    files = write_input(tmp_path, gelstereo.Params.preset("fast"), press, VGA.rig())
    each = counter.count_each("frames", files)
    # Two frames there and two back, twice; the first of them fits the map of points besides.
    assert len(each) == 8 and min(each) > 25 * 25
    assert max(each[1:]) < 1.5 * min(each[1:])
    assert counter.count("frames", files) == sum(each)


@pytest.mark.long
@pytest.mark.skipif(shutil.which("cargo") is None, reason="cargo is absent")
def test_the_cores_program_times_every_stage(tmp_path: Path) -> None:
    program = Stopwatch.program(ROOT)
    assert program is not None
    press = sphere_press()[:3]
    files = write_input(tmp_path, gelstereo.Params.preset("balanced"), press, VGA.rig())
    with Stopwatch(program, files) as watch:
        # At least both views' differences, at most the target of the finished pipeline four times over.
        assert 2 * 640 * 480 < watch.memory_bytes < 64 * 2**20
        for stage in ("track", "afresh", "detect", "triangulate"):
            times = watch.times_ns(stage, 4)
            assert len(times) == 4 and min(times) > 0
        assert watch.times_ns("no such stage", 1) == []
    blank = np.full((480, 640), 170, np.uint8)
    import cv2

    cv2.imwrite(str(files[2]), blank)
    with pytest.raises(gelstereo.Error, match="Left"):
        Stopwatch(program, files)


def test_counter_is_absent_without_sources(tmp_path: Path) -> None:
    counter = InstructionCounter(tmp_path)
    assert not counter.present and counter.count("detect", []) is None


def test_only_the_text_between_markers_changes(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- begin a -->\nold\n<!-- end a -->\nafter\n")
    replace_between(page, "a", table(["x", "y"], [["1", "2"]]))
    text = page.read_text()
    assert text == "before\n<!-- begin a -->\n| x | y |\n| --- | ---: |\n| 1 | 2 |\n<!-- end a -->\nafter\n"
    replace_between(page, "a", table(["x", "y"], [["1", "2"]]))
    assert page.read_text() == text
    with pytest.raises(ReportError, match="must hold the lines <!-- begin b -->"):
        replace_between(page, "b", "")
    with pytest.raises(ReportError, match="does not exist"):
        replace_between(tmp_path / "none.md", "a", "")


def test_all_ways_to_a_distance_agree_on_what_they_measure() -> None:
    for make in NEAREST_PARTS.values():
        mesh = make()
        points = points_around(mesh, 2, 40)
        found = {name: np.abs(way(points)) for name, way in methods(mesh).items()}
        exact = found["trimesh `closest_point`"]
        assert exact.max() <= 1.0 + 1e-12
        for name, distances in found.items():
            # Samples are 0.25 mm apart and the grid's cells as wide; planes end at edges.
            limit = 1e-12 if "closest" in name or "signed" in name else 0.3
            if "plane" not in name:
                assert np.abs(distances - exact).max() < limit, name
        # The two trees are of the same samples, and both are right to some roundings.
        np.testing.assert_allclose(found[SAMPLES], found[SCIPY], rtol=1e-15)


def test_speed_is_judged_by_its_time_and_by_its_ratio_to_opencv() -> None:
    def speed(method: str, track_ms: float) -> Speed:
        return Speed(VGA, 25, method, {"track": Times(track_ms, track_ms), "afresh": Times(2.0, 2.0)})

    targets = {t.what: t for t in speed_targets([speed("preset fast", 0.5), speed(BASELINE, 6.0)])}
    name = "speed, preset fast, 640x480, 25x25, tracking"
    time, ratio = targets[name], targets[f"{name}, speed-up over OpenCV"]
    assert (time.measured, time.limit, time.met) == (0.5, 0.6, True)
    # A machine on which OpenCV is as quick asks for more than half a millisecond.
    assert (ratio.measured, ratio.limit, ratio.met) == (12.0, 13.33, False)
    assert targets["speed, preset fast, 640x480, 25x25, afresh, speed-up over OpenCV"].limit == 5.33


def test_libraries_that_cannot_be_loaded_are_named_and_the_others_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def load(module: str) -> ModuleType:
        if module == "open3d":
            raise OSError("libusb-1.0.so.0: cannot open | shared\nobject file")
        if module == "small_gicp":
            return ModuleType(module)
        raise ModuleNotFoundError(f"No module named {module!r}", name=module.split(".")[0])

    with monkeypatch.context() as patch:
        patch.setattr(importlib, "import_module", load)
        found, missing = rivals()
    assert list(found) == ["small_gicp: GICP"]
    assert missing["MeshLib: ICP on the mesh"] == "meshlib is not installed"
    # The rest of the page is made without any of them, here of one part.
    monkeypatch.setitem(measure_localization.__globals__, "GRASPED", GRASPED[:1])
    monkeypatch.setitem(measure_localization.__globals__, "rivals", lambda: ({}, missing))
    tables, targets = measure_localization(range(1, 2), 1, lambda what: None)
    rows = tables[0].rows
    assert all(len(row) == len(table.head) for table in tables for row in table.rows)
    near = {row[0]: row for row in tables[1].rows}
    assert near["surface_close"][1] == "5 deg, 1 mm"
    budgets = [int(row[0]) for row in tables[2].rows]
    assert gelstereo.Params().to_dict()["register"]["surface_search"]["budget"] in budgets[1:]
    assert len(budgets) > 2 and budgets == sorted(set(budgets), reverse=True)
    names = [row[0] for row in rows]
    assert names[: len(rungs_of("register"))] == [rung.name for rung in rungs_of("register")]
    why = "cannot be loaded: libusb-1.0.so.0: cannot open / shared object file"
    assert f"Open3D: ICP, point to plane, Tukey ({why})" in names
    assert "probreg: FilterReg, point to plane (probreg is not installed)" in names
    assert targets


def test_what_crashes_apart_ends_nothing_else() -> None:
    apart = Apart()
    assert apart.call(abs, -3) == 3
    with pytest.raises(RuntimeError):
        apart.call(os._exit, 1)
    assert apart.call(abs, -4) == 4
