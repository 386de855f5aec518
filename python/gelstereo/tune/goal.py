"""What settings are tuned for, and what settings achieve."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gelstereo._native import Error

__all__ = ["Goal", "Outcome", "TuneError"]


class TuneError(Error):
    """Settings cannot be tuned with this input."""


@dataclass(frozen=True)
class Outcome:
    """Time and error of one choice of settings.

    Attributes
    ----------
    time_ms : float
        Of a frame: sensing and, with a part, one registration; each a median.
    height_um : float
        Root mean square depth error of a marker.
    pose_um : float or None
        Root mean square pose error at the patch's radius over the directions that the contact determines. An
        answer farther off than the tolerance counts as the tolerance. None without a part.
    success : float or None
        Share of the registrations within the tolerance. None without a part.
    """

    time_ms: float
    height_um: float
    pose_um: float | None = None
    success: float | None = None

    @property
    def error_um(self) -> float:
        """The pose error; without a part, the depth error of a marker."""
        return self.height_um if self.pose_um is None else self.pose_um


@dataclass(frozen=True)
class Goal:
    """Limits that settings must keep; at least one.

    With ``error_um`` or ``success``, the cheapest settings that keep all limits are wanted. With
    ``budget_ms`` alone, the most accurate ones.

    Attributes
    ----------
    budget_ms : float or None
        Largest `Outcome.time_ms`.
    error_um : float or None
        Largest `Outcome.error_um`.
    success : float or None
        Least `Outcome.success`, per cent.

    Raises
    ------
    TuneError
        There is no limit, or a limit has no meaning.
    """

    budget_ms: float | None = None
    error_um: float | None = None
    success: float | None = None

    def __post_init__(self) -> None:
        if (self.budget_ms, self.error_um, self.success) == (None, None, None):
            raise TuneError(
                "there is no goal; give at least one of budget_ms, error_um and success (--budget-ms, "
                "--error-um, --success)"
            )
        for name in ("budget_ms", "error_um"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise TuneError(f"{name} is {value}; valid is a finite number above 0")
        if self.success is not None and not 0.0 < self.success <= 100.0:
            raise TuneError(f"success is {self.success} %; valid is above 0 and up to 100")

    def check(self, has_part: bool) -> None:
        """Refuse a goal that needs a part if there is none.

        Raises
        ------
        TuneError
            There is none.
        """
        if self.success is not None and not has_part:
            raise TuneError("a success rate needs the part that is registered (--part)")

    def excess(self, outcome: Outcome) -> float:
        """How far an outcome misses the limits: the largest relative excess; 0 if it keeps them.

        A success of 0.98 where 0.99 is wanted misses by 0.01.
        """
        return max((excess for excess, _ in self._missed(outcome)), default=0.0)

    def misses(self, outcome: Outcome) -> list[str]:
        """Each limit that an outcome misses, in words."""
        return [text for _, text in self._missed(outcome)]

    def _missed(self, outcome: Outcome) -> list[tuple[float, str]]:
        found = []
        if self.budget_ms is not None:
            text = f"time {outcome.time_ms:.4g} ms instead of at most {self.budget_ms:g}"
            found.append((outcome.time_ms / self.budget_ms - 1.0, text))
        if self.error_um is not None:
            text = f"error {outcome.error_um:.4g} um instead of at most {self.error_um:g}"
            found.append((outcome.error_um / self.error_um - 1.0, text))
        if self.success is not None:
            share = outcome.success or 0.0
            text = f"success {100.0 * share:.4g} % instead of at least {self.success:g}"
            found.append((0.01 * self.success - share, text))
        # Rounding is no miss.
        return [miss for miss in found if miss[0] > 1e-9]

    def cost(self, outcome: Outcome) -> float:
        """What is to be small among outcomes that keep the limits: error with a budget alone, else time."""
        wants_accuracy = self.error_um is None and self.success is None
        return outcome.error_um if wants_accuracy else outcome.time_ms

    def rank(self, outcome: Outcome) -> tuple[float, float]:
        """Sorting key: the best outcome first, and those that miss the limits by their excess."""
        return self.excess(outcome), self.cost(outcome)

    def __str__(self) -> str:
        limits = [
            (self.budget_ms, "at most {:g} ms"),
            (self.error_um, "at most {:g} um"),
            (self.success, "at least {:g} % success"),
        ]
        return ", ".join(text.format(value) for value, text in limits if value is not None)
