"""Forces of a recording: its images are sensed again."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gelstereo._native import Compliance, Frame, Params, Pipeline
from gelstereo.export.errors import ExportError
from gelstereo.export.recording import RecordedFrame, recorded_frames
from gelstereo.export.tactile import force_features
from gelstereo.view.mcap_file import read_header
from gelstereo.view.recorded_part import rig_of


def frames_with_forces(path: Path, settings: Params | None = None) -> Iterator[RecordedFrame]:
    """The frames of a recording with the features ``force``, ``full`` and ``wrench``.

    Parameters
    ----------
    path
        A recording with the images of both views.
    settings
        Their table ``force`` replaces that of the recording.

    Raises
    ------
    ExportError
        If the settings have no ``force.method``, or the recording has no images.
    """
    header = read_header(path)
    params = Params().replace(header.config.get("params", {}))
    if settings is not None:
        params = params.replace(force=settings.to_dict()["force"])
    tree = params.to_dict()
    if tree["force"]["method"] == "none":
        raise ExportError(
            f"{path} was recorded without force.method; state the settings of the gel: --force FILE, where "
            "FILE is that of gelstereo calibrate-force"
        )
    # A host that has the gel's compliance matrix attaches it to its recordings.
    attached = header.attachments.get("gel.compliance")
    uses_it = attached is not None and tree["force"]["method"] != "resultant"
    compliance = Compliance.from_bytes(attached) if attached is not None and uses_it else None
    pipeline = Pipeline(rig_of(header), params, compliance=compliance)
    rest: Frame | None = None
    for frame in recorded_frames(path):
        missing = {"left", "right"} - set(frame.images)
        if missing:
            raise ExportError(
                f"{path} has no {sorted(missing)[0]} image of the frame at {frame.time_ns} ns; forces need "
                "the images of both views of every frame"
            )
        sensed = pipeline.process(frame.images["left"], frame.images["right"])
        rest = rest or sensed
        yield dataclasses.replace(frame, tactile=_tactile(sensed, rest, tree))


def _tactile(sensed: Frame, rest: Frame, tree: dict[str, Any]) -> dict[str, Any]:
    force_n = torque_nmm = np.zeros(3)
    if sensed.wrench is not None:
        about_origin = sensed.wrench.about([0.0, 0.0, 0.0])
        force_n, torque_nmm = about_origin.force_n, about_origin.torque_nmm
    moved_mm, pitch_mm = sensed.points_mm - rest.points_mm, tree["lattice"]["pitch_mm"]
    return force_features(moved_mm, sensed.traction_kpa, pitch_mm, force_n, torque_nmm)
