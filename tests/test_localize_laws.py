"""Verdicts on parts in gels of other laws than the simulator's (`bench/outside`, half for work)."""

from __future__ import annotations

from collections import Counter, defaultdict

import numpy as np
import pytest

from gelstereo import Params
from gelstereo_bench.frontier.nees import Nees
from outside.judge_registration import STARTS, Judged, contacts, registered

PARAMS = Params().replace({"register": {"method": "surface_search", "advanced": {"search_radius_mm": 8.0}}})
CHECKED = PARAMS.replace({"register.surface_search.half_turn_budget": 120_000})
START = STARTS[1]


@pytest.fixture(scope="module")
def pressed() -> list[Judged]:
    return list(contacts("w"))


def is_right(one: Judged, pose: np.ndarray) -> bool:
    return bool(one.grasp.score(np.asarray(pose)).success)


def test_row_49_a_right_pose_is_not_doubted_for_the_law_of_the_gel(pressed: list[Judged]) -> None:
    told: dict[str, Counter[str]] = defaultdict(Counter)
    for one in pressed[::2]:
        found = registered(one, one.grasp.template, one.grasp.guess(START, one.seed), PARAMS)
        if found is not None and one.grasp.score(np.asarray(found.t_sensor_object)).success:
            told["screw" if "screw" in one.grasp.part else "peg"][found.verdict] += 1
    # The gel bridges a thread, which a model on a lattice of markers does not know.
    for name, allowed in (("peg", (0.03, 0.06)), ("screw", (0.2, 0.6))):
        counts = told[name]
        count = counts.total()
        assert count >= 30, name
        assert counts["does_not_fit"] <= allowed[0] * count, (name, counts)
        assert counts["unsure"] <= allowed[1] * count, (name, counts)


def test_row_49_the_truth_lies_in_the_stated_region(pressed: list[Judged]) -> None:
    within: dict[str, list[bool]] = defaultdict(list)
    for one in pressed:
        found = registered(one, one.grasp.template, one.grasp.guess(START, one.seed), PARAMS)
        if found is None or not one.grasp.score(np.asarray(found.t_sensor_object)).success:
            continue
        nees = Nees()
        nees.add(found, one.grasp.t_sensor_object)
        within[one.grasp.part].append(nees.within == 100.0)
    # Of regions that hold the truth in 92 of 100, fewer than 85 % of 70 do with a probability of 2 %. The
    # square peg had 55 %, because gel that hangs from its edge counted as gel on its steep side.
    for part, flags in within.items():
        assert len(flags) >= 70 and np.mean(flags) >= 0.85, (part, len(flags), np.mean(flags))


def test_row_49_another_part_does_not_fit(pressed: list[Judged]) -> None:
    by_part = {one.grasp.part: one.grasp for one in pressed}
    names = list(by_part)
    told: Counter[str] = Counter()
    for one in pressed[::3]:
        grasp = one.grasp
        other = by_part[names[(names.index(grasp.part) + 1 + one.seed % 2) % len(names)]]
        guess = np.array(grasp.guess(START, one.seed))
        guess[:3, 3] += guess[:3, :3] @ (grasp.mesh.bounds.mean(axis=0) - other.mesh.bounds.mean(axis=0))
        found = registered(one, other.template, guess, PARAMS)
        told["refused" if found is None else found.verdict] += 1
    # One in a hundred passes for the part; of 97, more than 4 do with a probability of 0.3 %.
    assert told.total() >= 90 and told["fits"] <= 4, told
    assert told["does_not_fit"] >= 0.7 * told.total(), told


def test_a_pose_on_a_wrong_face_is_unsure_where_half_turns_are_searched(pressed: list[Judged]) -> None:
    # In one gel of each, the pose found from a guess on a wrong face fits as well as noise allows.
    wrong = {("layer", "square peg", 110), ("none", "M10 screw", 104), ("exponential", "M10 screw", 115)}
    count = 0
    for one in pressed:
        if (one.law, one.grasp.part, one.seed) not in wrong:
            continue
        plain = registered(one, one.grasp.template, one.elsewhere(), PARAMS)
        # The other gels with that law give the right pose, or one that is unsure already.
        if plain is None or plain.verdict != "fits" or one.is_alike(np.asarray(plain.t_sensor_object)):
            continue
        count += 1
        found = registered(one, one.grasp.template, one.elsewhere(), CHECKED)
        assert found is not None and found.verdict == "unsure"
        # A part turned there and back is a hundred times likelier, and is taken.
        assert found.log_likelihood > plain.log_likelihood + np.log(99.0)
        assert found.work > plain.work
    assert count == len(wrong)


def test_the_part_turned_end_for_end_about_the_contact_is_found() -> None:
    # Half turns about the middle of these parts lead to other places on them.
    likelier, equal = {("card reader", 101), ("flash drive", 103)}, ("jack plug", 107)
    count = 0
    for one in contacts("further"):
        of = (one.grasp.part, one.seed)
        if one.law != "layer" or of not in {*likelier, equal}:
            continue
        plain = registered(one, one.grasp.template, one.elsewhere(), PARAMS)
        if plain is None or plain.verdict != "fits":
            continue
        count += 1
        found = registered(one, one.grasp.template, one.elsewhere(), CHECKED)
        assert found is not None
        gains = [log - found.log_likelihood for pose, log in found.alternatives if is_right(one, pose)]
        # The grooves of the plug are at equal distances: both ways around explain the contact.
        least = -np.log(100.0) if of == equal else np.log(99.0)
        assert max(gains) > least, of
        assert found.verdict == ("fits" if of == equal else "unsure"), of
    assert count == 4


def test_a_right_pose_fits_where_half_turns_are_searched(pressed: list[Judged]) -> None:
    told: Counter[str] = Counter()
    for one in [one for one in pressed if one.grasp.part == "round peg"][::5]:
        found = registered(one, one.grasp.template, one.grasp.guess(START, one.seed), CHECKED)
        if found is not None and one.grasp.score(np.asarray(found.t_sensor_object)).success:
            told[found.verdict] += 1
    # Of 1033 right poses of the development half, 2 % became unsure.
    assert told.total() >= 15 and told["fits"] >= 0.85 * told.total(), told
