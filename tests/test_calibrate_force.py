"""Forces calibrated with known loads: simulated, and with the mistakes that labs make."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import gelstereo as gs
from gelstereo.cli import main
from gelstereo.force import (
    ForceCalibration,
    Load,
    LoadsError,
    Pressed,
    calibrate,
    calibrate_resultant,
    pressed_frames,
    read_loads,
)
from gelstereo.force.pressed import RestState
from gelstereo.force.report import thickness
from gelstereo.setup.sensor import Sensor, sensor_text

YOUNG_KPA, POISSON, THICKNESS_MM = 85.0, 0.47, 5.0
#: Depth, mm, and motion along x and y of each load: up, down, and with shear.
PRESSES = [
    (0.3, (0.0, 0.0)),
    (0.5, (0.0, 0.0)),
    (0.7, (0.0, 0.0)),
    (0.5, (0.0, 0.0)),
    (0.6, (0.15, 0.0)),
    (0.6, (-0.1, 0.12)),
]
FRAMES = 4


class Bench:
    """A simulated sensor under loads of two balls, the loads, and what is known of it."""

    def __init__(self) -> None:
        self.scenes = [
            gs.Scene().replace(
                indenter={"kind": "sphere", "radius_mm": radius_mm},
                effects={
                    "elastic_layer": {"young_kpa": YOUNG_KPA, "poisson_ratio": POISSON, "cells_per_pitch": 3},
                    "sensor_noise": {},
                },
            )
            for radius_mm in (3.0, 7.0)
        ]
        self.sensor = Sensor(self.scenes[0].rig, gs.Params.preset("balanced"), {})
        self.loads: list[Load] = []
        self.pairs: list[tuple[float, npt.NDArray[np.uint8], npt.NDArray[np.uint8]]] = []
        rest = gs.Simulator(self.scenes[0])[0]
        self.pairs.append((0.0, rest.left, rest.right))
        pose = np.eye(4)
        pose[:3, 3] = 4.0, 0.0, 40.0
        for scene in self.scenes:
            simulator = gs.Simulator(scene)
            for depth_mm, shear_mm in PRESSES:
                start_s = self.pairs[-1][0] + 0.5
                held = simulator.pressed(pose, depth_mm)
                for n in range(FRAMES):
                    frame = simulator.press(held, shear_mm=shear_mm, frame=len(self.pairs))
                    self.pairs.append((start_s + 0.1 * n, frame.left, frame.right))
                loads = frame.loads
                assert loads is not None
                x, y, z = loads.force_n
                self.loads.append(Load(start_s, start_s + 0.35, np.array([-z, x, y, np.nan])))
        self.rest, self.frames = pressed_frames(iter(self.pairs), self.sensor, self.loads)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


def fit(
    bench: Bench,
    loads: Sequence[Load],
    frames: Sequence[Pressed] | None = None,
    nu: float | None = POISSON,
) -> ForceCalibration:
    return calibrate(
        bench.rest,
        bench.frames if frames is None else frames,
        loads,
        bench.sensor,
        thickness_mm=THICKNESS_MM,
        poisson_ratio=nu,
    )


def test_the_modulus_is_found_with_its_uncertainty(bench: Bench) -> None:
    found = fit(bench, bench.loads)
    assert abs(found.young_kpa - YOUNG_KPA) < 3 * found.young_sigma_kpa
    assert found.young_sigma_kpa < 0.03 * YOUNG_KPA
    assert found.left_out_rms < 0.03 and len(found.results) == 2 * len(PRESSES)
    for result in found.results:
        known = ~np.isnan(result.load.known)
        off = (result.measured - result.load.known)[known] / result.sigma[known]
        assert np.all(np.abs(off) < 4.0), str(result.load)


def test_poissons_ratio_is_that_of_the_least_error(bench: Bench) -> None:
    found = fit(bench, bench.loads, nu=None)
    assert abs(found.poisson_ratio - POISSON) <= 0.02
    assert found.chi2 == min(found.poisson_chi2.values())
    assert abs(found.young_kpa - YOUNG_KPA) < 0.05 * YOUNG_KPA


def test_the_thickness_is_found_with_its_uncertainty(bench: Bench) -> None:
    found = calibrate(
        bench.rest,
        bench.frames,
        bench.loads,
        bench.sensor,
        thickness_mm=0.9 * THICKNESS_MM,
        poisson_ratio=POISSON,
        fits_thickness=True,
    )
    assert 0.0 < found.thickness_sigma_mm < 0.1 * THICKNESS_MM
    assert abs(found.thickness_mm - THICKNESS_MM) < 2 * found.thickness_sigma_mm
    assert abs(found.young_kpa - YOUNG_KPA) < 0.05 * YOUNG_KPA
    assert f"{found.thickness_mm:.4g} ±" in thickness(found)


def test_a_thickness_beyond_those_that_are_tried_is_refused(bench: Bench) -> None:
    of_two = [frame for frame in bench.frames if frame.load in (0, 1)]
    with pytest.raises(LoadsError, match=r"do not tell the thickness: \d\.\d\d mm"):
        calibrate(bench.rest, of_two, bench.loads[:2], bench.sensor, thickness_mm=1.0, fits_thickness=True)


def test_torques_alone_give_the_modulus(bench: Bench) -> None:
    """As a weight on a lever: the forces are not stated."""
    simulator, pose = gs.Simulator(bench.scenes[1]), np.eye(4)
    pose[:3, 3] = 4.0, 0.0, 40.0
    held = simulator.pressed(pose, 0.7)
    pairs, loads = bench.pairs[:1], []
    for twist_rad in (0.03, -0.05, 0.07):
        start_s = pairs[-1][0] + 0.5
        frame = simulator.press(held, twist_rad=twist_rad, frame=len(pairs))
        pairs += [(start_s, frame.left, frame.right)]
        assert frame.loads is not None
        # About the direction towards the camera, which is -z.
        known = np.array([np.nan, np.nan, np.nan, -frame.loads.torque_nmm[2]])
        loads.append(Load(start_s, start_s + 0.1, known))
    rest, frames = pressed_frames(iter(pairs), bench.sensor, loads)
    found = calibrate(rest, frames, loads, bench.sensor, thickness_mm=THICKNESS_MM, poisson_ratio=POISSON)
    assert abs(found.young_kpa - YOUNG_KPA) < 3 * found.young_sigma_kpa < 0.2 * YOUNG_KPA
    assert found.left_out_rms < 0.1


def test_creep_is_the_change_per_decade_of_time(bench: Bench) -> None:
    first = [frame for frame in bench.frames if frame.load == 0][-1]
    rest = bench.rest.surface.points_mm
    times_s = np.geomspace(0.1, 10.0, 30)
    crept = [
        Pressed(
            0,
            time_s,
            rest + (first.points_mm - rest) * (1.0 + 0.02 * np.log10(time_s)),
            first.covariance_mm2,
            first.patch,
        )
        for time_s in times_s
    ]
    (result,) = fit(bench, bench.loads[:1], crept).results
    # Per decade of the mean of 0.3 to 10 s, at which the load is 1.005 times that of 1 s.
    assert result.creep == pytest.approx(0.02, abs=0.001)


def test_loads_in_other_units_give_another_modulus(bench: Bench) -> None:
    """Forces are proportional to the modulus."""
    twice = [Load(load.start_s, load.end_s, 2.0 * load.known) for load in bench.loads]
    found, doubled = fit(bench, bench.loads), fit(bench, twice)
    assert doubled.young_kpa == pytest.approx(2.0 * found.young_kpa, rel=1e-9)
    assert doubled.left_out_rms == pytest.approx(found.left_out_rms, rel=1e-6)


def test_a_wrong_weight_stands_out_when_it_is_left_out(bench: Bench) -> None:
    wrong = list(bench.loads)
    wrong[2] = Load(wrong[2].start_s, wrong[2].end_s, 1.3 * wrong[2].known)
    found = fit(bench, wrong)
    worst = max(found.results, key=lambda result: abs(result.left_out))
    assert worst.load is wrong[2] and -0.3 < worst.left_out < -0.15
    assert found.young_sigma_kpa > fit(bench, bench.loads).young_sigma_kpa


def test_hysteresis_is_that_of_equal_loads_on_the_way_down(bench: Bench) -> None:
    """The second and the fourth load have one depth. Said to be equal and 4 % larger, they differ by that."""
    assert abs(fit(bench, bench.loads).hysteresis) < 0.005
    grown = [
        Pressed(
            frame.load,
            frame.time_s,
            rest + (frame.points_mm - rest) * (1.04 if frame.load == 3 else 1.0),
            frame.covariance_mm2,
            frame.patch,
        )
        for rest in [np.asarray(bench.rest.surface.points_mm)]
        for frame in bench.frames
    ]
    assert fit(bench, bench.loads, grown).hysteresis == pytest.approx(0.04, abs=0.01)


def test_forces_in_the_wrong_direction_are_refused(bench: Bench) -> None:
    against = [Load(load.start_s, load.end_s, -load.known) for load in bench.loads]
    with pytest.raises(LoadsError, match="oppose the known ones"):
        fit(bench, against)
    nothing = [Load(load.start_s, load.end_s, 0.0 * load.known) for load in bench.loads]
    with pytest.raises(LoadsError, match="all known loads are zero"):
        fit(bench, nothing)


def test_times_without_contact_are_named(bench: Bench) -> None:
    late = [Load(100.0, 101.0, np.array([1.0, 0.0, 0.0, np.nan]))]
    with pytest.raises(LoadsError, match="no frame from 100 to 101 s shows a contact"):
        pressed_frames(iter(bench.pairs[:3]), bench.sensor, late)
    with pytest.raises(LoadsError, match="there are no frames"):
        pressed_frames(iter(()), bench.sensor, late)


def test_a_contact_at_the_border_is_named(bench: Bench) -> None:
    assert not any(result.is_cut for result in fit(bench, bench.loads).results)
    at_border = [
        Pressed(
            frame.load, frame.time_s, frame.points_mm, frame.covariance_mm2, frame.patch | (frame.load == 1)
        )
        for frame in bench.frames
    ]
    found = fit(bench, bench.loads, at_border)
    assert [result.is_cut for result in found.results].index(True) == 1
    assert sum(result.is_cut for result in found.results) == 1


def test_the_axes_are_those_of_the_print(bench: Bench) -> None:
    """Towards the camera, to the right, and down."""
    rest = RestState(bench.rest.surface, bench.rest.covariance_mm2, bench.rest.cols)
    np.testing.assert_allclose(rest.axes, [[0, 0, -1], [1, 0, 0], [0, 1, 0]], atol=0.01)


def test_stiffnesses_without_a_layer_give_the_loads(bench: Bench) -> None:
    """Within what the calibration states, and worse than the layer does."""
    found = calibrate_resultant(
        bench.rest, bench.frames, bench.loads, bench.sensor, thickness_mm=THICKNESS_MM
    )
    assert 0.005 < found.left_out_rms < 0.1 and not any(found.is_cut)
    params = bench.sensor.params.replace(force=found.settings())
    estimator = gs.ForceEstimator(
        bench.rest.surface, params, cols=bench.rest.cols, covariance_mm2=bench.rest.covariance_mm2
    )
    for frame in bench.frames:
        _, wrench = estimator.run(frame.points_mm, frame.covariance_mm2, frame.patch.tolist())
        assert wrench is not None and wrench.misfit == 1.0
        known = bench.loads[frame.load].known[:3]
        off = bench.rest.axes @ wrench.force_n - known
        sigma = np.sqrt(np.diag(bench.rest.axes @ wrench.covariance[:3, :3] @ bench.rest.axes.T))
        assert np.all(np.abs(off) < 4.0 * sigma + 0.02 * known[0]), (off, sigma)
    # All forces are proportional to the known ones.
    twice = [Load(load.start_s, load.end_s, 2.0 * load.known) for load in bench.loads]
    doubled = calibrate_resultant(bench.rest, bench.frames, twice, bench.sensor, thickness_mm=THICKNESS_MM)
    assert doubled.shear_n_per_mm3 == pytest.approx(2.0 * found.shear_n_per_mm3)
    assert doubled.around_n_per_mm3 == pytest.approx(2.0 * found.around_n_per_mm3)
    straight = [Load(load.start_s, load.end_s, load.known * [1, 0, 0, 0]) for load in bench.loads]
    with pytest.raises(LoadsError, match="one with tilt_deg"):
        calibrate_resultant(bench.rest, bench.frames, straight, bench.sensor, thickness_mm=THICKNESS_MM)


def table(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "loads.csv"
    path.write_text(text)
    return path


def test_a_weight_on_a_tilted_gel_pulls_sideways(tmp_path: Path) -> None:
    text = "# grams\nstart_s,end_s,mass_g,tilt_deg,towards_deg,twist_nmm\n2,4,100,30,90,\n0,1,50,,,0\n"
    light, heavy = read_loads(table(tmp_path, text))
    assert light.known == pytest.approx([0.4903325, 0.0, 0.0, 0.0])
    weight_n = 0.980665
    assert heavy.known[:3] == pytest.approx([weight_n * np.cos(np.pi / 6), 0.0, weight_n / 2])
    assert np.isnan(heavy.known[3])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("start_s,end_s\n1,2\n", "needed are start_s, end_s, and mass_g"),
        ("start_s,end_s,weight\n1,2,3\n", "has the columns start_s, end_s, weight"),
        ("start_s,end_s,mass_g\n", "has no loads"),
        ("start_s,end_s,mass_g\n2,1,50\n", "valid is 0 <= start_s < end_s"),
        ("start_s,end_s,mass_g\n1,2,heavy\n", "mass_g is 'heavy'"),
        ("start_s,end_s,mass_g\n1,2,\n", "no load is given"),
        ("start_s,end_s,mass_g\n1,3,50\n2,4,60\n", "overlap"),
        ("start_s,end_s,mass_g\n1,2,inf\n", "valid is a finite number"),
        ("start_s,end_s,mass_g\n1,2,-5\n", "valid is 0 or more"),
    ],
)
def test_a_bad_table_is_refused(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(LoadsError, match=says):
        read_loads(table(tmp_path, text))


def test_a_recording_becomes_settings_and_a_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Through the command, with a recording by `gelstereo live`."""
    scene = gs.Scene().replace(
        frame_rate_hz=20,
        indenter={"kind": "sphere", "radius_mm": 4.0},
        effects={
            "elastic_layer": {"young_kpa": YOUNG_KPA, "poisson_ratio": POISSON},
            "sensor_noise": {},
        },
        trajectory=[
            {"time_s": time_s, "position_mm": [4.0, 0.0, z_mm]}
            for time_s, z_mm in [(0, 33.5), (0.1, 33.5), (0.3, 31.6), (0.7, 31.6), (0.9, 31.3), (1.3, 31.3)]
        ],
    )
    (tmp_path / "scene.toml").write_text(scene.to_toml())
    simulator = gs.Simulator(scene)
    rows = []
    for start_s, end_s in [(0.35, 0.65), (0.95, 1.25)]:
        loads = simulator[round(20 * end_s)].loads
        assert loads is not None
        rows.append(f"{start_s},{end_s},{-loads.force_n[2]:.5f}")
    table(tmp_path, "start_s,end_s,normal_n\n" + "\n".join(rows) + "\n")
    words = ["live", "--scene", str(tmp_path / "scene.toml"), "--show", "none", "--images", "png"]
    assert main([*words, "--record", str(tmp_path / "run.mcap"), "--frames", "27"]) == 0
    gel = {**scene.to_dict()["gel"], "noise_levels": 2.0, "point_sigma_mm": 0.005}
    sensor = tmp_path / "sensor.toml"
    sensor.write_text(sensor_text(scene.rig, "balanced", {}, gel))
    words = ["calibrate-force", str(tmp_path / "loads.csv"), str(tmp_path / "run.mcap")]
    words += ["--sensor", str(sensor), "--thickness-mm", str(THICKNESS_MM), "--poisson-ratio", str(POISSON)]
    assert main([*words, "--output", str(tmp_path / "force.toml")]) == 0
    assert "Young's modulus" in capsys.readouterr().out
    params = gs.Params.load(tmp_path / "force.toml").to_dict()["force"]
    assert params["young_kpa"] == pytest.approx(YOUNG_KPA, rel=0.05)
    page = (tmp_path / "force.html").read_text()
    assert "Measured over known forces" in page and "left out" in page
    assert "nan" not in (tmp_path / "force.toml").read_text()
