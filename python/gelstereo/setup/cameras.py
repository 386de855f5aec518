"""First step: the cameras, from images of a board."""

from __future__ import annotations

from gelstereo.calibrate import calibrate_stereo
from gelstereo.progress import Progress
from gelstereo.setup.plan import Plan
from gelstereo.setup.step import Figure, Step

__all__ = ["calibrate"]

#: A calibration with a larger residual has blurred images, a board that is not flat, or moved pairs: the
#: corners of sharp images are measured to a tenth of a pixel.
MAX_RMS_PX = 0.5
#: Largest ratio of the error in pairs that were not used to the residual.
MAX_HELD_OUT = 3.0


def calibrate(plan: Plan) -> Step:
    """Calibrate the cameras."""
    with Progress("calibrating the cameras") as progress:
        found = calibrate_stereo(
            plan.cameras.left, plan.cameras.right, board=plan.board, drop_outliers=True, progress=progress
        )
    rms_px = found.stereo.rms_px
    figures = [
        Figure("pairs used", f"{found.used} of {len(found.pairs)}", "10 or more"),
        Figure("residual", f"{rms_px:.3f} px rms", f"below {MAX_RMS_PX} px"),
        Figure("distance of the cameras", f"{found.baseline_mm:.3f} mm"),
    ]
    doubts: list[str] = []
    if found.held_out is not None:
        held = found.held_out
        figures += [
            Figure("error in pairs not used", f"{held.transfer_px:.3f} px rms", "near the residual"),
            Figure("lengths of squares", f"{1e3 * held.square_bias_mm:+.1f} um in the mean"),
        ]
        if held.transfer_px > MAX_HELD_OUT * rms_px:
            doubts.append("pairs that were not used fit worse than those that were: take more pairs")
    if rms_px > MAX_RMS_PX:
        doubts.append("the residual is large: check focus, that the board is flat, and that nothing moved")
    values = {"rig": found.rig.to_toml()}
    return Step("cameras", "Cameras", tuple(figures), tuple(doubts), found.hints, values)
