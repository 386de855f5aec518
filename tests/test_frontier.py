"""The harness that measures every rung of every ladder."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import gelstereo
import numpy as np
import pytest
from gelstereo.cli import main
from gelstereo.frontier.page import write_page
from gelstereo.frontier.registering import Patch, observable_error_mm
from gelstereo.frontier.rungs import RUNGS, rungs_of
from gelstereo.frontier.scenes import BOARDS_MM, PARTS, Part
from gelstereo.frontier.timing import InstructionCounter, time_side_by_side
from gelstereo.geometry import se3_exp
from gelstereo.reports.markdown import ReportError, replace_between, table

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


def test_quick_run_lists_every_rung_beside_a_baseline(docs: Path) -> None:
    page = (docs / "accuracy-vs-time.md").read_text()
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
    write_page(page, [], [["0.4", "1"]], 3)
    assert "| 0.4 | 1 |" in page.read_text()


def test_a_count_of_rounds_below_one_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--rounds", "0"], ["--starts", "-1"], ["--starts", "many"]):
        with pytest.raises(SystemExit) as stopped:
            main(["frontier", *words])
        assert stopped.value.code == 2
        assert "valid is a whole number" in capsys.readouterr().err


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
        ("label", "label.method"),
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
    assert len(patch.points_mm) >= 30


def test_methods_take_turns() -> None:
    seen: list[str] = []
    times = time_side_by_side({name: lambda turn, name=name: seen.append(name) for name in "ab"}, 3)
    assert seen == ["a", "b"] * 5  # two rounds warm up
    assert times["a"].p99_ms >= times["a"].median_ms > 0.0


@pytest.mark.skipif(
    shutil.which("valgrind") is None or shutil.which("cargo") is None, reason="valgrind or cargo is absent"
)
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
