"""Results of a measurement: tables for the page, and targets with the values reached."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

__all__ = ["Report", "Table", "Target", "figure"]

#: Called with a description of the present measurement.
Report = Callable[[str], None]


@dataclass(frozen=True)
class Table:
    """One table between the page's markers of this name."""

    name: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Target:
    """A target value and the value reached; NaN if it could not be measured."""

    what: str
    limit: float
    measured: float
    unit: str
    #: Whether the limit is an upper (lower) one.
    at_most: bool = True

    @property
    def met(self) -> bool:
        """Whether the target is met."""
        return self.measured <= self.limit if self.at_most else self.measured >= self.limit

    def line(self) -> list[str]:
        """Format as a row of the table of targets."""
        sign = "<=" if self.at_most else ">="
        unit = f" {self.unit}" if self.unit else ""
        return [
            self.what,
            f"{sign} {self.limit:g}{unit}",
            f"{figure(self.measured)}{unit}",
            "yes" if self.met else "**no**",
        ]


def figure(value: float) -> str:
    """Format a figure with three digits, or a dash if unknown."""
    if not math.isfinite(value):
        return "-"
    if value == 0.0 or abs(value) >= 100.0:
        return f"{value:.0f}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"
