"""What a notebook shows of frames, poses and rigs: well-formed, with the figures that the objects have."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest
from test_localize_frame import PARAMS, grasp

import gelstereo as gs

__all__ = ["grasp"]


@pytest.fixture(scope="module")
def shown(grasp: tuple) -> dict[str, str]:
    frame, template, guess = grasp
    found = gs.localize(frame, template, guess=guess, params=PARAMS)
    rig = gs.simulate("board_0_8_refraction").scene.rig
    return {"frame": frame._repr_html_(), "found": found._repr_html_(), "rig": rig._repr_html_()}


@pytest.mark.parametrize("what", ["frame", "found", "rig"])
def test_what_is_shown_is_well_formed(shown: dict[str, str], what: str) -> None:
    ElementTree.fromstring(shown[what])


def test_a_frame_shows_every_marker_and_the_contact(grasp: tuple, shown: dict[str, str]) -> None:
    frame = grasp[0]
    discs = ElementTree.fromstring(shown["frame"]).findall(".//{http://www.w3.org/2000/svg}circle")
    assert len(discs) == frame.rows * frame.cols
    assert sum("stroke" in disc.attrib for disc in discs) == frame.patch.sum() > 0


def test_a_pose_says_in_which_frame_it_is_and_what_is_free(shown: dict[str, str]) -> None:
    for words in ("fits", "sensor frame", "sigma", "spin about z", "gel"):
        assert words in shown["found"]


def test_a_rig_shows_its_layers(shown: dict[str, str]) -> None:
    assert "baseline" in shown["rig"] and "mm" in shown["rig"] and "none" not in shown["rig"]
