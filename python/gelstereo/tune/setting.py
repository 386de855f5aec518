"""A choice of one rung per stage."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from gelstereo._native import Params
from gelstereo.tune.rungs import Rung, params_of

__all__ = ["Setting"]


@dataclass(frozen=True)
class Setting:
    """One rung of each stage.

    Attributes
    ----------
    detect, points, contact : Rung
    register : Rung or None
        None if only sensing is measured.
    """

    detect: Rung
    points: Rung
    contact: Rung
    register: Rung | None = None

    @classmethod
    def of(cls, rungs: Iterable[Rung]) -> Setting:
        """The setting of rungs, one of each stage; registration may be left out."""
        return cls(**{rung.stage: rung for rung in rungs})

    @property
    def sensing(self) -> Setting:
        """The same without registration."""
        return Setting(self.detect, self.points, self.contact)

    @property
    def rungs(self) -> tuple[Rung, ...]:
        """In the order of the pipeline."""
        sensing = (self.detect, self.points, self.contact)
        return sensing if self.register is None else (*sensing, self.register)

    def params(self, base: Params) -> Params:
        """Settings of the pipeline; what no rung states is that of `base`."""
        return params_of(self.rungs, base)

    def __str__(self) -> str:
        return "; ".join(f"{rung.stage}: {rung.name}" for rung in self.rungs)

    def __hash__(self) -> int:
        # The settings of a rung are a mapping, which has no hash.
        return hash(str(self))
