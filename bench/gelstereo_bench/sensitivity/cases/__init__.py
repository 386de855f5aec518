"""What constants are measured on: one file for each kind of data, all with known truth."""

from __future__ import annotations

__all__ = ["cases_of"]

#: Cases of the constants in each folder of the core.
STAGES: dict[str, tuple[str, ...]] = {
    "detect": ("images", "names"),
    "lattice": ("images", "names", "labels"),
    "track": ("images", "names", "labels", "scattered"),
    "triangulate": ("images",),
    "contact": ("contacts", "images"),
    "force": ("touch",),
    "slip": ("touch",),
    "motion": ("touch",),
    "register": ("poses",),
    "pipeline": ("images", "names"),
    "spatial": ("images", "labels"),
}


def cases_of(key: str) -> tuple[str, ...]:
    """Files of the cases for a constant, by its path and name."""
    return STAGES.get(key.split("/")[0], ("images",))
