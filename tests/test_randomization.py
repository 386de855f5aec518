"""Random variations of scenes."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelstereo as gs
from gelstereo._native import RandomStream
from gelstereo.randomization import Distribution, DistributionError

SCENE: dict[str, Any] = {
    "gel": {"rows": 9, "cols": 9},
    "indenter": {"kind": "sphere", "radius_mm": 4.0},
    "effects": {"elastic_layer": {}, "defocus": {}, "uneven_light": {}, "sensor_noise": {}},
}
VARIED: dict[str, Any] = {
    "indenter": {
        "choice": [
            {"kind": "sphere", "radius_mm": {"uniform": [3.0, 6.0]}},
            {"kind": "box", "size_mm": [{"uniform": [2.0, 4.0]}, 3.0, 5.0]},
        ],
        "weights": [3, 1],
    },
    "effects": {"uneven_light": {"across": {"uniform": [-0.3, 0.3]}}},
    "effects.sensor_noise.sigma_levels": {"log_uniform": [0.5, 4.0]},
    "effects.misprint": {"choice": [None, {"shift_mm": {"uniform": [0.0, 0.05]}}]},
    "gel.thickness_mm": {"normal": [5.0, 0.3], "min": 4.0, "max": 6.0},
    "gel.dark_level": {"integers": [30, 60]},
    "press": {
        "position_mm": [{"uniform": [3.0, 5.0]}, {"uniform": [-1.0, 1.0]}],
        "rotation_rad": [0.0, 0.1, {"normal": [0.0, 0.2]}],
        "depth_mm": {"uniform": [0.3, 1.2]},
        "shear_mm": [{"uniform": [-0.1, 0.1]}, 0.0],
    },
}
SIMULATOR = gs.simulate(SCENE)
SEEDS = st.integers(0, 2**63 - 1)


@settings(max_examples=15, deadline=None)
@given(SEEDS)
def test_a_random_simulator_is_that_of_its_scene(seed: int) -> None:
    drawn = SIMULATOR.randomize(VARIED, seed)
    again = gs.Simulator(gs.Scene.from_toml(drawn.scene.to_toml()))
    assert drawn.scene.to_dict() == SIMULATOR.randomize(Distribution(VARIED), seed).scene.to_dict()
    assert len(drawn) == 1
    for name in ("left", "right", "points_mm"):
        assert np.array_equal(getattr(drawn[0], name), getattr(again[0], name)), name
    scene = drawn.scene.to_dict()
    assert -0.3 <= scene["effects"]["uneven_light"]["across"] <= 0.3
    assert 0.5 <= scene["effects"]["sensor_noise"]["sigma_levels"] <= 4.0
    assert 4.0 <= scene["gel"]["thickness_mm"] <= 6.0 and 30 <= scene["gel"]["dark_level"] <= 60
    assert scene["trajectory"][0]["shear_mm"][1] == 0.0


def test_the_press_has_the_depth_and_the_force_that_are_stated() -> None:
    pressed = SIMULATOR.randomize({"press": {"depth_mm": 0.9}}, 1)
    assert pressed[0].t_sensor_object is not None
    # A ball of 4 mm, 0.9 mm deep in a surface at 28.7 mm.
    assert pressed[0].t_sensor_object[2, 3] == pytest.approx(28.7 - 0.9 + 4.0)
    forced = SIMULATOR.randomize({"press": {"force_n": {"uniform": [0.4, 0.6]}}}, 1)
    loads = forced[0].loads
    assert loads is not None and 0.4 * 0.99 <= -loads.force_n[2] <= 0.6 * 1.01


@settings(max_examples=50, deadline=None)
@given(SEEDS)
def test_a_setting_draws_the_same_whatever_else_varies(seed: int) -> None:
    one = Distribution({"effects.grain.sigma_levels": {"normal": [3.0, 1.0]}})
    two = Distribution({"effects": {"grain": {"sigma_levels": {"normal": [3.0, 1.0]}}, **VARIED["effects"]}})
    assert one.draw(seed).settings["effects"]["grain"] == two.draw(seed).settings["effects"]["grain"]
    assert one.draw(seed).settings["seed"] == two.draw(seed).settings["seed"]
    assert Distribution({**one.to_dict(), "seed": 5}).draw(seed).settings["seed"] == 5


def test_numbers_follow_their_distributions() -> None:
    """Quantiles within four standard errors, 4 sqrt(p (1 - p) / n)."""
    count = 4000
    distribution = Distribution(
        {
            "a": {"uniform": [-2.0, 6.0]},
            "b": {"log_uniform": [0.01, 100.0]},
            "c": {"normal": [3.0, 2.0]},
            "d": {"normal": [0.0, 1.0], "min": 0.0},
            "e": {"integers": [1, 4]},
            "f": {"choice": ["x", "y"], "weights": [1, 3]},
            "g": {"choice": ["x", "y", "z"]},
        }
    )
    drawn = [distribution.draw(seed).settings for seed in range(count)]
    shares = [
        ("a", lambda a: a < 0.0, 0.25),
        ("b", lambda b: b < 1.0, 0.5),
        ("b", lambda b: b < 0.1, 0.25),
        ("c", lambda c: c < 3.0, 0.5),
        ("c", lambda c: abs(c - 3.0) < 2.0, 0.682689),
        ("d", lambda d: d < 1.0, 0.682689),
        ("d", lambda d: d < 0.0, 0.0),
        ("e", lambda e: e == 4, 0.25),
        ("e", lambda e: e == 1, 0.25),
        ("f", lambda f: f == "y", 0.75),
        ("g", lambda g: g == "z", 1 / 3),
    ]
    for name, holds, expected in shares:
        found = np.mean([holds(settings[name]) for settings in drawn])
        assert abs(found - expected) <= 4.0 * np.sqrt(expected * (1.0 - expected) / count), (name, found)
    correlation = np.corrcoef([[settings["a"], settings["c"]] for settings in drawn], rowvar=False)[0, 1]
    assert abs(correlation) < 4.0 / np.sqrt(count)


@settings(max_examples=50)
@given(st.floats(1e-6, 1e6), st.floats(1.0, 1e6), SEEDS)
def test_ends_are_not_passed(low: float, ratio: float, seed: int) -> None:
    high = low * ratio
    drawn = (
        Distribution({"a": {"log_uniform": [low, high]}, "b": {"uniform": [low, high]}}).draw(seed).settings
    )
    assert low <= drawn["a"] <= high and low <= drawn["b"] <= high


def test_streams_are_those_of_the_core() -> None:
    stream = RandomStream(1, "a")
    assert stream.uniform() != stream.uniform()
    assert RandomStream(1, "a").uniform() == RandomStream(1, "a").uniform() != RandomStream(1, "b").uniform()
    with pytest.raises(gs.ShapeError, match="from 1"):
        stream.below(0)
    with pytest.raises(gs.ShapeError, match="0 < low"):
        stream.log_uniform(0.0, 1.0)


def test_a_distribution_is_plain_data(tmp_path: Path) -> None:
    distribution = Distribution(VARIED)
    assert Distribution(distribution.to_dict()) == distribution == pickle.loads(pickle.dumps(distribution))
    path = tmp_path / "varied.toml"
    path.write_text(
        "[effects.uneven_light]\nacross = { uniform = [-0.3, 0.3] }\n"
        "[press]\ndepth_mm = { uniform = [0.3, 1] }\n"
    )
    of_file = SIMULATOR.randomize(path, 3).scene.to_dict()
    varied = {
        "effects.uneven_light.across": {"uniform": [-0.3, 0.3]},
        "press.depth_mm": {"uniform": [0.3, 1]},
    }
    assert of_file == SIMULATOR.randomize(varied, 3).scene.to_dict()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"gel.pitch_mm": {"uniform": [2.0, 1.0]}}, r"gel\.pitch_mm.*\[low, high\]"),
        ({"gel.pitch_mm": {"uniform": [1.0, 2.0], "min": 1}}, "'min' beside 'uniform'"),
        ({"gel.pitch_mm": {"uniform": [1.0]}}, "low, high"),
        ({"gel.pitch_mm": {"log_uniform": [0.0, 1.0]}}, "both above 0"),
        ({"gel.pitch_mm": {"normal": [1.0, -1.0]}}, "standard deviation"),
        ({"gel.rows": {"integers": [1.5, 3]}}, "whole numbers"),
        ({"gel.rows": {"choice": []}}, "at least one"),
        ({"gel.rows": {"choice": [1, 2], "weights": [1]}}, "as many weights"),
        ({"gel": {"pitch_mm": 1.0}, "gel.pitch_mm": 2.0}, "stated twice"),
        ({"press": {}}, "either depth_mm or force_n"),
        ({"press": {"depth_mm": 1.0, "speed": 1.0}}, "speed"),
        ({"press": {"depth_mm": 1.0, "position_mm": [1.0, 2.0, 3.0]}}, "list of 2"),
        ({"press": {"depth_mm": "deep"}}, "number or a distribution"),
        ({1: 2}, "valid is text"),
    ],
)
def test_what_is_no_distribution_says_why(settings: dict[Any, Any], message: str) -> None:
    with pytest.raises(DistributionError, match=message):
        Distribution(settings)


def test_scenes_that_are_not_valid_say_which_draw(tmp_path: Path) -> None:
    with pytest.raises(DistributionError, match=r"seed 4 draws.*gel\.thickness_mm is -1"):
        SIMULATOR.randomize({"gel.thickness_mm": -1.0}, 4)
    with pytest.raises(DistributionError, match=r"highest values give.*thickness_mm"):
        Distribution({"gel.thickness_mm": {"uniform": [4.0, 5000.0]}}).check(SIMULATOR)
    with pytest.raises(DistributionError, match="unknown field `thicknes_mm`"):
        SIMULATOR.randomize({"gel.thicknes_mm": {"uniform": [4.0, 5.0]}}, 4)
    with pytest.raises(DistributionError, match="hundredth"):
        SIMULATOR.randomize({"gel.thickness_mm": {"normal": [5.0, 0.1], "min": 9.0}}, 4)
    with pytest.raises(DistributionError, match="2\\^63"):
        SIMULATOR.randomize({}, -1)
    (tmp_path / "no.toml").write_text("a = {")
    with pytest.raises(DistributionError, match=r"no\.toml.*TOML"):
        SIMULATOR.randomize(tmp_path / "no.toml", 1)


def test_replace_gives_the_simulator_of_the_changed_scene() -> None:
    changed = SIMULATOR.replace({"effects.sensor_noise.sigma_levels": 4.0}, seed=3)
    fresh = gs.Simulator(changed.scene)
    pose = SIMULATOR.pressed(np.eye(4), 0.8)
    assert changed.scene.to_dict()["seed"] == 3 and SIMULATOR.scene.to_dict()["seed"] == 1
    assert np.array_equal(changed.press(pose).left, fresh.press(pose).left)
    assert not np.array_equal(changed.press(pose).left, SIMULATOR.press(pose).left)
    with pytest.raises(gs.SceneError, match="unknown field"):
        SIMULATOR.replace(colour="red")


def test_replace_keeps_a_mesh_that_was_read(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    path = tmp_path / "ball.stl"
    trimesh.creation.icosphere(radius=4.0).export(path)
    simulator = gs.simulate({"indenter": {"kind": "mesh", "path": str(path), "units": "mm"}, "gel.rows": 9})
    path.unlink()
    pose = simulator.pressed(np.eye(4), 0.8)
    changed = simulator.replace({"gel.bright_level": 200})
    assert np.array_equal(changed.press(pose).points_mm, simulator.press(pose).points_mm)
    with pytest.raises((gs.MeshError, OSError)):
        simulator.replace(indenter={"kind": "mesh", "path": str(tmp_path / "other.stl"), "units": "mm"})
