"""What frames, poses and rigs look like in a notebook: HTML with pictures in SVG, made by NumPy alone.

The native classes call these functions from ``_repr_html_``.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np
import numpy.typing as npt

from gelstereo._native import Frame, Localization, Rig
from gelstereo.geometry import se3_log
from gelstereo.states import MarkerState

__all__ = ["frame_html", "localization_html", "rig_html"]

Floats = npt.NDArray[np.float64]

_SENSOR_FRAME = "sensor frame: x right, y down, z away from the left camera"
_WIDTH_PX = 420.0
_INK, _CONTACT, _HELD = "#555", "#d62728", "#bbb"


def frame_html(frame: Frame) -> str:
    """A table of figures, and the markers in the left image, coloured by height.

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
        ("deepest", f"{np.max(frame.indentation_mm, initial=0.0):.3f} mm above rest"),
        ("mean motion", f"{frame.motion_px:.2f} px since the reference"),
    ]
    note = "Left image. Colour: height above rest; red rings: contact; grey: not seen."
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
        ("position", f"{_vector(position, 3)} mm, sigma {_vector(sigma[3:], 3)} mm"),
        ("rotation vector", f"{_vector(turn, 2)} degrees, sigma {_vector(np.degrees(sigma[:3]), 2)} degrees"),
        ("free", "; ".join(str(free) for free in found.free) or "nothing"),
        ("fit", f"rmse {found.rmse_mm:.4f} mm, {found.inliers} of {found.points} points within reach"),
        ("model", found.model),
    ]
    if found.alternatives:
        rows.append(("alternatives", f"{len(found.alternatives)}"))
    note = f"The part's origin in the {_SENSOR_FRAME}. Free directions are in the object's frame."
    return _page("Localization", rows, "", note)


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
        ("layers", f"{rig.layers}" if rig.layers else "none: light goes straight"),
    ]
    return _page("Rig", rows, "", f"Points are in the {_SENSOR_FRAME}.")


def _focal(matrix: Floats) -> str:
    return f"{matrix[0, 0]:.1f}, {matrix[1, 1]:.1f} px"


def _vector(values: Iterable[float], digits: int) -> str:
    return "(" + ", ".join(f"{value:.{digits}f}" for value in values) + ")"


def _turn_deg(pose: Floats) -> Floats:
    """The rotation vector of a pose, degrees."""
    return np.degrees(se3_log(pose)[:3])


def _page(title: str, rows: list[tuple[str, str]], picture: str, note: str) -> str:
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td style='text-align:left'>{escape(value)}</td></tr>"
        for name, value in rows
    )
    return (
        f"<div><strong>{escape(title)}</strong><table>{cells}</table>{picture}"
        f"<div style='color:{_INK};font-size:85%'>{escape(note)}</div></div>"
    )


def _markers_svg(frame: Frame) -> str:
    """The markers of the left view, a disc each."""
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
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' width='{width:.0f}' height='{height:.0f}'"
        f" role='img' aria-label='markers of the left image'>{''.join(discs)}</svg>"
    )


def _disc(x: float, y: float, radius: float, share: float, touches: bool, is_seen: bool) -> str:
    # From dark blue at rest to yellow at the deepest.
    red, green, blue = (round(a + share * (b - a)) for a, b in ((30, 250), (50, 210), (110, 40)))
    fill = f"rgb({red},{green},{blue})" if is_seen else _HELD
    ring = f" stroke='{_CONTACT}' stroke-width='{0.35 * radius:.1f}'" if touches else ""
    return f"<circle cx='{x:.1f}' cy='{y:.1f}' r='{radius:.1f}' fill='{fill}'{ring}/>"
