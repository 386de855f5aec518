"""Parametric parts of the paper's experiments, as watertight meshes in millimetres.

>>> import gelstereo as gs
>>> from gelstereo import parts
>>> sorted(parts.PEGS)
['peg_hexagonal', 'peg_irregular', 'peg_round', 'peg_square', 'usb_plug']
>>> peg = parts.peg_square(side_mm=6.0)
>>> gs.Template.from_mesh(peg, units="mm", spacing_mm=0.4)
<Template: ...>
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from gelstereo.parts.contacts import connector_3_5mm, irregular_part, key, screw_m10, sd_reader, usb_drive
from gelstereo.parts.pegs import peg_hexagonal, peg_irregular, peg_round, peg_square, usb_plug
from gelstereo.parts.sections import loft, polar, rectangle, regular

if TYPE_CHECKING:
    import trimesh

__all__ = [
    "CONTACTS",
    "PEGS",
    "connector_3_5mm",
    "irregular_part",
    "key",
    "loft",
    "peg_hexagonal",
    "peg_irregular",
    "peg_round",
    "peg_square",
    "polar",
    "rectangle",
    "regular",
    "screw_m10",
    "sd_reader",
    "usb_drive",
    "usb_plug",
]

PEGS: "Mapping[str, Callable[[], trimesh.Trimesh]]" = MappingProxyType(
    {made.__name__: made for made in (peg_round, peg_square, peg_irregular, peg_hexagonal, usb_plug)}
)
"""Parts that the paper grasps and inserts (Fig. 10), in its order (a) to (e)."""

CONTACTS: "Mapping[str, Callable[[], trimesh.Trimesh]]" = MappingProxyType(
    {made.__name__: made for made in (screw_m10, connector_3_5mm, sd_reader, key, irregular_part, usb_drive)}
)
"""Parts that the paper presses into the sensor (Fig. 12), in its order (a) to (f)."""
