"""The gel's own lengths from presses: on gels solved by finite elements and on path-traced images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import gelstereo as gs
from gelstereo.calibrate.board_names import BoardKind
from gelstereo.setup import gel, law
from gelstereo.setup.ball import SHAPE_SHARE, BallPress, print_depth
from gelstereo.setup.plan import Plan, Views
from outside import images, judge_skin, shape

#: Pitch of the path-traced sensor a.
PITCH_MM = 0.85
#: rms distance of the skin from other balls with the learned depth, over that of the markers themselves: at
#: most so much. A depth of 0.2 mm is no larger than the uncertainty of what is learned.
GAIN = {0.2: 1.2, 0.4: 0.4, 0.8: 0.15}


@pytest.mark.parametrize("thickness_mm", [2.0, 4.0])
@pytest.mark.parametrize("depth_mm", [0.2, 0.4, 0.8])
def test_the_depth_of_a_print_is_learned_from_a_ball(thickness_mm: float, depth_mm: float) -> None:
    """Learned under one ball, judged under others of the same gel."""
    presses = judge_skin.by_press("w")
    found = judge_skin.learned(presses[thickness_mm, depth_mm, 7.0])
    assert found is not None
    assert abs(found.depth_mm - depth_mm) < 2.5 * found.sigma_mm
    others = [each for ball in (2.0, 3.0, 4.5) for each in presses[thickness_mm, depth_mm, ball]]
    assert judge_skin.skin_rms_mm(others, found.depth_mm) < GAIN[depth_mm] * judge_skin.skin_rms_mm(
        others, 0.0
    )
    assert judge_skin.skin_rms_mm(others, found.depth_mm) < 3 * found.sigma_mm


def test_a_few_markers_tell_no_depth() -> None:
    presses = judge_skin.by_press("w")[4.0, 0.4, 2.0]
    assert judge_skin.learned(presses) is None
    nowhere = [BallPress(each.points_mm, np.zeros(len(each.points_mm), bool)) for each in presses]
    rest = gs.RestSurface(presses[0].rest_mm)
    assert print_depth(rest, nowhere, cols=judge_skin.SIDE, radius_mm=2.0) is None


def test_friction_is_the_ratio_of_a_slide() -> None:
    otherwise = law.GelLength.assumed("friction", "slide")
    slides = [(1.0, 0.42 + 0.01 * k, 0.01, True) for k in (-1, 0, 1)]
    stuck, weak = (1.0, 0.2, 0.01, False), (0.01, 0.2, 0.01, True)
    found = law.friction_of([*slides, stuck, weak], otherwise)
    assert found.learned and found.value == pytest.approx(0.42)
    assert found.sigma >= 0.15 * 0.42
    assert law.friction_of([slides[0], stuck], otherwise) is otherwise
    assert found.values() == {"friction": 0.42, "friction_sigma": pytest.approx(found.sigma, abs=1e-4)}


def path_traced(folder: Path, name: str, ball_radius_mm: float | None) -> tuple[Plan, gs.Rig]:
    """A plan of a path-traced sequence of the development half: twelve frames at rest, then the presses."""
    sequence = images.Sequence.load(name)
    assert sequence.half == "w"
    rig = gs.Rig.from_toml(sequence.about["rig"])
    condition = images.Condition()

    def views(kind: str, frames: list[tuple[int, int]]) -> Views:
        files: tuple[list[Path], list[Path]] = ([], [])
        for number, (frame, seed) in enumerate(frames):
            for view, image in zip(files, sequence.pair(frame, condition, seed), strict=True):
                view.append(folder / f"{kind}_{len(view)}_{'left' if view is files[0] else 'right'}.png")
                cv2.imwrite(str(view[number]), image)
        return Views(tuple(files[0]), tuple(files[1]))

    rest = views("rest", [(0, seed) for seed in range(12)])
    press = views("press", [(frame, 100 + frame) for frame in range(len(sequence))])
    board = BoardKind.parse("9x6").board({"square_mm": 2.0})
    plan = Plan(
        # The cameras are known, so that their images are not read.
        cameras=rest,
        board=board,
        rest=rest,
        pitch_mm=(PITCH_MM, PITCH_MM),
        presses=press,
        ball_radius_mm=ball_radius_mm,
    )
    return plan, rig


def test_the_lengths_of_a_path_traced_sensor(tmp_path: Path) -> None:
    plan, rig = path_traced(tmp_path, "w2_press_slowly", 7.0)
    rest = gel.rest(plan, rig, {"lattice.pitch_mm": PITCH_MM})
    assert rest.is_good, str(rest)
    step = gel.presses(plan, rig, {"lattice.pitch_mm": PITCH_MM}, 0.02)
    found = step.values["gel"]
    assert step.is_good, str(step)
    # The gel is 4 mm thick, and the print is its skin.
    assert abs(found["thickness_mm"] - 4.0) < 3 * found["thickness_sigma_mm"]
    assert abs(found["depth_mm"]) < 3 * found["depth_sigma_mm"]
    assert {"thickness_mm", "depth_mm"} <= set(found["learned"])
    assert "friction" not in found["learned"] and "pull_off_mm2" not in found["learned"]
    assert any("friction is assumed: slide a part" in advice for advice in step.advice)
    for name in law.ASSUMED:
        stem, _, unit = name.partition("_mm")
        assert found[f"{stem}_sigma" + ("_mm" + unit if "_mm" in name else "")] > 0.0


@pytest.mark.parametrize("depth_mm", [0.2, 0.4, 0.8])
def test_the_laws_error_explains_that_of_a_learned_depth(depth_mm: float) -> None:
    """To first order, which shows how little the shape tells: docs/outside.md."""
    presses = judge_skin.by_press("w")[4.0, depth_mm, 7.0]
    found, it = judge_skin.learned(presses), shape.told(presses)
    assert found is not None and it is not None
    assert SHAPE_SHARE * found.depth_mm - depth_mm == pytest.approx(it.error_mm, abs=0.01)
    # A hundred micrometres of depth change the shape by a few.
    assert 0.1 * it.signal < 0.005
