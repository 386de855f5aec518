"""Time and error of settings on takes, measured in turns."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt

from gelstereo._native import Error, Frame, Params, Pipeline, RegisterError, Rig, localize, nearest
from gelstereo.progress import Progress
from gelstereo.states import MarkerState
from gelstereo.tune.cache import Store
from gelstereo.tune.contacts import Contact, Part, contacts_of
from gelstereo.tune.goal import Outcome, TuneError
from gelstereo.tune.setting import Setting
from gelstereo.tune.takes import WARM_UP, Shot, Take, Takes

__all__ = ["Figures", "Laboratory", "outcome_of"]

Floats = npt.NDArray[np.float64]

#: Standard deviation over the median absolute deviation, of normal errors.
_SIGMA_OF_MEDIAN = 1.4826
_UM_PER_MM = 1e3
_MS_PER_NS = 1e-6


@dataclass(frozen=True)
class Figures:
    """What a setting did on one take.

    Attributes
    ----------
    sense_ms : float
        Median time of a frame, from images to markers in contact.
    height_um2 : float
        Mean squared depth error of a marker; infinite if a frame could not be sensed.
    locate_ms : float or None
        Median time of a registration; None if there was none.
    pose_um2 : float or None
        Mean squared pose error, each at most that of the tolerance.
    successes, trials : int
        Registrations within the tolerance, and all.
    """

    sense_ms: float
    height_um2: float
    locate_ms: float | None = None
    pose_um2: float | None = None
    successes: int = 0
    trials: int = 0


def outcome_of(figures: Sequence[Figures]) -> Outcome:
    """Join what a setting did on one or more takes."""
    time_ms = float(np.mean([each.sense_ms for each in figures]))
    height_um = math.sqrt(np.mean([each.height_um2 for each in figures]))
    located = [each for each in figures if each.locate_ms is not None and each.pose_um2 is not None]
    trials = sum(each.trials for each in located)
    if not trials:
        return Outcome(time_ms, height_um)
    pose_um2 = sum((each.pose_um2 or 0.0) * each.trials for each in located) / trials
    locate_ms = float(np.mean([each.locate_ms for each in located]))
    success = sum(each.successes for each in located) / trials
    return Outcome(time_ms + locate_ms, height_um, math.sqrt(pose_um2), success)


class Laboratory:
    """Measures settings on takes; what was measured before is not measured again.

    Parameters
    ----------
    takes
        The frames.
    base
        Settings that no rung states.
    reference
        The most accurate setting. Its patches state which directions the contacts determine. In a recording,
        its answers stand for the truth.
    part
        None if only sensing is measured.
    store
        Keeps what was measured.
    clock
        Time in nanoseconds.

    Raises
    ------
    TuneError
        The part touches the gel in no take, or is not found.
    """

    def __init__(
        self,
        takes: Takes,
        base: Params,
        reference: Setting,
        part: Part | None,
        store: Store,
        clock: Callable[[], int] = time.thread_time_ns,
    ) -> None:
        self.base, self.part, self.is_simulated = base, part, takes.is_simulated
        self._rig, self._store, self._clock = takes.rig, store, clock
        prepare = partial(_Prepared, rig=takes.rig, reference=reference.params(base), part=part)
        self._tuning = [prepare(take, number) for number, take in enumerate(takes.tuning)]
        self._held_out = [prepare(take, -1 - number) for number, take in enumerate(takes.held_out)]
        if part is not None:
            self._require_contacts()

    def _require_contacts(self) -> None:
        if self.is_simulated:
            # All takes have the same trajectory.
            if not self._tuning[0].contacts:
                raise TuneError(
                    "the part touches the gel in no frame of the scene; press it in until 12 markers, in "
                    "three rows and columns, are in contact"
                )
            return
        self._tuning = [each for each in self._tuning if each.contacts]
        self._held_out = [each for each in self._held_out if each.contacts]
        if not self._tuning or not self._held_out:
            raise TuneError(
                "the part was found in too few takes of the recording; check that it touches the gel in "
                "many frames, and the guess of its pose (--guess-mm, --guess-deg)"
            )

    @property
    def takes(self) -> int:
        """Number of takes to tune on."""
        return len(self._tuning)

    def measure(self, settings: Iterable[Setting], takes: int) -> dict[Setting, list[Figures]]:
        """Measure settings on the first takes for tuning."""
        return self._measured(list(dict.fromkeys(settings)), self._tuning[:takes], "measuring")

    def check(self, setting: Setting) -> list[Figures]:
        """Measure a setting on the takes that were held out."""
        return self._measured([setting], self._held_out, "checking")[setting]

    def _measured(
        self, settings: Sequence[Setting], takes: Sequence[_Prepared], what: str
    ) -> dict[Setting, list[Figures]]:
        missing = {
            take: [setting for setting in settings if f"{take.number}: {setting}" not in self._store.values]
            for take in takes
        }
        missing = {take: wanted for take, wanted in missing.items() if wanted}
        if missing:
            with Progress(what) as shown:
                for done, (take, wanted) in enumerate(missing.items()):
                    shown(done, len(missing), f"{len(wanted)} settings on a take")
                    found = self._measure(take, wanted)
                    self._store.keep({f"{take.number}: {key}": asdict(each) for key, each in found.items()})
                shown(len(missing), len(missing))
        return {
            setting: [Figures(**self._store.values[f"{take.number}: {setting}"]) for take in takes]
            for setting in settings
        }

    def _measure(self, prepared: _Prepared, settings: Sequence[Setting]) -> dict[Setting, Figures]:
        contacts = prepared.contacts if any(each.register for each in settings) else ()
        kept = {contact.shot for contact in contacts}
        sensed = self._sense(prepared.take, list(dict.fromkeys(each.sensing for each in settings)), kept)
        registered = [setting for setting in settings if setting.register is not None]
        located = self._locate(contacts, registered, {key: run.frames for key, run in sensed.items()})
        found = {}
        for setting in settings:
            run = sensed[setting.sensing]
            sense_ms = float(np.median(run.times_ns)) * _MS_PER_NS if run.times_ns else math.inf
            figures = Figures(sense_ms, run.height_um2(self.is_simulated))
            is_located = setting in located and bool(contacts)
            found[setting] = located[setting].added_to(figures) if is_located else figures
        return found

    def _sense(self, take: Take, settings: Sequence[Setting], kept: set[int]) -> dict[Setting, _Sensed]:
        pipelines = {each: Pipeline(self._rig, each.params(self.base)) for each in settings}
        runs = {each: _Sensed() for each in settings}
        for index, shot in enumerate(take.shots):
            for setting in _turned(settings, index):
                run = runs[setting]
                if run.has_failed:
                    continue
                begin = self._clock()
                try:
                    frame = pipelines[setting].process(shot.left, shot.right)
                except Error:
                    run.has_failed = True
                    continue
                ended = self._clock()
                run.add(index, shot, frame, ended - begin)
                if index in kept:
                    run.frames[index] = frame
        return runs

    def _locate(
        self,
        contacts: Sequence[Contact],
        settings: Sequence[Setting],
        frames: Mapping[Setting, Mapping[int, Frame]],
    ) -> dict[Setting, _Located]:
        assert self.part is not None or not settings, "registration needs a part"
        runs = {each: _Located() for each in settings}
        params = {each: each.params(self.base) for each in settings}
        trials = [(contact, guess) for contact in contacts for guess in contact.guesses]
        for turn, (contact, guess) in enumerate(trials):
            for setting in _turned(settings, turn):
                frame = frames[setting.sensing].get(contact.shot)
                if frame is None or self.part is None:
                    runs[setting].miss(self.part)
                    continue
                begin = self._clock()
                try:
                    found = localize(frame, self.part.template, guess=guess, params=params[setting])
                except RegisterError:
                    runs[setting].miss(self.part, self._clock() - begin)
                    continue
                taken_ns = self._clock() - begin
                pose = self.part.template.nearest_copy(found.t_sensor_object, contact.t_sensor_object)
                # Without truth, the error that the covariance states adds to the distance from the reference.
                stated_mm2 = 0.0 if self.is_simulated else contact.variance_mm2(found)
                runs[setting].add(contact.error_mm(np.array(pose)), stated_mm2, taken_ns, self.part)
        return runs


class _Prepared:
    """A take with its contacts, as the reference senses them."""

    def __init__(self, take: Take, number: int, rig: Rig, reference: Params, part: Part | None) -> None:
        self.take, self.number = take, number
        self._rig, self._reference, self._part = rig, reference, part

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        if self._part is None:
            return ()
        pipeline = Pipeline(self._rig, self._reference)
        frames = [pipeline.process(shot.left, shot.right) for shot in self.take.shots]
        return contacts_of(self.take, frames, self._part, self._reference, self.number % 2**32)


class _Sensed:
    """What a setting sensed in a take."""

    def __init__(self) -> None:
        self.times_ns: list[int] = []
        self.frames: dict[int, Frame] = {}
        self.has_failed = False
        self._truth: npt.NDArray[np.int64] | None = None
        self._squared_mm2: list[float] = []
        self._scatter_mm2: list[float] = []
        self._last_mm: list[Floats] = []

    def add(self, index: int, shot: Shot, frame: Frame, taken_ns: int) -> None:
        if index >= WARM_UP:
            self.times_ns.append(taken_ns)
        seen = frame.state == MarkerState.SEEN
        if not seen.any():
            self.has_failed = True
            return
        z_mm = frame.points_mm[:, 2]
        if shot.points_mm is None:
            self._squared_mm2.append(float(np.mean(frame.covariance_mm2[seen, 2, 2])))
            self._add_scatter(np.where(seen, z_mm, np.nan))
            return
        if self._truth is None:
            self._truth = _matched(frame, shot.points_mm)
        known = seen & (self._truth >= 0)
        off_mm = z_mm[known] - shot.points_mm[self._truth[known], 2]
        if off_mm.size:
            self._squared_mm2.append(float(np.mean(off_mm**2)))

    def _add_scatter(self, z_mm: Floats) -> None:
        """Scatter of depths over three frames: constant motion cancels in second differences."""
        self._last_mm = [*self._last_mm[-2:], z_mm]
        if len(self._last_mm) == 3:
            a, b, c = self._last_mm
            # The median is that of markers beside the contact, which move smoothly if at all. Six is the sum
            # of the squared weights.
            bent_mm = np.abs(a - 2.0 * b + c)
            bent_mm = bent_mm[np.isfinite(bent_mm)]
            if bent_mm.size:
                self._scatter_mm2.append((_SIGMA_OF_MEDIAN * float(np.median(bent_mm))) ** 2 / 6.0)

    def height_um2(self, is_simulated: bool) -> float:
        """From the truth; else the stated variance, or the scatter between frames if it is larger."""
        if self.has_failed or not self._squared_mm2:
            return math.inf
        mm2 = float(np.mean(self._squared_mm2))
        if not is_simulated and self._scatter_mm2:
            # The part may move between most frames; a quarter of them counts as smooth.
            mm2 = max(mm2, float(np.quantile(self._scatter_mm2, 0.25)))
        return _UM_PER_MM**2 * mm2


class _Located:
    """Answers of a setting."""

    def __init__(self) -> None:
        self._times_ns: list[int] = []
        self._squared_mm2: list[float] = []
        self._successes = 0

    def add(self, error_mm: float, stated_mm2: float, taken_ns: int, part: Part) -> None:
        self._times_ns.append(taken_ns)
        self._successes += error_mm <= part.tolerance_mm
        self._squared_mm2.append(min(error_mm**2 + stated_mm2, part.tolerance_mm**2))

    def miss(self, part: Part | None, taken_ns: int | None = None) -> None:
        assert part is not None, "registration needs a part"
        self._squared_mm2.append(part.tolerance_mm**2)
        if taken_ns is not None:
            self._times_ns.append(taken_ns)

    def added_to(self, figures: Figures) -> Figures:
        times_ns = self._times_ns
        return replace(
            figures,
            locate_ms=float(np.median(times_ns)) * _MS_PER_NS if times_ns else math.inf,
            pose_um2=_UM_PER_MM**2 * float(np.mean(self._squared_mm2)),
            successes=self._successes,
            trials=len(self._squared_mm2),
        )


def _turned(settings: Sequence[Setting], turn: int) -> Sequence[Setting]:
    """Another one begins in each turn, so that none always follows the same one."""
    start = turn % max(len(settings), 1)
    return [*settings[start:], *settings[:start]]


def _matched(rest: Frame, points_mm: Floats) -> npt.NDArray[np.int64]:
    """Index of the true marker for each marker at rest; -1 where none lies within a third of a pitch."""
    known = np.where(np.isfinite(rest.points_mm), rest.points_mm, 0.0)
    index, distance_mm = nearest(points_mm, known)
    rows = rest.points_mm.reshape(rest.rows, rest.cols, 3)
    pitch_mm = float(np.nanmedian(np.linalg.norm(np.diff(rows, axis=1), axis=2)))
    return np.where(distance_mm < pitch_mm / 3.0, index, -1)
