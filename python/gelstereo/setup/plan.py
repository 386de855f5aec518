"""The plan of a setup: which images there are, and what is known of the sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gelstereo._native import Error, Params, ParamsError, parse_toml
from gelstereo.calibrate.board_names import BoardKind
from gelstereo.calibrate.boards import Board
from gelstereo.calibrate.errors import CalibrationError
from gelstereo.calibrate.pairs import expand
from gelstereo.setup.tree import leaves

__all__ = ["EXAMPLE", "Plan", "PlanError", "Views"]

EXAMPLE = """\
# Images and facts for `gelstereo setup`. Paths start at this file's folder.
preset = "balanced"

# The board in air, without the gel: ten pairs or more.
[cameras]
left = "chessboard/left*.png"
right = "chessboard/right*.png"
board = "9x6"        # inner corners; or charuco:8x6, apriltag:6x4
square_mm = 2.0

# The gel at rest: one pair, or better thirty.
[rest]
left = "rest/left/*.png"
right = "rest/right/*.png"
pitch_mm = 0.8       # distance of neighbouring markers; [0.8, 1.0] of a rectangular print

# Plate and gel as designed. Leave it out if nothing bends the light.
[layers]
normal = [0.0, 0.0, 1.0]
gap_mm = 20.5        # from the left camera to the plate
gel_index = 1.43
[[layers.plates]]
thickness_mm = 3.0
index = 1.49

# Standard deviations of what the data sheet states.
[priors]
plate_0_thickness_mm = 0.05
plate_0_index = 0.005

# The gel pressed flat on boards of known height. With them gap, tilt and index are estimated.
[[boards]]
height_mm = 0.8
left = "gel/board_0.8_left.png"
right = "gel/board_0.8_right.png"
[[boards]]
height_mm = 1.8
left = "gel/board_1.8_left.png"
right = "gel/board_1.8_right.png"

# Settings that you know better, for example the outline of a gel that is not rectangular.
# [params.detect.roi]
# left_outline_px = [[120, 40], [520, 40], [600, 240], [520, 440], [120, 440], [40, 240]]

# A part pressed into the gel, with frames at rest before it. A ball of known radius tells the depth of the
# print below the skin, and a part that slides tells the friction.
[presses]
left = "press/left/*.png"
right = "press/right/*.png"
# ball_radius_mm = 6.0

# The gel by a caliper, from its plate to the skin. It tells the depth of the print better than a ball does.
# [gel]
# thickness_mm = 4.0
# thickness_sigma_mm = 0.02
"""


class PlanError(Error):
    """A plan names something that is not there or not valid."""


@dataclass(frozen=True)
class Views:
    """Image files of both views, in the order of the frames."""

    left: tuple[Path, ...]
    right: tuple[Path, ...]

    @property
    def pairs(self) -> tuple[tuple[Path, Path], ...]:
        """Left and right image of each frame."""
        return tuple(zip(self.left, self.right, strict=True))


@dataclass(frozen=True)
class Plan:
    """What `set_up` works on.

    Attributes
    ----------
    cameras, board
        Images of the calibration board, and the board.
    rest
        Images of the gel at rest.
    pitch_mm
        Distance of neighbouring markers along rows and along columns.
    preset
        Preset that the settings start from.
    layers
        Plate and gel as designed, as in a rig file; ``None`` if nothing bends the light.
    priors
        Standard deviations of designed values, by parameter name.
    boards
        Height of each flat board in mm, and its images.
    presses
        Images of presses, with frames at rest before them; ``None`` without any.
    ball_radius_mm
        Radius of the ball that is pressed; ``None`` for another part.
    thickness_mm
        Measured thickness of the gel, from its plate to the skin, and its standard deviation; ``None`` if it
        is not known. It is read with the presses.
    params
        Settings that take precedence over what the steps find, as `Params.replace` takes them.
    """

    cameras: Views
    board: Board
    rest: Views
    pitch_mm: tuple[float, float]
    preset: str = "balanced"
    layers: Mapping[str, Any] | None = None
    priors: Mapping[str, float] = field(default_factory=dict)
    boards: tuple[tuple[float, Views], ...] = ()
    presses: Views | None = None
    ball_radius_mm: float | None = None
    thickness_mm: tuple[float, float] | None = None
    params: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path) -> Plan:
        """Read a plan file.

        Raises
        ------
        PlanError
            A key is missing, unknown or has no valid value, or a pattern matches no file.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(2, "No such plan", str(path))
        tree = parse_toml(path.read_text(encoding="utf-8"))
        known = {"preset", "cameras", "rest", "layers", "priors", "boards", "presses", "gel", "params"}
        _refuse_unknown(tree, known, str(path))
        for name in ("cameras", "rest"):
            if name not in tree:
                raise PlanError(f"{path} has no [{name}]; `gelstereo setup --example` prints a plan")
        preset = tree.get("preset", "balanced")
        if preset not in Params.presets():
            raise PlanError(f"preset is {preset!r}; valid are {', '.join(Params.presets())}")
        cameras, rest, folder = tree["cameras"], tree["rest"], path.parent
        lengths = {"square_mm", "marker_mm", "gap_mm", "dictionary"}
        _refuse_unknown(cameras, {"left", "right", "board", *lengths}, "[cameras]")
        _refuse_unknown(rest, {"left", "right", "pitch_mm"}, "[rest]")
        boards = tree.get("boards", [])
        for board in boards:
            _refuse_unknown(board, {"height_mm", "left", "right"}, "[[boards]]")
        presses = tree.get("presses")
        if presses is not None:
            _refuse_unknown(presses, {"left", "right", "ball_radius_mm"}, "[presses]")
        gel = tree.get("gel")
        if gel is not None:
            _refuse_unknown(gel, {"thickness_mm", "thickness_sigma_mm"}, "[gel]")
            if presses is None:
                raise PlanError("[gel] is read with the presses; give [presses] too")
        priors = tree.get("priors", {})
        return cls(
            cameras=_views(folder, cameras, "[cameras]"),
            board=_board(cameras),
            rest=_views(folder, rest, "[rest]"),
            pitch_mm=_pitch(rest),
            preset=preset,
            layers=tree.get("layers"),
            priors={name: _length(priors, name, "[priors]") for name in priors},
            boards=tuple(
                (_length(board, "height_mm", "[[boards]]"), _views(folder, board, "[[boards]]"))
                for board in boards
            ),
            presses=None if presses is None else _views(folder, presses, "[presses]"),
            ball_radius_mm=_length(presses, "ball_radius_mm", "[presses]")
            if presses is not None and "ball_radius_mm" in presses
            else None,
            thickness_mm=None
            if gel is None
            else (_length(gel, "thickness_mm", "[gel]"), _length(gel, "thickness_sigma_mm", "[gel]")),
            params=_settings(preset, tree.get("params", {})),
        )


def _refuse_unknown(tree: Mapping[str, Any], known: set[str], where: str) -> None:
    for name in tree:
        if name not in known:
            raise PlanError(f"{where} has an unknown key {name!r}; valid are {', '.join(sorted(known))}")


def _length(tree: Mapping[str, Any], name: str, where: str) -> float:
    value = tree.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < float("inf"):
        raise PlanError(f"{name} in {where} is {value!r}; valid is a number above 0")
    return float(value)


def _settings(preset: str, params: Mapping[str, Any]) -> dict[str, Any]:
    """Settings by dotted names; checked against the preset."""
    try:
        Params.preset(preset).replace(params)
    except ParamsError as error:
        raise PlanError(f"[params]: {error}") from error
    return leaves(params)


def _pitch(rest: Mapping[str, Any]) -> tuple[float, float]:
    value = rest.get("pitch_mm")
    if not isinstance(value, list):
        both = _length(rest, "pitch_mm", "[rest]")
        return both, both
    if len(value) != 2:
        raise PlanError(f"pitch_mm in [rest] is {value!r}; valid is a number above 0, or two as [x, y]")
    x_mm, y_mm = (_length({"pitch_mm": axis}, "pitch_mm", "[rest]") for axis in value)
    return x_mm, y_mm


def _views(folder: Path, tree: Mapping[str, Any], where: str) -> Views:
    files = []
    for view in ("left", "right"):
        pattern = tree.get(view)
        if not isinstance(pattern, str):
            raise PlanError(f"{view} in {where} is {pattern!r}; valid is a file name or pattern")
        try:
            files.append(tuple(expand([str(folder / pattern)])))
        except CalibrationError as error:
            raise PlanError(f"{view} in {where}: {error}") from error
    if len(files[0]) != len(files[1]):
        raise PlanError(
            f"{where} has {len(files[0])} left and {len(files[1])} right images; "
            "both views need one of each frame"
        )
    return Views(*files)


def _board(cameras: Mapping[str, Any]) -> Board:
    text = cameras.get("board")
    if not isinstance(text, str):
        raise PlanError(f"board in [cameras] is {text!r}; valid is for example '9x6' or 'charuco:8x6'")
    try:
        return BoardKind.parse(text).board(cameras)
    except CalibrationError as error:
        raise PlanError(f"[cameras]: {error}") from error
