"""Second step: the print, from the first images at rest."""

from __future__ import annotations

from typing import Any

from gelstereo.cli.files import read_color_image
from gelstereo.extras import needs
from gelstereo.inspection import inspect
from gelstereo.inspection.picture import draw_inspection
from gelstereo.setup.plan import Plan
from gelstereo.setup.step import Figure, Step

with needs(__name__):
    import cv2

__all__ = ["look", "outline_px", "pitch_setting"]

#: Dots that differ less from the gel, in units of the pixels' noise, are measured badly: the error of a
#: centre is inverse to this ratio.
MIN_CONTRAST = 10.0


def pitch_setting(plan: Plan) -> float | list[float]:
    """The pitch as settings have it: one number for a square print."""
    x_mm, y_mm = plan.pitch_mm
    return x_mm if x_mm == y_mm else [x_mm, y_mm]


def outline_px(plan: Plan, view: str) -> Any:
    """Polygon around the gel in a view's image, from the plan's settings; ``None`` without one."""
    if corners_px := plan.params.get(f"detect.roi.{view}_outline_px"):
        return corners_px
    if (rect_px := plan.params.get(f"detect.roi.{view}_px")) is None:
        return None
    x, y, width, height = rect_px
    return [[x, y], [x + width, y], [x + width, y + height], [x, y + height]]


def look(plan: Plan) -> Step:
    """Inspect the print in both views, and choose the settings from the left one."""
    views = {"left": plan.rest.left[0], "right": plan.rest.right[0]}
    images = {view: read_color_image(path) for view, path in views.items()}
    found = {
        view: inspect(image, preset=plan.preset, outline_px=outline_px(plan, view))
        for view, image in images.items()
    }
    figures, doubts = [], []
    for view, seen in found.items():
        layout = seen.layout
        figures += [
            Figure(f"{view}: dots", f"{len(seen.dots_px)} {seen.polarity} ones of {seen.dot_px:.1f} px"),
            Figure(f"{view}: rows x columns", f"{layout.rows} x {layout.cols}, {layout.kind}"),
            Figure(
                f"{view}: contrast over noise", f"{seen.contrast / max(seen.noise, 0.1):.0f}", "10 or more"
            ),
        ]
        if seen.contrast < MIN_CONTRAST * seen.noise:
            doubts.append(f"the dots of the {view} view are faint: use more light or a longer exposure")
        if layout.kind == "irregular":
            doubts.append(
                f"the print of the {view} view is irregular, and the pipeline needs rows and columns: "
                "gelstereo.scattered takes any layout"
            )
        elif not layout.is_whole:
            doubts.append(f"the print reaches beyond the {view} view: its border rows are not counted")
    left = found["left"]
    if left.channel != found["right"].channel:
        doubts.append(
            f"the print shows best in {left.channel} in the left view, and otherwise in the right one"
        )
    settings = {**left.settings, "lattice.pitch_mm": pitch_setting(plan), **plan.params}
    _, content = cv2.imencode(".png", draw_inspection(images["left"], left))
    caption = "Left view at rest. Dots on the lattice have green rings, others red ones."
    return Step(
        "print",
        "Print",
        tuple(figures),
        tuple(doubts),
        (),
        {"settings": settings},
        content.tobytes(),
        caption,
    )
