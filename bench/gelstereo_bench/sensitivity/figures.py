"""Figures of one evaluation, and how much two of them differ."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

__all__ = ["NOTED", "Case", "Evaluation", "Kind", "change", "kind_of"]

Kind = Literal["share", "count", "error", "ratio"]

#: By kind: the least change that a page tells. Shares are in points of a per cent, counts are as they are, errors
#: and ratios are shares of the value.
NOTED: dict[Kind, float] = {"share": 0.5, "count": 1.0, "error": 0.02, "ratio": 0.05}
_KINDS: tuple[tuple[str, Kind], ...] = (
    ("%", "share"),
    ("NEES", "ratio"),
    ("bound", "ratio"),
    ("um", "error"),
    ("px", "error"),
)


def kind_of(name: str) -> Kind:
    """How changes of a figure are told, by its unit, which ends its name."""
    return next((kind for end, kind in _KINDS if name.endswith(end)), "count")


def change(name: str, default: float, other: float, least: float = 0.0) -> float:
    """Change in units of what is noted: 1 and more is told. `least` is what a figure's sample resolves."""
    kind = kind_of(name)
    if np.isnan(default) or np.isnan(other):
        return 0.0 if np.isnan(default) and np.isnan(other) else 1e3
    scale = 1.0 if kind in ("share", "count") else max(abs(default), 1e-12)
    return abs(other - default) / max(NOTED[kind] * scale, least)


@dataclass
class Evaluation:
    """Figures by name, and a digest of every number that was found."""

    figures: dict[str, float] = field(default_factory=dict)
    #: The least change of a figure that its sample resolves.
    least: dict[str, float] = field(default_factory=dict)
    _hash: hashlib._Hash = field(default_factory=hashlib.sha256)

    def put(self, name: str, figure: float, least: float = 0.0) -> None:
        """Add a figure."""
        self.figures[name] = figure
        if least > 0.0:
            self.least[name] = least

    def see(self, *values: npt.ArrayLike) -> None:
        """Put results into the digest."""
        for value in values:
            self._hash.update(np.ascontiguousarray(value).tobytes())

    @property
    def digest(self) -> str:
        """Of all results so far."""
        return self._hash.hexdigest()[:16]


@dataclass(frozen=True)
class Case:
    """Data with truth, loaded."""

    evaluate: Callable[[], Evaluation]
    #: What takes long and is seldom affected: done anew for the constants that it reads.
    prepare: Callable[[], None] = lambda: None
