"""Methods (rungs) of each stage that a tuner chooses from, and the settings that select them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Literal

from gelstereo import Params

__all__ = ["RUNGS", "STAGES", "Rung", "Stage", "combinations", "params_of", "rungs_of"]

Stage = Literal["detect", "points", "contact", "register"]

#: In the order of the pipeline.
STAGES: tuple[Stage, ...] = ("detect", "points", "contact", "register")


@dataclass(frozen=True)
class Rung:
    """One method of one stage.

    ``settings`` has dotted names. Labels are not a choice: all presets but ``paper`` check every identity
    against the lattice, and no cheaper rung is as safe.
    """

    stage: Stage
    name: str
    settings: Mapping[str, object]


def _detect(name: str, centre: str, search: str, find_at: str = "full_size", step_px: float = 0.02) -> Rung:
    settings = {
        "detect.background": "blocks",
        "detect.threshold": "auto",
        "detect.centre": centre,
        "detect.search": search,
        "detect.find_at": find_at,
        "detect.fit.step_px": step_px,
    }
    return Rung("detect", name, settings)


def _points(name: str, method: str, disc_bias: str = "ignored") -> Rung:
    return Rung("points", name, {"triangulate.method": method, "triangulate.disc_bias": disc_bias})


def _contact(saliency: str) -> Rung:
    return Rung("contact", saliency, {"contact.saliency": saliency})


def _search(budget: int) -> Rung:
    settings = {"register.method": "surface_search", "register.surface_search.budget": budget}
    return Rung("register", f"surface_search, budget {budget}", settings)


#: The cheapest of each stage comes first. Other rungs of the pipeline are off the front of every stage
#: (docs/accuracy-vs-time.md).
RUNGS: tuple[Rung, ...] = (
    _detect("soft threshold, windows", "soft_threshold", "windows", "half_size"),
    _detect("soft threshold, whole images", "soft_threshold", "whole", "half_size"),
    _detect("fit, windows", "fit", "windows"),
    _detect("fit, whole images", "fit", "whole"),
    _detect("fine fit, windows", "fit", "windows", step_px=0.005),
    _detect("fine fit, whole images", "fit", "whole", step_px=0.005),
    _points("polynomial", "polynomial"),
    _points("rays", "rays"),
    _points("rays, disc bias", "rays", "corrected"),
    _contact("depth"),
    _contact("adaptive"),
    _contact("pressure"),
    Rung("register", "surface_close", {"register.method": "surface_close"}),
    _search(60_000),
    _search(120_000),
    _search(240_000),
    _search(370_000),
    _search(1_000_000),
)


def rungs_of(stage: Stage) -> list[Rung]:
    """List a stage's rungs, the cheapest first."""
    return [rung for rung in RUNGS if rung.stage == stage]


def combinations(stages: Iterable[Stage] = STAGES) -> Iterator[tuple[Rung, ...]]:
    """Every choice of one rung for each of these stages."""
    return product(*(rungs_of(stage) for stage in stages))


def params_of(rungs: Iterable[Rung], base: Params | None = None) -> Params:
    """Settings that select these rungs.

    Parameters
    ----------
    rungs
        At most one of each stage.
    base
        All other settings. Default: preset ``balanced``.
    """
    changes = {name: value for rung in rungs for name, value in rung.settings.items()}
    return (base or Params.preset("balanced")).replace(changes)
