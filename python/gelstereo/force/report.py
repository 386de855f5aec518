"""The report of a force calibration, as one page that opens offline."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np

from gelstereo.force.fit import ForceCalibration, percent
from gelstereo.force.loads import COMPONENTS
from gelstereo.view import html

__all__ = ["thickness", "write_report"]

#: Size and border of a picture, pixels.
_SIDE, _EDGE = 420, 56
_COLOURS = {"normal_n": "#1f5fa8", "x_n": "#c2571a", "y_n": "#2f7d4f"}


def write_report(path: Path, calibration: ForceCalibration) -> None:
    """Write what was found, with its pictures."""
    found = calibration
    figures = [
        ["Young's modulus, kPa", f"{found.young_kpa:.1f} ± {found.young_sigma_kpa:.1f}"],
        ["Poisson's ratio", f"{found.poisson_ratio:g}"],
        ["thickness", thickness(found)],
        ["rms error of a load that was left out", percent(found.left_out_rms)],
        ["hysteresis", percent(found.hysteresis)],
        ["errors over their stated size, mean square", f"{found.chi2:.2f}"],
    ]
    blocks: list[html.Block] = [
        html.Paragraph(
            "Forces are those of the part on the gel. Every figure is from the given loads alone."
        ),
        html.Grid("What was found", ("figure", "value"), figures, words=True),
        html.Figure(
            "Measured over known forces; the straight line is equality. Pressing forces are joined in the "
            "order of time: the way down lies above or below the way up by the hysteresis.",
            _scatter(found).encode(),
            "svg",
        ),
        html.Grid(
            "Loads in the order of time: known, measured, and the error by a calibration without this load",
            (
                "load",
                *(f"{name}, known / measured" for name in COMPONENTS),
                "error when left out",
                "creep per decade",
                "contact",
            ),
            [_row(k, found) for k in range(len(found.results))],
        ),
    ]
    for name, tried in (("Poisson's ratio", found.poisson_chi2), ("thickness, mm", found.thickness_chi2)):
        if len(tried) > 1:
            rows = [[f"{value:g}", f"{chi2:.2f}"] for value, chi2 in tried.items()]
            caption = f"Errors over their stated size, mean square, for each value of: {name}"
            blocks.append(html.Grid(caption, (name, "mean square"), rows))
    path.write_text(html.document("Calibration of forces", blocks), encoding="utf-8")


def thickness(found: ForceCalibration) -> str:
    """The gel's thickness as text."""
    off = f" ± {found.thickness_sigma_mm:.2f}" if found.thickness_sigma_mm > 0.0 else ""
    return f"{found.thickness_mm:.4g}{off} mm"


def _row(k: int, calibration: ForceCalibration) -> list[str]:
    result = calibration.results[k]
    pairs = [
        f"{'-' if np.isnan(known) else format(known, '.3g')} / {measured:.3g}"
        for known, measured in zip(result.load.known, result.measured, strict=True)
    ]
    spans = f"{result.load.start_s:g} to {result.load.end_s:g} s"
    contact = "reaches the border" if result.is_cut else "whole"
    return [spans, *pairs, percent(result.left_out), percent(result.creep), contact]


def _scatter(calibration: ForceCalibration) -> str:
    """Measured over known forces, with two standard deviations."""
    points = [
        (name, float(result.load.known[axis]), float(result.measured[axis]), float(result.sigma[axis]))
        for result in calibration.results
        for axis, name in enumerate(COMPONENTS[:3])
        if not np.isnan(result.load.known[axis])
    ]
    values = [value for _, known, measured, _ in points for value in (known, measured)]
    low, high = min([0.0, *values]), max([0.0, *values])
    low, high = low - 0.05 * (high - low), high + 0.08 * (high - low)
    inner = _SIDE - 2 * _EDGE

    def x(value: float) -> float:
        return _EDGE + inner * (value - low) / (high - low)

    def y(value: float) -> float:
        return _SIDE - _EDGE - inner * (value - low) / (high - low)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_SIDE}" height="{_SIDE}" '
        'font-family="sans-serif" font-size="12">',
        f'<line x1="{x(low):.1f}" y1="{y(low):.1f}" x2="{x(high):.1f}" y2="{y(high):.1f}" stroke="#9aa3ad"/>',
        f'<rect x="{_EDGE}" y="{_EDGE}" width="{inner}" height="{inner}" fill="none" stroke="#56606e"/>',
        f'<text x="{_SIDE / 2}" y="{_SIDE - 14}" text-anchor="middle">known force, N</text>',
        f'<text x="16" y="{_SIDE / 2}" text-anchor="middle" transform="rotate(-90 16 {_SIDE / 2})">'
        "measured force, N</text>",
    ]
    pressing = [(known, measured) for name, known, measured, _ in points if name == COMPONENTS[0]]
    way = " ".join(f"{x(known):.1f},{y(measured):.1f}" for known, measured in pressing)
    parts.append(f'<polyline points="{way}" fill="none" stroke="{_COLOURS[COMPONENTS[0]]}" opacity="0.35"/>')
    for tick in np.linspace(low, high, 5)[1:-1]:
        parts.append(
            f'<text x="{x(tick):.1f}" y="{_SIDE - _EDGE + 16}" text-anchor="middle">{tick:.2g}</text>'
        )
        parts.append(f'<text x="{_EDGE - 6}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:.2g}</text>')
    for name, known, measured, sigma in points:
        colour, at = _COLOURS[name], x(known)
        parts.append(
            f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{y(measured - 2 * sigma):.1f}" '
            f'y2="{y(measured + 2 * sigma):.1f}" stroke="{colour}"/>'
            f'<circle cx="{at:.1f}" cy="{y(measured):.1f}" r="4" fill="{colour}"/>'
        )
    for row, (name, colour) in enumerate(_COLOURS.items()):
        at = _EDGE + 18 + 16 * row
        parts.append(f'<text x="{_EDGE + 10}" y="{at}" fill="{colour}">{escape(name[:-2])}</text>')
    return "\n".join([*parts, "</svg>"])
