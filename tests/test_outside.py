"""Path-traced pairs and finite-element contacts (`bench/outside`): they load, are apart by half, and are
true.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

import gelstereo
from gelstereo._native import parse_toml
from gelstereo_bench.frontier.grasps import GRASPED
from outside import bonded, fields, grasped, images, layer_contact
from outside.images import Condition, Sequence
from outside.judge import judged, under_glints
from outside.judge_contacts import REFERENCE, RULES, judge
from outside.optics import Optics
from outside.parts import Part, Posed, at_touch

HERE = Path(images.__file__).parent
STORED = images.names()
CONTACTS = sorted(path.stem for path in fields.DATA.glob("*.npz"))


def table(name: str) -> dict[str, Any]:
    return dict(parse_toml((HERE / name).read_text()))


def test_every_stored_pair_loads_with_its_truth() -> None:
    assert set(STORED) == {entry["name"] for entry in table("sequences.toml")["sequences"]}
    assert sum(len(Sequence.load(name)) for name in STORED) == 82
    for name in STORED:
        sequence = Sequence.load(name)
        for index in range(len(sequence)):
            for view in ("left", "right"):
                assert sequence.clean(index, view).shape == (480, 640)
        for key, last in (("points_mm", 3), ("left_px", 2), ("right_px", 2), ("normals", 3)):
            values = sequence.truth[key]
            assert values.shape == (len(sequence), 625, last)
            assert np.isfinite(values).all()


def test_halves_share_no_gel_part_law_or_print() -> None:
    contacts = table("contacts.toml")
    gels, balls = contacts["gels"], contacts["balls"]
    assert not set(balls["w"]) & set(balls["j"])
    for key in ("thickness_mm", "poisson_ratio"):
        work, kept = ({g[key] for g in gels.values() if g["half"] == half} for half in "wj")
        assert not work & kept
    entries = list(contacts["laws"].values()) + list(contacts["solids"].values())
    half = [entry.get("half") or gels[entry["gel"]]["half"] for entry in entries]
    parts = [json.dumps(entry["part"], sort_keys=True) for entry in entries]
    assert not {p for p, h in zip(parts, half, strict=True) if h == "w"} & {
        p for p, h in zip(parts, half, strict=True) if h == "j"
    }
    lengths = [entry.get("length_mm") for entry in contacts["laws"].values()]
    assert len({x for x in lengths if x}) == sum(x is not None for x in lengths)
    sensors = table("sequences.toml")["sensors"].values()
    assert len({s["print_seed"] for s in sensors}) == len(sensors)
    assert all(s["half"] == gels[s["gel"]]["half"] for s in sensors)


def test_every_sequence_shows_contacts_of_its_own_half() -> None:
    checked = 0
    for name in STORED:
        sequence = Sequence.load(name)
        for frame in sequence.about["frames"]:
            if frame != "rest":
                assert fields.Field.load(frame[0]).meta["half"] == sequence.half
                checked += 1
    assert checked >= 5


def test_size_in_the_repository_is_bounded() -> None:
    sizes = {
        kind: sum(p.stat().st_size for p in (HERE / "data" / kind).iterdir())
        for kind in ("images", "contacts", "grasped")
    }
    assert sizes["images"] < 40e6
    assert sizes["contacts"] < 10e6
    assert sizes["grasped"] < 5e6


def test_snells_law_is_the_rigs() -> None:
    """The truth's own tracing against the library's projection."""
    for thickness in (2.0, 5.0):
        optics = Optics(thickness)
        rig = gelstereo.Rig.from_toml(optics.rig_toml())
        rng = np.random.default_rng(1)
        points = rng.uniform([-6, -10, optics.back_mm + 0.5], [14, 10, optics.surface_mm + 0.3], (200, 3))
        for own, theirs in zip(
            optics.project(points), rig.project(optics.in_sensor_frame(points)), strict=True
        ):
            assert np.abs(own - theirs).max() < 1e-9


@pytest.mark.parametrize("half", ["w", "j"])
def test_rendered_centres_are_the_true_ones(half: str) -> None:
    """On a clean rest pair of each half, within the outermost markers: within 0.012 px rms, without bias."""
    sequence = Sequence.load(images.names(half)[0])
    detector = gelstereo.Detector(gelstereo.Params.preset("exact").replace({"lattice.pitch_mm": 0.85}))
    # The outermost lie at the print's edge, where the detector itself is off by up to half a pixel.
    inner = np.zeros((25, 25), dtype=bool)
    inner[1:-1, 1:-1] = True
    clear = inner.ravel() & ~under_glints(sequence, 0)
    assert clear.sum() > 450
    for view in ("left", "right"):
        true = sequence.truth[f"{view}_px"][0][clear]
        found = detector.detect(sequence.clean(0, view)).centres_px
        far = np.linalg.norm(found[:, None] - true[None], axis=2)
        error = (found[far.argmin(axis=0)] - true)[far.min(axis=0) < 1.0]
        assert len(error) == len(true)
        assert np.sqrt((error**2).mean()) < 0.012
        assert np.abs(error.mean(axis=0)).max() < 0.002


def test_surfaces_lie_on_the_ball_that_presses_them() -> None:
    """Nodes that carry pressure are within 5 um of the part, and the others outside it."""
    gels = table("contacts.toml")["gels"]
    checked = 0
    for name in CONTACTS:
        field = fields.Field.load(name)
        if "r" not in field.arrays:
            continue
        thickness = gels[field.meta["gel"]]["thickness_mm"]
        part = Part.read(field.meta["part"])
        for stage, (depth, *_) in enumerate(field.stages):
            r, motion = field.arrays["r"], field.arrays["motion"][stage]
            places = np.stack((r + motion[:, 0], np.zeros_like(r), thickness + motion[:, 1]), axis=1)
            middle = np.array([0.0, 0.0, thickness + part.half_mm[0] - depth])
            gap = Posed(part, middle).distance(places)
            pressed = field.arrays["pressure"][stage] > 0
            assert pressed.any()
            assert np.abs(gap[pressed]).max() < 0.005
            assert gap[~pressed].min() > -1e-5
            checked += 1
    assert checked >= 40


def test_contacts_by_finite_elements_are_the_listed_ones() -> None:
    """Every ball and the solids that are solved, with all of their stages and in their gel's half."""
    contacts = table("contacts.toml")
    gels, stages = contacts["gels"], {"w": 0, "j": 0}
    solids = {f"{name}_{solid['gel']}": solid for name, solid in contacts["solids"].items()}
    balls = {
        f"ball_{radius}_{gel}" for gel, entry in gels.items() for radius in contacts["balls"][entry["half"]]
    }
    stored = set(CONTACTS) - set(contacts["laws"])
    assert balls <= stored <= balls | set(solids)
    for name in stored:
        field = fields.Field.load(name)
        assert field.meta["half"] == gels[field.meta["gel"]]["half"]
        if name in solids:
            assert field.stages == solids[name]["stages"]
        stages[field.meta["half"]] += len(field.stages)
    assert stages == {"w": 104, "j": 108}


@pytest.mark.long
def test_solids_touch_the_gel_where_they_say_and_are_nowhere_in_it() -> None:
    """Nodes that touch all round are near the part; friction keeps to Coulomb's law."""
    gels = table("contacts.toml")["gels"]
    checked = 0
    for name in CONTACTS:
        field = fields.Field.load(name)
        if "share" not in field.arrays:
            continue
        gel, arrays = gels[field.meta["gel"]], field.arrays
        touch = at_touch(Part.read(field.meta["part"]), gel["thickness_mm"], (0.0, 0.0))
        y, x = np.meshgrid(arrays["y"], arrays["x"], indexing="ij")
        places = np.stack((x, y, np.full_like(x, gel["thickness_mm"])), axis=-1)
        for stage, (depth, right, down, twist) in enumerate(field.stages):
            part = Posed(touch.part, touch.middle_mm + np.array([right, down, -depth]), twist)
            moved = (places + arrays["motion"][stage]).reshape(-1, 3)
            gap, share = part.distance(moved), arrays["share"][stage].ravel()
            assert (share > 0.999).sum() >= 3
            assert np.abs(gap[share > 0.999]).mean() < 0.005
            assert gap.min() > -0.015
            pressure = arrays["pressure"][stage]
            sideways = np.linalg.norm(arrays["traction"][stage], axis=-1)
            assert (sideways <= 1.001 * gel["friction"] * pressure + 1e-6).all()
            # The part's own motion is the gel's where it sticks.
            if right or down:
                carried = arrays["motion"][stage].reshape(-1, 3)[share > 0.999, :2].mean(axis=0)
                start = arrays["motion"][1].reshape(-1, 3)[share > 0.999, :2].mean(axis=0)
                way = np.array([right, down])
                assert 0.5 < (carried - start) @ way / (way @ way) < 1.05
            checked += 1
    assert checked == 44


def test_gels_are_smooth_beside_solids() -> None:
    """Solutions of meshes that lock or oscillate are not; a square peg on the thinnest gel was left out for
    that.
    """
    along = np.arange(-9.5, 9.51, 0.25)
    x, y = np.meshgrid(along, along)
    places = np.column_stack((x.ravel(), y.ravel()))
    for field in (fields.Field.load(name) for name in CONTACTS):
        for stage in range(len(field.stages)) if "share" in field.arrays else []:
            touching = places[field.touching(stage, places)]
            assert len(touching) > 0, f"{field.meta['part']}, stage {stage}"
            far = cKDTree(touching).query(places)[0].reshape(x.shape) > 2.0
            height = field.motion(stage, places)[:, 2].reshape(x.shape)
            bends = [np.abs(np.diff(height, 2, axis=axis)) for axis in (0, 1)]
            for bend, clear in zip(bends, (far[1:-1], far[:, 1:-1]), strict=True):
                assert np.quantile(bend[clear], 0.99) < 0.01


def test_noise_is_seeded_and_as_large_as_stated() -> None:
    sequence = Sequence.load(STORED[0])
    condition = Condition(read_levels=1.0, shot_levels=2.0)
    clean = sequence.clean(0, "left").astype(float)
    first, again, other = (sequence.pair(0, condition, seed)[0] for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    grey = (clean > 60) & (clean < 200)
    sigma = np.sqrt(1.0 + 4.0 * clean / 255 + 1 / 12)[grey]
    for image in (first, other):
        assert np.std((image - clean)[grey] / sigma) == pytest.approx(1.0, abs=0.02)
    assert not np.array_equal(first, other)


# Median of the mean of three squares of unit normal variables: that of chi-squared with three degrees, over
# three.
MEDIAN_OF_MEAN_SQUARE = 0.7887


# Preset `fast` learns its variance at rest from twelve markers: with three noises of four prints it stated
# 0.7 to 2.1 times the true one.
@pytest.mark.parametrize(("preset", "least"), [("fast", 1 / 2.1), ("balanced", 0.8), ("exact", 0.8)])
def test_row_41_a_tray_in_view_changes_no_variance_of_a_point(preset: str, least: float) -> None:
    """Within the bounds of sensing for the mean, for the typical point: glints and dirt are in the tail."""
    figures = judged(preset, [Sequence.load("w1_press_at_once")], Condition(), {})
    assert least <= np.median(np.concatenate(figures.squared)) / MEDIAN_OF_MEAN_SQUARE <= 1.25
    assert np.mean(figures.f1) >= 0.85


def test_frames_state_what_folds_do_to_the_centres() -> None:
    """A twisted board folds the gel between markers. Most of it shows in one image, too: without
    `detect/folds.rs` its normalised squared error is 17, and 1.1 on gel at rest.
    """
    figures = judged("balanced", [Sequence.load("w5_twist")], Condition(), {})
    assert 0.8 <= np.concatenate(figures.centre_squared).mean() <= 1.25
    at_rest = np.concatenate(figures.alone_squared[:2])
    assert 0.8 <= at_rest.mean() <= 1.25
    assert np.concatenate(figures.alone_squared).mean() < 4.0


@pytest.mark.long
@pytest.mark.parametrize("half", ["w", "j"])
def test_presets_name_markers_right_where_they_see_them(half: str) -> None:
    """All sequences with `balanced`, the other presets with every other one."""
    sequences = [Sequence.load(name) for name in images.names(half)]
    for preset, shown in (("balanced", sequences), ("fast", sequences[::2]), ("exact", sequences[1::2])):
        figures = judged(preset, shown, Condition(), {})
        assert figures.frames == sum(map(len, shown))
        assert figures.wrong == 0


def test_row_36_one_rule_for_gels_by_finite_elements() -> None:
    """Contacts for work: the adaptive rule has at least 0.85 on each law, and the best mean. Without what a
    smooth part explains it has 0.90 and 0.93 on the solved gels.
    """
    scores = judge(0.005, "w", RULES)
    assert len(scores) == 5
    mean_f1 = {rule: np.mean([np.mean(by_rule[rule].f1) for by_rule in scores.values()]) for rule in RULES}
    adaptive = RULES[0]
    assert min(np.mean(by_rule[adaptive].f1) for by_rule in scores.values()) >= 0.85
    for gel, least in (("gel a", 0.91), ("gel c", 0.94)):
        assert np.mean(scores[gel][adaptive].f1) > least
    assert all(mean_f1[adaptive] > mean_f1[rule] for rule in RULES[1:])


def test_the_reference_that_knows_the_gel_is_as_good_as_the_best_rule() -> None:
    by_law = judge(0.005, "w", [])
    for gel, least in (("gel a", 0.9), ("gel c", 0.92)):
        assert np.mean(by_law[gel][REFERENCE].f1) > least


def test_the_references_layer_sinks_as_hookes_law_says() -> None:
    """Under a wide and even pressure p the layer sinks by p t (1 - 2 nu) / (2 G (1 - nu))."""
    side, pitch_mm, thickness_mm, nu = 25, 0.85, 2.0, 0.4
    by_offset = layer_contact.response(thickness_mm, nu, pitch_mm, side)
    expected_mm = thickness_mm * (1 - 2 * nu) / (2 * (1 - nu))
    assert by_offset.shape == (2 * side - 1, 2 * side - 1)
    assert abs(by_offset.sum() / expected_mm - 1.0) < 1e-3
    assert np.allclose(by_offset, by_offset.T) and np.allclose(by_offset, by_offset[::-1, ::-1])


def test_halves_of_grasped_parts_share_no_part_or_length() -> None:
    entries = table("grasped.toml")
    assert not set(entries["parts"]["w"]) & set(entries["parts"]["j"])
    assert not set(entries["parts"]["further"]) & set(entries["parts"]["j"])
    assert set(entries["parts"]["w"] + entries["parts"]["j"]) == {press.name for press in GRASPED}
    assert abs(entries["seeds"]["w"] - entries["seeds"]["j"]) >= max(entries["seeds"]["count"].values())
    for key in ("length_mm", "thickness_mm", "poisson_ratio"):
        laws = [
            {(e["law"], e[key]) for e in entries["laws"].values() if key in e and e["half"] == h}
            for h in "wj"
        ]
        assert laws[0] and laws[1] and not laws[0] & laws[1]


def test_every_part_is_stored_under_every_law_of_its_half() -> None:
    for name, (_, _, seeds) in grasped.jobs().items():
        with np.load(grasped.DATA / f"{name}.npz") as file:
            assert file["poses"].shape == (len(seeds), 4, 4)
            assert file["points_mm"].shape == (len(seeds), 625, 3)
            assert np.isfinite(file["points_mm"]).all()


@pytest.mark.parametrize("law", ["none_w", "exponential_w2", "membrane_w1", "layer_w1"])
def test_markers_that_touch_lie_on_the_part_and_none_is_in_it(law: str) -> None:
    name = f"{law}_square_peg"
    part = grasped.jobs()[name][1].make()
    with np.load(grasped.DATA / f"{name}.npz") as file:
        for pose, points, bits in zip(
            *(file[key] for key in ("poses", "points_mm", "touching")), strict=True
        ):
            under = grasped.Underside(part, pose)
            across = points[:, :2].astype(float) - grasped.VGA.centre_mm
            over_mm = grasped.SURFACE_MM - points[:, 2] - under.at(across)
            touching = np.unpackbits(bits, count=625).astype(bool)
            # Stored to a fraction of a micrometre, on faces up to some 80 degrees steep.
            assert over_mm.min() > -0.01
            assert np.abs(over_mm[touching]).max() < 0.01
            assert touching.sum() >= grasped.MIN_TOUCHING


def test_a_layer_meets_the_part_and_bulges_beside_it() -> None:
    layer = bonded.Layer(4.0, 0.4999)
    normal, outward = layer.compliances(np.array([1e-3, 0.5, 8.0]))
    # Incompressible: a long wave of pressure moves nothing down, and a short one as much as a half-space.
    assert normal[0] < 1e-2 * normal[1]
    assert normal[2] == pytest.approx(2 * (1 - 0.4999**2) / 8.0, rel=1e-3)
    assert outward[1] > 0.0
    along = np.linspace(-13.0, 13.0, 105)
    y, x = np.meshgrid(along, along, indexing="ij")
    height, right, _ = bonded.pressed(layer, 1.0 - (x**2 + y**2) / 8.0, along)
    assert height.max() == pytest.approx(1.0, abs=0.01)
    # It bulges beside the contact, and far off it is at rest.
    assert height.min() < -0.02 and abs(height[0]).max() < 0.01
    # Outward on both sides.
    assert right[52, 60] > 0.0 > right[52, 44]
