"""Motion beside contacts solved by finite elements, by the simulator's elastic layer (docs/outside.md)."""

from __future__ import annotations

import numpy as np
import pytest

from outside import judge_motion


@pytest.fixture(scope="module")
def contacts() -> list[judge_motion.Contact]:
    return list(judge_motion.contacts("w"))


def test_markers_are_in_contact_or_free_but_not_both(contacts: list[judge_motion.Contact]) -> None:
    assert len(contacts) == 17
    for contact in contacts:
        assert not (contact.touches & contact.free).any() and not (contact.beyond & ~contact.free).any()
        # The part presses into the gel.
        assert contact.motion_mm[contact.touches][:, 2].max() > 0.3


def test_a_layer_explains_most_of_a_wide_gel(contacts: list[judge_motion.Contact]) -> None:
    shares = []
    for contact in contacts:
        if contact.name == "balls" and contact.thickness_mm == 2.0:
            layer, _ = judge_motion.by_layer(contact)
            off = (layer - contact.motion_mm)[contact.beyond]
            shares.append((np.sum(off**2), np.sum(contact.motion_mm[contact.beyond] ** 2)))
    left, moved = np.sum(shares, axis=0)
    assert np.sqrt(left / moved) < 0.1


def test_forces_push_into_the_gel_and_forward(contacts: list[judge_motion.Contact]) -> None:
    for contact in contacts:
        _, forces = judge_motion.by_layer(contact)
        assert forces[..., 2].sum() < 0.0
        assert np.allclose(forces[~contact.touches], 0.0)
