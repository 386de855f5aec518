"""The steps of `gelstereo setup` on real images: chessboards of a stereo camera, and prints of real gels.

No public set has both of one sensor, so that the steps are tried one by one, and the whole on what does not
belong together.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from real_data import DATA, needs

import gelstereo as gs
from gelstereo.calibrate.board_names import BoardKind
from gelstereo.setup import Plan, set_up
from gelstereo.setup.cameras import calibrate
from gelstereo.setup.plan import Views
from gelstereo.setup.prints import look

#: Inner corners and squares of the chessboards, as their authors state them.
BOARD, SQUARE_MM = "9x6", 25.0


def plan(rest: Path, pitch_mm: float, preset: str = "balanced") -> Plan:
    """Real chessboards, and one picture of a real gel as both views."""
    folder = DATA / "opencv_stereo_chess"
    left, right = (tuple(sorted(folder.glob(f"{view}??.jpg"))) for view in ("left", "right"))
    return Plan(
        cameras=Views(left, right),
        board=BoardKind.parse(BOARD).board({"square_mm": SQUARE_MM}),
        rest=Views((rest,), (rest,)),
        pitch_mm=(pitch_mm, pitch_mm),
        preset=preset,
    )


@needs("opencv_stereo_chess")
@needs("9dtact_calib")
def test_real_chessboards_give_a_rig() -> None:
    step = calibrate(plan(DATA / "9dtact_calib" / "s1_sample.png", 3.0))
    figures = {figure.name: figure.value for figure in step.figures}
    rig = gs.Rig.from_toml(step.values["rig"])
    # OpenCV's own example states a baseline of 3.33 squares.
    baseline_mm = float(np.linalg.norm(np.asarray(rig.t_right_left)[:3, 3]))
    assert 2.9 * SQUARE_MM < baseline_mm < 3.8 * SQUARE_MM
    assert figures["pairs used"].endswith("of 13")
    assert float(figures["residual"].split()[0]) < 0.6


@needs("9dtact_calib")
@pytest.mark.parametrize("name", ["s1_sample.png", "s2_sample.png"])
def test_a_real_print_is_looked_at(name: str) -> None:
    step = look(plan(DATA / "9dtact_calib" / name, 3.0))
    figures = {figure.name: figure.value for figure in step.figures}
    assert figures["left: rows x columns"] == "7 x 9, square"
    settings = step.values["settings"]
    assert (settings["lattice.rows"], settings["lattice.cols"]) == (7, 9)
    assert step.picture is not None and not any("irregular" in doubt for doubt in step.doubts)


@needs("khsu_markers")
def test_a_real_gel_that_is_wider_than_the_view_is_doubted() -> None:
    step = look(plan(DATA / "khsu_markers" / "pic00.jpg", 1.0))
    assert any("reaches beyond the left view" in doubt for doubt in step.doubts)
    assert step.values["settings"]["detect.channel"] == "blue"
    assert "lattice.rows" not in step.values["settings"]


@needs("opencv_stereo_chess")
@needs("9dtact_calib")
def test_images_that_do_not_belong_together_stop_with_the_step(tmp_path: Path) -> None:
    """One picture of a gel as both views has no disparity; what was found before is kept."""
    image = cv2.imread(str(DATA / "9dtact_calib" / "s1_sample.png"))
    rest = tmp_path / "rest.png"
    cv2.imwrite(str(rest), cv2.resize(image, (640, 480)))
    lines: list[str] = []
    with pytest.raises(gs.Error, match="disparity"):
        set_up(plan(rest, 3.0), tmp_path / "out", lines.append)
    stored = sorted(path.name for path in (tmp_path / "out" / "steps").iterdir())
    assert stored == ["1-cameras.json", "2-print.json", "3-layers.json"]
    assert lines[-1] == "rest ..."
    assert not (tmp_path / "out" / "sensor.toml").exists()
