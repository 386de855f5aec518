"""What constants are measured on: one file for each kind of data, all with known truth."""

from __future__ import annotations

__all__ = ["STAGES"]

#: Cases of the constants in each folder of the core.
STAGES: dict[str, tuple[str, ...]] = {
    "detect": ("images", "names"),
    "lattice": ("images", "names", "labels"),
    "track": ("images", "names", "labels"),
    "triangulate": ("images",),
    "contact": ("contacts", "images"),
    "register": ("poses",),
    "pipeline": ("images", "names"),
}
