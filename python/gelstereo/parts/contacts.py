"""The objects that the paper presses into the sensor (Fig. 12), with common dimensions.

Their axis is z; the end that a tool or socket takes points towards +z.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gelstereo.parts.sections import loft, polar, rectangle, regular

if TYPE_CHECKING:
    import trimesh

__all__ = ["connector_3_5mm", "irregular_part", "key", "screw_m10", "sd_reader", "usb_drive"]

Array = npt.NDArray[np.float64]


def screw_m10(thread_mm: float = 16.0) -> trimesh.Trimesh:
    """M10 x 1.5 screw with a hexagonal head of 16 mm, 6.4 mm high (ISO 4017; thread by ISO 68-1).

    The thread ends flat at both ends. Its profile follows a grid of 1/16 of the pitch, within 0.04 mm.
    """
    pitch_mm, outer_mm, points = 1.5, 5.0, 66
    root_mm = outer_mm - 0.6134 * pitch_mm
    head_mm = 6.4
    rings = [(0.0, regular(6, 16.0, points)), (head_mm, regular(6, 16.0, points))]
    steps = int(np.ceil(16 * thread_mm / pitch_mm))
    for step in range(steps + 1):
        advance_mm = thread_mm * step / steps

        def radius(angle: Array, advance_mm: float = advance_mm) -> Array:
            phase = (advance_mm / pitch_mm - angle / (2.0 * np.pi)) % 1.0
            # Crest of 1/8, flanks of 5/16, root of 1/4 of the pitch.
            rise = np.clip((np.abs(phase - 0.5) - 0.125) / 0.3125, 0.0, 1.0)
            return root_mm + (outer_mm - root_mm) * rise

        rings.append((head_mm + advance_mm, polar(radius, points)))
    return loft(rings)


def connector_3_5mm() -> trimesh.Trimesh:
    """Adapter with a 3.5 mm jack plug: three insulating grooves, a tip with a neck, a housing of 6 mm."""
    profile = [
        (0.0, 2.6), (0.4, 3.0), (11.6, 3.0), (12.0, 2.6), (12.0, 1.75),
        (15.0, 1.75), (15.0, 1.6), (15.6, 1.6), (15.6, 1.75),
        (18.2, 1.75), (18.2, 1.6), (18.8, 1.6), (18.8, 1.75),
        (21.4, 1.75), (21.4, 1.6), (22.0, 1.6), (22.0, 1.75),
        (22.6, 1.75), (23.4, 1.25), (24.2, 1.7), (25.6, 0.6), (26.0, 0.3),
    ]  # fmt: skip
    return loft([(height, polar(radius, 96)) for height, radius in profile])


def sd_reader() -> trimesh.Trimesh:
    """Card reader: a flat body of 26 x 9 mm with rounded edges, a ledge and the slot for a card."""
    points = 32
    body = rectangle(26.0, 9.0, points, corner_mm=1.2)
    ledge = rectangle(24.0, 7.0, points, corner_mm=0.8)
    slot = rectangle(22.0, 2.4, points, corner_mm=0.2)
    return loft(
        [(0.0, ledge), (0.8, body), (30.0, body), (30.0, ledge), (34.0, ledge), (34.0, slot), (20.0, slot)]
    )


def key() -> trimesh.Trimesh:
    """Flat key: a round bow 3 mm thick, and a blade of 2.2 x 7.5 mm with five cuts on one side.

    Thickness along y, the cuts towards +x.
    """
    bow_mm, blade_mm = 11.0, 3.75

    def section(low_mm: float, high_mm: float, thickness_mm: float = 2.2) -> Array:
        half = 0.5 * thickness_mm
        return np.array([[high_mm, -half], [high_mm, half], [low_mm, half], [low_mm, -half]])

    # From one end of the bow to the shoulder; the bow's end is blunt.
    along = np.linspace(-0.98, np.sqrt(1.0 - (5.0 / bow_mm) ** 2), 40)
    rings = []
    for share in along:
        half_mm = bow_mm * float(np.sqrt(1.0 - share**2))
        rings.append((bow_mm * float(share - along[0]), section(-half_mm, half_mm, 3.0)))
    shoulder = rings[-1][0] + 2.0
    rings += [(shoulder, section(-5.0, 5.0, 3.0)), (shoulder, section(-blade_mm, blade_mm))]
    cuts = [(4.5 + 3.8 * index, depth_mm) for index, depth_mm in enumerate((1.2, 2.4, 0.8, 1.9, 1.5))]
    for reach_mm in np.linspace(0.1, 24.0, 240):
        # A cut is 1.1 mm wide at its bottom and opens by 45 degrees to both sides.
        depths = [depth_mm - max(abs(reach_mm - middle) - 0.55, 0.0) for middle, depth_mm in cuts]
        depth_mm = max(0.0, *depths)
        rings.append((shoulder + float(reach_mm), section(-blade_mm, blade_mm - depth_mm)))
    rings.append((shoulder + 26.0, section(-1.5, 1.5)))
    return loft(rings)


def irregular_part() -> trimesh.Trimesh:
    """Plastic part without symmetry: lobes that twist and grow along its axis, a waist and a rounded end."""

    def outline(share: float) -> Array:
        def radius(angle: Array) -> Array:
            lobes = 0.9 * np.cos(2 * angle + 1.5 * share) + 0.6 * np.cos(5 * angle - 0.7 - 2.0 * share)
            end = np.sqrt(max(1.0 - max(share - 0.8, 0.0) ** 2 / 0.05, 0.0))
            scaled: Array = (6.5 - 1.6 * np.sin(np.pi * share) + lobes) * max(end, 0.25)
            return scaled

        return polar(radius, 120)

    return loft([(26.0 * float(share), outline(float(share))) for share in np.linspace(0.0, 1.0, 53)])


def usb_drive() -> trimesh.Trimesh:
    """Metal flash drive with a ribbed body of 12.2 x 5.2 mm and a type A plug."""
    points = 32
    rings = [(0.0, rectangle(11.0, 4.0, points, corner_mm=1.0))]
    for start in np.arange(1.0, 19.0, 3.0):
        wide = rectangle(13.4, 6.0, points, corner_mm=1.4)
        waist = rectangle(12.6, 5.2, points, corner_mm=1.2)
        rings += [(float(start), wide), (float(start) + 2.0, wide)]
        rings += [(float(start) + 2.2, waist), (float(start) + 2.8, waist)]
    shell = rectangle(12.0, 4.5, points, corner_mm=0.4)
    mouth = rectangle(11.4, 3.9, points, corner_mm=0.2)
    rings += [(20.0, rectangle(13.4, 6.0, points, corner_mm=1.4)), (20.0, shell)]
    rings += [(31.75, shell), (31.75, mouth), (22.75, mouth)]
    return loft(rings)
