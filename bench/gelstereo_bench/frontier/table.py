"""What a measurement gives: tables for the page, and targets with the figures reached."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

__all__ = ["Report", "Table", "Target", "figure"]

#: Told what is being measured.
Report = Callable[[str], None]


@dataclass(frozen=True)
class Table:
    """One table between the page's markers of this name."""

    name: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Target:
    """A figure that is asked for, and the one reached; not a number stands for one that could not be measured."""

    what: str
    limit: float
    measured: float
    unit: str
    #: Whether the figure may not be above (below) the limit.
    at_most: bool = True

    @property
    def met(self) -> bool:
        """Whether the target is reached."""
        return self.measured <= self.limit if self.at_most else self.measured >= self.limit

    def line(self) -> list[str]:
        """Write it as a row of the table of targets."""
        sign = "<=" if self.at_most else ">="
        unit = f" {self.unit}" if self.unit else ""
        return [
            self.what,
            f"{sign} {self.limit:g}{unit}",
            f"{figure(self.measured)}{unit}",
            "yes" if self.met else "**no**",
        ]


def figure(value: float) -> str:
    """Write a figure with three digits, or a dash for what is not known."""
    if not math.isfinite(value):
        return "-"
    if value == 0.0 or abs(value) >= 100.0:
        return f"{value:.0f}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"
