"""All rungs of all stages. A new rung needs one line here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from gelstereo import Params

__all__ = ["EXACT", "FAST", "RUNGS", "Rung", "Stage", "rungs_of"]

#: Names of the complete pipelines to which the targets apply.
FAST, EXACT = "preset fast", "preset exact"

Stage = Literal["detect", "label", "points", "contact", "register", "whole"]


@dataclass(frozen=True)
class Rung:
    """One method of one stage."""

    stage: Stage
    name: str
    #: Differences from the preset.
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    preset: str = "paper"

    def params(self) -> Params:
        """Settings that select this rung."""
        return Params.preset(self.preset).replace({k: dict(v) for k, v in self.changes.items()})


_FIT: dict[str, Any] = {"background": "blocks", "threshold": "auto", "centre": "fit"}
#: Settings with accurate centres, so that these contribute little to the errors of points and contacts.
_POINTS: dict[str, dict[str, Any]] = {"detect": _FIT}

RUNGS = (
    Rung("detect", "gaussian + binary (paper)", {"detect": {"background": "gaussian", "centre": "binary"}}),
    Rung("detect", "gaussian + grey", {"detect": {"background": "gaussian", "centre": "grey"}}),
    Rung(
        "detect",
        "blocks + binary",
        {"detect": {"background": "blocks", "threshold": "fixed", "centre": "binary"}},
    ),
    Rung(
        "detect",
        "blocks + auto + grey",
        {"detect": {"background": "blocks", "threshold": "auto", "centre": "grey"}},
    ),
    Rung(
        "detect",
        "blocks + auto + soft threshold",
        {"detect": {"background": "blocks", "threshold": "auto", "centre": "soft_threshold"}},
    ),
    Rung(
        "detect",
        "blocks + auto + soft threshold at half size",
        {
            "detect": {
                "background": "blocks",
                "threshold": "auto",
                "centre": "soft_threshold",
                "find_at": "half_size",
            }
        },
    ),
    Rung("detect", "blocks + auto + fit", {"detect": _FIT}),
    Rung("label", "foresight (paper)", {"label": {"method": "foresight"}}, "balanced"),
    Rung(
        "label",
        "lattice",
        {"label": {"method": "lattice"}, "track": {"motion": "constant_velocity"}},
        "balanced",
    ),
    Rung("points", "q (paper)", _POINTS | {"triangulate": {"method": "q"}}, "balanced"),
    Rung("points", "polynomial", _POINTS | {"triangulate": {"method": "polynomial"}}, "balanced"),
    Rung("points", "rays", _POINTS | {"triangulate": {"method": "rays"}}, "balanced"),
    Rung("contact", "depth (paper)", _POINTS | {"contact": {"saliency": "depth"}}, "balanced"),
    Rung("contact", "pressure", _POINTS | {"contact": {"saliency": "pressure"}}, "balanced"),
    Rung("contact", "adaptive", _POINTS | {"contact": {"saliency": "adaptive"}}, "balanced"),
    Rung("register", "filterreg_point (paper)", {"register": {"method": "filterreg_point"}}),
    Rung("register", "ransac_icp (paper's comparison)", {"register": {"method": "ransac_icp"}}),
    Rung("register", "surface_close", {"register": {"method": "surface_close"}}),
    Rung("register", "surface_search", {"register": {"method": "surface_search"}}),
    Rung("whole", "preset paper"),
    Rung("whole", FAST, preset="fast"),
    Rung("whole", "fast, whole images", {"detect": {"search": "whole"}}, "fast"),
    Rung("whole", "preset balanced", preset="balanced"),
    Rung("whole", EXACT, preset="exact"),
)


def rungs_of(stage: Stage) -> list[Rung]:
    """List a stage's rungs."""
    return [rung for rung in RUNGS if rung.stage == stage]
