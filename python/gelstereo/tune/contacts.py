"""The part in a take's frames: its true pose, which directions the contact determines, and guesses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo._native import Error, Frame, Localization, Params, Template, localize
from gelstereo.geometry import se3_exp, se3_log
from gelstereo.tune.goal import TuneError
from gelstereo.tune.takes import WARM_UP, Take

__all__ = ["Contact", "Part", "contacts_of"]

Floats = npt.NDArray[np.float64]

#: A smaller patch is hardly a contact. Six unknowns need twice as many heights, and a normal needs three rows
#: and columns.
_MIN_SALIENT, _MIN_ROWS = 12, 3
#: Contacts of a take, evenly over its frames, and guesses for each. Range tried: none; more give a success
#: rate with a smaller interval, and take as much longer.
_CONTACTS, _GUESSES = 6, 4
#: A direction counts as free if moving the part by 1 mm along it moves its surface by less, rms mm. As in
#: the registration benchmark (docs/accuracy-vs-time.md).
_DETERMINED = 0.1


@dataclass(frozen=True)
class Part:
    """The part to localize, and the required accuracy.

    Attributes
    ----------
    template : Template
    guess : (4, 4) float64 or None
        Expected ``t_sensor_object`` at the first contact; not needed for simulated frames.
    tolerance_mm : float
        An answer within it is a success. Default: half of the paper's assembly tolerance of 0.3 mm.
    guess_error_deg, guess_error_mm : float
        Largest error of guesses, from which registration must succeed. Each guess has a uniformly distributed
        error up to it, in a random direction.
    """

    template: Template
    guess: Floats | None = None
    tolerance_mm: float = 0.15
    guess_error_deg: float = 5.0
    guess_error_mm: float = 1.0

    def __post_init__(self) -> None:
        for name in ("tolerance_mm", "guess_error_deg", "guess_error_mm"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise TuneError(f"{name} is {value}; valid is a finite number above 0")


@dataclass(frozen=True)
class Contact:
    """One frame of a take in which the part touches the gel.

    Attributes
    ----------
    shot : int
        Number of the frame in its take.
    t_sensor_object : (4, 4) float64
        The truth; in a recording, the best answer.
    guesses : tuple of (4, 4) float64
    centre_mm, radius_mm
        Centroid of the patch, and root mean square distance from it.
    directions : (6, K) float64
        Orthonormal: the determined directions of (radius ω, v) about the centroid.
    """

    shot: int
    t_sensor_object: Floats
    guesses: tuple[Floats, ...]
    centre_mm: Floats
    radius_mm: float
    directions: Floats

    def error_mm(self, t_sensor_object: Floats) -> float:
        """Root mean square error of a pose over the determined directions, at the patch's radius."""
        about = np.eye(4)
        about[:3, 3] = -self.centre_mm
        motion = about @ t_sensor_object @ np.linalg.inv(self.t_sensor_object) @ np.linalg.inv(about)
        twist = se3_log(motion)
        along = self.directions.T @ np.concatenate([self.radius_mm * twist[:3], twist[3:]])
        return float(np.sqrt(np.mean(along**2)))

    def variance_mm2(self, found: Localization) -> float:
        """Mean variance that an answer states for the determined directions, at the patch's radius."""
        x, y, z = self.centre_mm
        # A left perturbation about the camera moves the centroid by v + ω × centre.
        cross = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        jacobian = np.block([[self.radius_mm * np.eye(3), np.zeros((3, 3))], [cross, np.eye(3)]])
        covariance = jacobian @ found.determined_covariance @ jacobian.T
        return float(np.mean(np.diag(self.directions.T @ covariance @ self.directions)))


def contacts_of(
    take: Take, frames: Sequence[Frame], part: Part, params: Params, number: int
) -> tuple[Contact, ...]:
    """Contacts of a take, and guesses that are the same in every run.

    Parameters
    ----------
    take, frames
        A take, and what the most accurate settings sense in it.
    part
        The part; its guess is needed if the take is not simulated.
    params
        Settings of the registration whose answers stand for the truth in a recording.
    number
        Of the take, for the random numbers.

    Returns
    -------
    tuple of Contact
        Empty if the part touches nothing, or could not be found.
    """
    touched = [index for index, frame in enumerate(frames) if index >= WARM_UP and _touches(frame)]
    count = min(_CONTACTS, len(touched))
    found = []
    expected = part.guess
    for index in [touched[(2 * k + 1) * len(touched) // (2 * count)] for k in range(count)]:
        pose = take.shots[index].t_sensor_object
        if pose is None:
            pose = expected = _found(frames[index], part, params, expected)
        if pose is None:
            expected = part.guess
            continue
        contact = _contact(index, frames[index], pose, part, number)
        if contact.directions.size:
            found.append(contact)
    return tuple(found)


def _touches(frame: Frame) -> bool:
    salient = frame.salient.reshape(frame.rows, frame.cols)
    rows, cols = (np.count_nonzero(salient.any(axis=axis)) for axis in (1, 0))
    return bool(np.count_nonzero(salient) >= _MIN_SALIENT and min(rows, cols) >= _MIN_ROWS)


def _found(frame: Frame, part: Part, params: Params, expected: Floats | None) -> Floats | None:
    """The best answer for a recorded frame; None if the part does not explain it."""
    if expected is None:
        raise TuneError("a recording needs a guess of the part's pose (--guess-mm, --guess-deg)")
    try:
        answer = localize(frame, part.template, guess=expected, params=params)
    except Error:
        return None
    return None if answer.verdict == "does_not_fit" else np.array(answer.t_sensor_object)


def _contact(shot: int, frame: Frame, pose: Floats, part: Part, number: int) -> Contact:
    points_mm = frame.points_mm[frame.salient]
    centre_mm = points_mm.mean(axis=0)
    lever_mm = points_mm - centre_mm
    radius_mm = float(np.sqrt(np.mean(np.sum(lever_mm**2, axis=1))))
    normals = _normals(part.template, (points_mm - pose[:3, 3]) @ pose[:3, :3]) @ pose[:3, :3].T
    rows = np.column_stack([np.cross(lever_mm, normals) / radius_mm, normals])
    values, vectors = np.linalg.eigh(rows.T @ rows / len(rows))
    determined = np.sqrt(np.maximum(values, 0.0)) > _DETERMINED
    guesses = tuple(
        _guess(pose, centre_mm, part, np.random.default_rng([number, shot, k])) for k in range(_GUESSES)
    )
    return Contact(shot, pose, guesses, centre_mm, radius_mm, vectors[:, determined])


def _normals(template: Template, points_mm: Floats) -> Floats:
    """Outward normals nearest to points in the object frame."""
    if template.surface is not None:
        return template.closest(points_mm).normals
    return template.normals[template.nearest(points_mm)[0]]


def _guess(pose: Floats, centre_mm: Floats, part: Part, random: np.random.Generator) -> Floats:
    turn, move = (vector / np.linalg.norm(vector) for vector in random.normal(size=(2, 3)))
    angle, shift_mm = random.uniform(size=2) * [np.deg2rad(part.guess_error_deg), part.guess_error_mm]
    about = np.eye(4)
    about[:3, 3] = centre_mm
    motion = se3_exp(np.concatenate([angle * turn, shift_mm * move]))
    return np.asarray(about @ motion @ np.linalg.inv(about) @ pose, np.float64)
