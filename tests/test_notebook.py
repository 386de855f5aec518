"""What a notebook shows of frames, poses and rigs: well-formed, with the figures that the objects have."""

from __future__ import annotations

from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from test_localize_frame import PARAMS, grasp

import gelstereo as gs

__all__ = ["grasp"]

SVG = "{http://www.w3.org/2000/svg}"


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
    picture = ElementTree.fromstring(shown["frame"])
    discs = picture.findall(f".//{SVG}circle")
    assert len(discs) == frame.rows * frame.cols
    assert sum("stroke" in disc.attrib for disc in discs) == frame.patch.sum() > 0
    levels = [text.text for text in picture.findall(f".//{SVG}text")]
    assert levels == [f"{share * frame.indentation_mm.max():.2f} mm" for share in (1.0, 0.5, 0.0)]
    assert "Left image, x right, y down" in shown["frame"]


def test_a_pose_says_in_which_frame_it_is_and_what_is_free(shown: dict[str, str]) -> None:
    for words in ("fits", "sensor frame", "sigma", "spin about z", "gel"):
        assert words in shown["found"]


def test_the_axes_of_a_pose_are_drawn_as_the_camera_sees_them(grasp: tuple, shown: dict[str, str]) -> None:
    frame, template, guess = grasp
    turn = gs.localize(frame, template, guess=guess, params=PARAMS).t_sensor_object[:3, :3]
    lines = ElementTree.fromstring(shown["found"]).findall(f".//{SVG}line")
    ends = [[float(line.get(f"{name}{end}")) for name in "xy"] for line in lines for end in (1, 2)]
    along = np.diff(np.reshape(ends, (6, 2, 2)), axis=1)[:, 0] / 48.0
    farthest_first = np.argsort(-turn[2])
    np.testing.assert_allclose(along[:3], np.eye(3)[[2, 0, 1], :2], atol=0.01)
    np.testing.assert_allclose(along[3:], turn[:2, farthest_first].T, atol=0.01)


def test_a_simulated_pair_shows_both_images() -> None:
    pair = gs.simulate("press_sphere")[0]
    picture = cv2.imdecode(np.frombuffer(pair._repr_png_(), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(picture, np.hstack([pair.left, pair.right]))


def test_a_rig_shows_its_layers(shown: dict[str, str]) -> None:
    for words in (
        "baseline",
        "gap 20 mm; plate 3 mm, index 1.49; gel, index 1.41; normal (0.000, 0.000, 1.000)",
    ):
        assert words in shown["rig"]
