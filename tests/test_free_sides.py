"""Free sides of a simulated gel, against gels solved by finite elements (the development half)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

import gelstereo as gs
from outside.contacts import HALF_MM, table
from outside.fields import Field

Array = npt.NDArray[np.float64]

PITCH_MM, SIDE = 0.85, 25
RIM_MM = HALF_MM - PITCH_MM * (SIDE // 2)


def left(radius_mm: float, gel_name: str, rim_mm: float | None) -> tuple[float, float]:
    """Unexplained motion beside a ball, and the motion, mm rms, at the deepest stage."""
    field, gel = Field.load(f"ball_{radius_mm}_{gel_name}"), table()["gels"][gel_name]
    stage = len(field.stages) - 1
    layer = {name: gel[name] for name in ("poisson_ratio", "friction")}
    scene = gs.Scene().replace(
        {
            "gel": {"rows": SIDE, "cols": SIDE, "pitch_mm": PITCH_MM, "thickness_mm": gel["thickness_mm"]},
            "indenter": {"kind": "sphere", "radius_mm": radius_mm},
            "effects": {
                "elastic_layer": {**layer, **({} if rim_mm is None else {"rim_mm": rim_mm})},
                "large_strain": {},
            },
        }
    )
    simulator = gs.Simulator(scene)
    rest = np.asarray(simulator[0].points_mm)
    middle = rest.mean(axis=0)
    pose = np.eye(4)
    pose[:3, 3] = middle + [0.0, 0.0, 20.0]
    moved = simulator.press(simulator.pressed(pose, field.stages[stage][0])).points_mm - rest
    places = (rest - middle)[:, :2]
    truth = field.motion(stage, places)
    # Gels under balls are discs.
    beside = ~field.touching(stage, places) & (np.hypot(*places.T) < HALF_MM - PITCH_MM)
    return _rms((moved - truth)[beside]), _rms(truth[beside])


def _rms(motion_mm: Array) -> float:
    return float(np.sqrt((motion_mm**2).sum(axis=1).mean()))


@pytest.mark.parametrize("radius_mm", [4.5, 7.0])
def test_a_rim_explains_a_third_of_what_an_endless_layer_leaves(radius_mm: float) -> None:
    """On a gel whose half width is 2.7 times its thickness."""
    (endless_mm, moved_mm), (rim_mm, _) = (left(radius_mm, "a", rim) for rim in (None, RIM_MM))
    assert 0.24 < endless_mm / moved_mm < 0.29
    assert rim_mm / moved_mm < 0.18


def test_a_rim_changes_little_on_a_thin_gel() -> None:
    """There the half width is 5.5 times the thickness."""
    (endless_mm, moved_mm), (rim_mm, _) = (left(5.0, "c", rim) for rim in (None, RIM_MM))
    assert rim_mm < endless_mm < 0.08 * moved_mm


def test_a_rim_is_checked() -> None:
    with pytest.raises(gs.SceneError, match=r"effects\.elastic_layer\.rim_mm is 0\.1; valid is half of gel"):
        gs.Scene().replace({"effects.elastic_layer.rim_mm": 0.1})
