"""What frames, poses and rigs look like in a notebook: HTML with pictures in SVG, made by NumPy alone.

The native classes call these functions from ``_repr_html_`` and ``_repr_png_``.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import Frame, Localization, Rig, SimulatedFrame
from gelstereo.extras import needs
from gelstereo.geometry import se3_log
from gelstereo.states import MarkerState

__all__ = ["frame_html", "localization_html", "pair_png", "rig_html"]

Floats = npt.NDArray[np.float64]

_SENSOR_FRAME = "sensor frame: x right, y down, z away from the left camera"
_WIDTH_PX = 420.0
_INK, _CONTACT, _HELD = "#555", "#d62728", "#bbb"
#: Colours of the axes x, y, z.
_AXES = ("#d62728", "#2ca02c", "#1f77b4")
#: Levels of the colour bar.
_LEVELS = 24


def frame_html(frame: Frame) -> str:
    """A table of figures, and the markers in the left image, coloured by indentation.

    Parameters
    ----------
    frame : Frame

    Returns
    -------
    str
        HTML.
    """
    seen = int(np.count_nonzero(frame.state == MarkerState.SEEN))
    in_contact = int(np.count_nonzero(frame.patch))
    rows = [
        ("frame", f"{frame.index}"),
        ("markers", f"{frame.rows} x {frame.cols}, {seen} seen"),
        ("in contact", f"{in_contact}"),
        ("greatest indentation", f"{np.max(frame.indentation_mm, initial=0.0):.3f} mm towards the cameras"),
        ("mean motion", f"{frame.motion_px:.2f} px in the left image, since the reference"),
    ]
    note = "Left image, x right, y down. Colour: indentation. Red rings: contact. Grey: not seen."
    return _page("Frame", rows, _markers_svg(frame), note)


def localization_html(found: Localization) -> str:
    """A table of the pose, its standard deviations at the part's origin, and what the contact leaves free.

    Parameters
    ----------
    found : Localization

    Returns
    -------
    str
        HTML.
    """
    sigma = found.sigma_at()
    position, turn = found.t_sensor_object[:3, 3], _turn_deg(found.t_sensor_object)
    odds = "" if found.log_odds is None else f", log odds {found.log_odds:.1f}"
    rows = [
        ("verdict", found.verdict.replace("_", " ") + odds),
        ("position of the part's origin", f"{_vector(position, 3)} mm, sigma {_vector(sigma[3:], 3)} mm"),
        ("rotation vector", f"{_vector(turn, 2)} degrees, sigma {_vector(np.degrees(sigma[:3]), 2)} degrees"),
        ("free, in the object frame", "; ".join(str(free) for free in found.free) or "nothing"),
        ("fit", f"rmse {found.rmse_mm:.4f} mm, {found.inliers} of {found.points} points within reach"),
        ("model", found.model),
    ]
    if found.alternatives:
        rows.append(("alternatives", f"{len(found.alternatives)}"))
    note = f"Pose and sigma are in the {_SENSOR_FRAME}. Free directions have the sigma of the guess."
    return _page("Localization: part in the sensor frame", rows, _axes_svg(found.t_sensor_object), note)


def rig_html(rig: Rig) -> str:
    """A table of both cameras, their baseline, and the layers before them.

    Parameters
    ----------
    rig : Rig

    Returns
    -------
    str
        HTML.
    """
    rows = [
        ("image", "{} x {} px".format(*rig.size_px)),
        ("focal length", _focal(rig.left_matrix) + " left, " + _focal(rig.right_matrix) + " right"),
        ("baseline", f"{rig.baseline_mm:.4f} mm"),
        ("right camera turned by", f"{_vector(_turn_deg(rig.t_right_left), 2)} degrees"),
        ("layers", _layers(rig.layers) if rig.layers else "none: no refraction"),
    ]
    return _page("Rig", rows, "", f"Points are in the {_SENSOR_FRAME}.")


def pair_png(pair: SimulatedFrame) -> bytes:
    """Both images of a simulated pair side by side, the left camera's on the left, as a PNG file.

    Parameters
    ----------
    pair : SimulatedFrame

    Returns
    -------
    bytes
    """
    with needs(__name__):
        import cv2

    _, data = cv2.imencode(".png", np.hstack([pair.left, pair.right]))
    return bytes(data)


def _layers(layers: dict[str, Any]) -> str:
    """The layers before the cameras, from the camera to the gel."""
    plates = [f"plate {plate['thickness_mm']:g} mm, index {plate['index']:g}" for plate in layers["plates"]]
    parts = [f"gap {layers['gap_mm']:g} mm", *plates, f"gel, index {layers['gel_index']:g}"]
    return "; ".join(parts) + f"; normal {_vector(layers['normal'], 3)}"


def _focal(matrix: Floats) -> str:
    return f"{matrix[0, 0]:.1f}, {matrix[1, 1]:.1f} px"


def _vector(values: Iterable[float], digits: int) -> str:
    return "(" + ", ".join(f"{value:.{digits}f}" for value in values) + ")"


def _turn_deg(pose: Floats) -> Floats:
    """The rotation vector of a pose, degrees."""
    return np.degrees(se3_log(pose)[:3])


def _page(title: str, rows: list[tuple[str, str]], picture: str, note: str) -> str:
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td "
        f"style='text-align:left'>{escape(value)}</td></tr>"
        for name, value in rows
    )
    return (
        f"<div><strong>{escape(title)}</strong><table>{cells}</table>{picture}"
        f"<div style='color:{_INK};font-size:85%'>{escape(note)}</div></div>"
    )


def _svg(width: float, height: float, label: str, shapes: list[str]) -> str:
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' width='{width:.0f}' height='{height:.0f}'"
        f" role='img' aria-label='{escape(label)}' font-family='sans-serif' font-size='12'"
        f" fill='{_INK}'>{''.join(shapes)}</svg>"
    )


def _text(x: float, y: float, text: str, colour: str = _INK) -> str:
    return f"<text x='{x:.1f}' y='{y:.1f}' fill='{colour}'>{escape(text)}</text>"


def _line(start: Floats, end: Floats, colour: str, width: float = 2.0) -> str:
    (x1, y1), (x2, y2) = start, end
    ends = f"x1='{x1:.1f}' y1='{y1:.1f}' x2='{x2:.1f}' y2='{y2:.1f}'"
    return f"<line {ends} stroke='{colour}' stroke-width='{width:g}'/>"


def _axes_svg(t_sensor_object: Floats) -> str:
    """The axes of the sensor and of the part, seen along the sensor's z axis as the left camera sees them."""
    shapes: list[str] = []
    for title, x, turn in ("sensor", 75.0, np.eye(3)), ("part", 235.0, t_sensor_object[:3, :3]):
        centre = np.array([x, 90.0])
        shapes.append(_text(x - 70.0, 14.0, f"axes of the {title}"))
        # The axis that points furthest away from the camera is drawn first.
        for axis in np.argsort(-turn[2]):
            tip = centre + 48.0 * turn[:2, axis]
            shapes.append(_line(centre, tip, _AXES[axis], 3.0))
            away = " (away)" if turn[2, axis] > 0.7 else " (towards)" if turn[2, axis] < -0.7 else ""
            x_text, y_text = centre + 58.0 * turn[:2, axis] + ([8.0, 16.0] if away else [-3.0, 4.0])
            shapes.append(_text(x_text, y_text, "xyz"[axis] + away, _AXES[axis]))
        shapes.append(f"<circle cx='{x:.1f}' cy='90' r='3' fill='{_INK}'/>")
    return _svg(330.0, 165.0, "axes of sensor and part as the left camera sees them", shapes)


def _markers_svg(frame: Frame) -> str:
    """The markers of the left view, a disc each, with the axes of the image and a colour bar."""
    at = frame.left_px
    low, high = at.min(axis=0), at.max(axis=0)
    scale = _WIDTH_PX / max(1.0, float(high[0] - low[0]))
    spot = scale * 0.35 * float(np.median(np.abs(np.diff(at[: frame.cols], axis=0)).max(axis=1)))
    xy = scale * (at - low) + 2 * spot
    width, height = scale * (high - low) + 4 * spot
    top_mm = max(0.1, float(np.max(frame.indentation_mm, initial=0.0)))
    shares = np.clip(frame.indentation_mm / top_mm, 0.0, 1.0)
    discs = [
        _disc(x, y, spot, share, bool(touches), state == MarkerState.SEEN)
        for (x, y), share, touches, state in zip(xy, shares, frame.patch, frame.state, strict=True)
    ]
    return _svg(width + 90.0, height, "markers of the left image", discs + _bar(width + 10.0, height, top_mm))


def _bar(x: float, height: float, top_mm: float) -> list[str]:
    """A colour bar of indentations from 0 to `top_mm`, at `x`."""
    step = 0.5 * height / _LEVELS
    shapes = [
        f"<rect x='{x:.1f}' y='{20.0 + level * step:.1f}' width='14' height='{step + 0.5:.1f}'"
        f" fill='{_colour(1.0 - level / (_LEVELS - 1))}'/>"
        for level in range(_LEVELS)
    ]
    for share in 1.0, 0.5, 0.0:
        y = 24.0 + (1.0 - share) * 0.5 * height
        shapes.append(_text(x + 19.0, y, f"{share * top_mm:.2f} mm"))
    return shapes


def _colour(share: float) -> str:
    """From dark blue at rest to yellow at the greatest indentation."""
    red, green, blue = (round(a + share * (b - a)) for a, b in ((30, 250), (50, 210), (110, 40)))
    return f"rgb({red},{green},{blue})"


def _disc(x: float, y: float, radius: float, share: float, touches: bool, is_seen: bool) -> str:
    fill = _colour(share) if is_seen else _HELD
    ring = f" stroke='{_CONTACT}' stroke-width='{0.35 * radius:.1f}'" if touches else ""
    return f"<circle cx='{x:.1f}' cy='{y:.1f}' r='{radius:.1f}' fill='{fill}'{ring}/>"
