"""The steps of a recording in Rerun."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gelstereo.extras import needs
from gelstereo.view.moment import Moment
from gelstereo.view.rerun_stream import RerunStream
from gelstereo.view.steps import Step, Steps, notes_of

with needs(__name__):
    import rerun

_NS_PER_S = 1e9
_PART_COLOUR = (120, 200, 120)


def log_steps(steps: Steps, file: Path | None) -> int:
    """Log all steps to a file for Rerun, or to its viewer; returns how many.

    Raises
    ------
    Error
        If there is neither a file nor a display.
    RecordingError
        If the recording has no steps.
    """
    count = 0
    with RerunStream("gelstereo_view", file, "name a file for it: --rerun FILE") as sink:
        for step in steps:
            if sink.has_ended():
                break
            _log(sink, step, steps.moment(step))
            count += 1
    return count


def _log(sink: RerunStream, step: Step, moment: Moment) -> None:
    stream = sink.stream
    stream.set_time("source", duration=step.time_ns / _NS_PER_S)
    stream.set_time("step", sequence=step.number)
    stream.log("image/left", rerun.Image(moment.left))
    sink.log_markers(moment.left_px, moment.reference_px, moment.state, moment.salient)
    sink.log_gel(moment.points_mm, moment.indentation_mm)
    if step.motion_px is not None:
        stream.log("contact/motion_px", rerun.Scalars(float(step.motion_px)))
    stream.log("step", rerun.TextDocument("\n".join([step.place, *notes_of(step)])))
    for event in step.events:
        stream.log("events", rerun.TextLog(event, level="WARN"))
    if step.outcome:
        stream.log("events", rerun.TextLog(step.outcome, level="INFO"))
    _log_part(sink, moment)


def _log_part(sink: RerunStream, moment: Moment) -> None:
    if moment.part is None or moment.part_edges_px is None:
        for entity in ("sensor/part", "image/left/part"):
            sink.stream.log(entity, rerun.Clear(recursive=False))
        return
    mesh = rerun.Mesh3D(
        vertex_positions=moment.part.vertices_mm,
        triangle_indices=moment.part.triangles,
        albedo_factor=_PART_COLOUR,
    )
    sink.stream.log("sensor/part", mesh)
    height, width = moment.left.shape
    edges = moment.part_edges_px
    shown = ((edges >= 0.0) & (edges < np.array([width, height]))).all(axis=(1, 2))
    strips = rerun.LineStrips2D(edges[shown] + 0.5, colors=[90, 220, 90], radii=1.0)
    sink.stream.log("image/left/part", strips)
