"""Notes of a live recording besides images and clouds, in the host's format: JSON messages and the
configuration.
"""

from __future__ import annotations

import json
import re
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Localization, MarginSource, MarkerState, Params, Rig, Slip, SlipStatus
from gelstereo.live.sensing import LiveResult
from gelstereo.live.source import LiveFrame

Floats = npt.NDArray[np.float64]

#: Name of the attachment with the gel's compliance matrix, as in the host's recordings.
COMPLIANCE = "gel.compliance"
_MM_PER_M = 1000.0

#: Prior standard deviations of a held part for directions that its contact does not determine: the defaults
#: of the host's ``task.part_sigma_mm`` and ``task.part_sigma_rad``.
_PART_SIGMA_MM, _PART_SIGMA_RAD = 0.6, 0.03


def ros_covariance(information: Floats, t_sensor_object: Floats) -> Floats:
    """Covariance of the part's origin and of its rotation about the sensor's axes, in the ROS convention.

    Parameters
    ----------
    information : (6, 6)
        Of a left perturbation (ω, v) in the sensor frame, as in `Localization.information`.
    t_sensor_object : (4, 4)

    Returns
    -------
    (6, 6) float64
        x y z, then rotations about them; metres and radians. Undetermined directions have the prior variance
        of a held part: large but finite, as filters require.
    """
    x, y, z = t_sensor_object[:3, 3]
    # The perturbation moves the origin p by δp = v + ω x p, so v = δp + p x ω.
    jacobian = np.zeros((6, 6))
    jacobian[:3, 3:] = np.eye(3)
    jacobian[3:, :3] = np.eye(3)
    jacobian[3:, 3:] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    sigma = np.array([_PART_SIGMA_MM] * 3 + [_PART_SIGMA_RAD] * 3)
    scaled = jacobian * sigma
    covariance = np.linalg.inv(scaled.T @ information @ scaled + np.eye(6)) * np.outer(sigma, sigma)
    units = np.array([1.0 / _MM_PER_M] * 3 + [1.0] * 3)
    out: Floats = covariance * np.outer(units, units)
    return out


def frame_note(result: LiveResult) -> dict[str, Any]:
    """The host's message about a frame on ``/gelstereo/frame``: counts and the digest of all results, or the
    error.
    """
    sensed = result.sensed
    if sensed is None:
        return {"error": result.problem}
    return {
        "index": sensed.index,
        "motion_px": sensed.motion_px,
        "seen": int(np.count_nonzero(sensed.state == MarkerState.SEEN)),
        "salient": int(np.count_nonzero(sensed.salient)),
        "detected": [sensed.left.detected, sensed.right.detected],
        "mismatched": sensed.mismatched,
        "digest": f"{sensed.digest:016x}",
    }


def pose_note(located: Localization) -> dict[str, Any]:
    """Description of a pose for ``/gelstereo/stage``: how it was found, its free directions, and
    the digest.
    """
    return {
        "stage": "live",
        "tracking": located.tracking,
        "converged": located.converged,
        "free": [str(direction) for direction in located.free],
        "digest": f"{located.digest:016x}",
    }


def slip_note(slip: Slip) -> dict[str, Any]:
    """The host's message about slip on ``/gelstereo/slip``."""
    note: dict[str, Any] = {
        "status": SlipStatus(slip.status).name.lower(),
        "stick_ratio": slip.stick_ratio,
        "stick_range": list(slip.stick_range),
    }
    if (margin := slip.margin) is not None:
        note["margin"] = {
            "share": margin.share,
            "range": list(margin.range),
            "source": MarginSource(margin.source).name.lower(),
        }
    return note


def capture_note(frame: LiveFrame) -> dict[str, Any]:
    """Capture data of a frame for ``/gelstereo/capture``; times are of the system's monotonic clock.

    A replay compares its decoded images with the CRC-32 of the pixels.
    """
    return {
        "sequence": frame.sequence,
        "driver_ns": frame.driver_ns,
        "received_ns": frame.received_ns,
        "dropped": frame.dropped,
        "skew_ns": frame.skew_ns,
        "stale": frame.stale,
        "images": True,
        **({} if frame.layout is None else {"layout": frame.layout}),
        "left_crc32": _pixel_crc(frame.left),
        "right_crc32": _pixel_crc(frame.right),
    }


def _pixel_crc(image: npt.NDArray[np.uint8]) -> str:
    return f"{zlib.crc32(image.tobytes()):08x}"


def config_toml(
    rig: Rig, params: Params, shape: dict[str, Any] | None = None, *, has_compliance: bool = False
) -> str:
    """Configuration of the host with this rig, these settings, this part and, if there is one, the attached
    compliance matrix.
    """
    parts = [f"compliance_file = {json.dumps(COMPLIANCE)}\n"] if has_compliance else []
    parts += [_under("params", params.to_toml()), _under("rig", rig.to_toml())]
    if shape is not None:
        parts.append(f"[part]\nshape = {_inline(shape)}\n")
    return "\n".join(parts)


def _under(table: str, text: str) -> str:
    """A TOML text as a table of a larger one."""
    return f"[{table}]\n" + re.sub(r"^(\[+)(?=[a-zA-Z_])", rf"\1{table}.", text, flags=re.MULTILINE)


def _inline(value: Any) -> str:
    """A value in one line of TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_inline(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, str | bool | int | float | list):
        return json.dumps(value)
    raise Error(f"a value of type {type(value).__name__} cannot be written to a configuration")
