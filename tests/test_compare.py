"""`gelstereo compare`: two sensor files beside each other, against exact laws of a pair without layers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelstereo as gs
from gelstereo.cli.main import main
from gelstereo.setup import Sensor, compare_sensors
from gelstereo.setup.sensor import SensorFileError, sensor_text

GEL = {
    "rows": 9,
    "cols": 11,
    "pitch_mm": 1.5,
    "dot_radius_mm": 0.4,
    "surface_mm": 30.0,
    "centre_mm": [1.0, -0.5],
    "noise_levels": 1.2,
    "point_sigma_mm": 0.004,
}


def sensor(baseline_mm: float = 12.0, size_px: tuple[int, int] = (640, 480), **gel: object) -> Sensor:
    rig = gs.Rig.parallel(f_px=800.0, c_px=(320.0, 240.0), baseline_mm=baseline_mm, size_px=size_px)
    return Sensor(rig, gs.Params.preset("balanced"), {**GEL, **gel})


def places_mm() -> np.ndarray:
    x_mm = 1.5 * (np.arange(11) - 5.0) + 1.0
    y_mm = 1.5 * (np.arange(9) - 4.0) - 0.5
    return np.array([[x, y, 30.0] for y in y_mm for x in x_mm])


def test_a_sensor_is_interchangeable_with_itself() -> None:
    found = compare_sensors(sensor(), sensor())
    assert found.differences == () and found.is_interchangeable
    assert max(found.shift_mm, found.distortion_mm) < 1e-9
    assert "all values are equal" in str(found)


@settings(max_examples=50, deadline=None)
@given(share=st.floats(-0.05, 0.05))
def test_a_wrong_baseline_scales_the_points(share: float) -> None:
    found = compare_sensors(sensor(12.0 * (1.0 + share)), sensor(12.0))
    points_mm = places_mm()
    shift_mm = abs(share) * np.linalg.norm(points_mm, axis=1).mean()
    apart_mm = np.linalg.norm(points_mm - points_mm.mean(axis=0), axis=1)
    assert abs(found.shift_mm - shift_mm) < 1e-7
    # A rigid motion does not scale: what is left is the scaling about the middle.
    assert abs(found.distortion_mm - abs(share) * np.sqrt(np.mean(apart_mm**2))) < 1e-7


def test_differences_are_named_with_units_and_sigmas() -> None:
    first = sensor(decay_mm=2.5, decay_sigma_mm=0.03)
    second = sensor(11.9, decay_mm=2.6, decay_sigma_mm=0.04)
    second = replace(second, params=second.params.replace({"contact.decay_mm": 2.6}))
    found = {difference.name: difference for difference in compare_sensors(first, second).differences}
    assert set(found) >= {"baseline", "decay_mm", "params.contact.decay_mm"}
    assert found["decay_mm"].sigmas == pytest.approx(2.0)
    assert found["baseline"].sigmas is None and "11.9 mm   (-0.1)" in str(found["baseline"])


def test_layers_of_one_sensor_alone_are_told() -> None:
    layers = {"normal": [0.0, 0.0, 1.0], "gap_mm": 20.0, "gel_index": 1.41, "plates": []}
    plain = sensor()
    found = compare_sensors(plain, replace(plain, rig=plain.rig.with_layers(layers)))
    gap = next(difference for difference in found.differences if difference.name == "layers.gap_mm")
    assert (gap.first, gap.second) == (None, 20.0)
    # A slab of 10 mm and index 1.41 puts a point 3 mm nearer: t (1 - 1/n).
    assert found.shift_mm > 2.0 and not found.is_interchangeable


def test_a_plate_of_another_thickness_is_named() -> None:
    def layered(thickness_mm: float) -> Sensor:
        plates = [{"thickness_mm": thickness_mm, "index": 1.49}]
        layers = {"normal": [0.0, 0.0, 1.0], "gap_mm": 15.0, "gel_index": 1.41, "plates": plates}
        return replace(sensor(), rig=sensor().rig.with_layers(layers))

    (found,) = compare_sensors(layered(3.0), layered(3.1)).differences
    assert (found.name, found.unit, found.first, found.second) == (
        "layers.plates.0.thickness_mm",
        "mm",
        3.0,
        3.1,
    )


def test_other_image_sizes_are_refused() -> None:
    with pytest.raises(SensorFileError, match="640x480 and the second of 320x240"):
        compare_sensors(sensor(), sensor(size_px=(320, 240)))


def test_the_command_tells_by_its_exit_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, baseline_mm in (("first", 12.0), ("second", 11.9)):
        text = sensor_text(sensor(baseline_mm).rig, "balanced", {}, GEL)
        (tmp_path / f"{name}.toml").write_text(text)
    first, second = str(tmp_path / "first.toml"), str(tmp_path / "second.toml")
    assert main(["compare", first, first]) == 0
    assert main(["compare", first, second]) == 1
    assert "the first file cannot serve for the second sensor" in capsys.readouterr().out
    (tmp_path / "other.toml").write_text("preset = 'fast'\n")
    assert main(["compare", first, str(tmp_path / "other.toml")]) == 2
