"""Resampling of recorded frames to a constant rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_NS_PER_S = 1e9


@dataclass(frozen=True)
class Timeline:
    """The recorded frame for each step of a constant rate.

    Attributes
    ----------
    fps : int
    taken : list of int
        Index of the recorded frame nearest to each step; non-decreasing.
    frames : int
        Total number of recorded frames.
    """

    fps: int
    taken: list[int]
    frames: int

    @classmethod
    def of(cls, times_ns: Sequence[int], fps: int | None = None) -> Timeline:
        """Steps from the first frame to the last. Default for `fps`: the recording's rate, rounded to an
        integer.

        Examples
        --------
        >>> Timeline.of([0, 33_300_000, 66_700_000, 133_400_000]).taken
        [0, 1, 2, 2, 3]
        """
        times_s = (np.array(times_ns, dtype=np.int64) - times_ns[0]) / _NS_PER_S
        if fps is None:
            fps = max(1, round(1.0 / float(np.median(np.diff(times_s))))) if len(times_s) > 1 else 1
        steps_s = np.arange(round(times_s[-1] * fps) + 1) / fps
        after = np.searchsorted(times_s, steps_s).clip(0, len(times_s) - 1)
        before = np.maximum(after - 1, 0)
        nearer_before = steps_s - times_s[before] <= times_s[after] - steps_s
        taken = np.where(nearer_before, before, after)
        return cls(fps, [int(index) for index in taken], len(times_s))

    @property
    def repeated(self) -> int:
        """Number of steps that repeat a frame, because the recording has none there."""
        return len(self.taken) - len(set(self.taken))

    @property
    def passed_over(self) -> int:
        """Number of recorded frames that no step uses."""
        return self.frames - len(set(self.taken))
