"""Motion of the free gel beside contacts solved by finite elements: `python -m outside.judge_motion [--half
w]`.

The markers in contact are prescribed and the others predicted, with the true thickness and Poisson's ratio:
by the linear elastic layer of the simulator, which has no end, and by the same layer with the gel's free
sides. Each share is what a model leaves of the motion of the free markers, rms of all three components.
Contacts are their deepest stages; solids are also moved sideways or turned.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_dilation
from scipy.sparse.linalg import SuperLU, splu

from gelstereo import LayerContact
from gelstereo_bench.reports.block import Block, stiffness

from .contacts import HALF_MM, table
from .fields import DATA, Field

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Places = npt.NDArray[np.int64]

PITCH_MM, SIDE = 0.85, 25
#: Gel beyond the outermost markers: as it is, and so wide that its sides do not matter.
MARGIN_MM, WIDE_MM = HALF_MM - PITCH_MM * (SIDE // 2), 9.0
#: Fewest markers in contact.
MIN_TOUCHING = 4


@dataclass(frozen=True)
class Contact:
    """Markers of a contact, (SIDE, SIDE). Motion is along x, y and into the gel."""

    name: str
    thickness_mm: float
    poisson_ratio: float
    motion_mm: Array
    touches: Bools
    #: Markers that do not touch, inside the gel's sides.
    free: Bools

    @property
    def beyond(self) -> Bools:
        """Free markers without a neighbour in contact: between which markers a part ends is not known."""
        return np.asarray(self.free & ~binary_dilation(self.touches, np.ones((3, 3))))


def contacts(half: str | None = None) -> Iterator[Contact]:
    """The deepest stage of each contact of a half, or of both."""
    gels = table()["gels"]
    along = PITCH_MM * (np.arange(SIDE) - SIDE // 2)
    x, y = np.meshgrid(along, along)
    places = np.column_stack([x.ravel(), y.ravel()])
    for path in sorted(DATA.glob("*.npz")):
        field = Field.load(path.stem)
        if "gel" not in field.meta or half not in (None, field.meta["half"]):
            continue
        gel, stage = gels[field.meta["gel"]], len(field.stages) - 1
        touches = field.touching(stage, places).reshape(SIDE, SIDE)
        if touches.sum() < MIN_TOUCHING:
            continue
        motion = field.motion(stage, places).reshape(SIDE, SIDE, 3) * [1.0, 1.0, -1.0]
        # Gels under balls are discs.
        free = ~touches & (np.hypot(x, y) < HALF_MM - PITCH_MM)
        kind = "balls" if "r" in field.arrays else "solids"
        yield Contact(kind, gel["thickness_mm"], gel["poisson_ratio"], motion, touches, free)


def by_layer(contact: Contact) -> tuple[Array, Array]:
    """Motion of all markers of a layer whose markers in contact move as they do, and the forces on it.

    Forces are (SIDE, SIDE, 3) along x, y and out of the gel, for a shear modulus of 1.
    """
    layer = LayerContact(
        thickness_mm=contact.thickness_mm,
        poisson_ratio=contact.poisson_ratio,
        rows=SIDE,
        cols=SIDE,
        cell_mm=PITCH_MM,
        friction=1e3,
    )
    depth = np.minimum(contact.motion_mm[..., 2], contact.thickness_mm)
    heights = np.where(contact.touches, depth, -np.inf)
    found = layer.press(heights, contact.motion_mm[..., :2], tolerance_mm=1e-4)
    tractions = np.dstack([found.traction, -np.asarray(found.pressure)])
    # Tractions are over Young's modulus.
    return np.asarray(found.motion_mm), 2.0 * (1.0 + contact.poisson_ratio) * PITCH_MM**2 * tractions


def of_sides(contact: Contact, forces: Array) -> Array:
    """What the gel's free sides change under these forces: a block with its sides, less one without.

    The blocks' elements are as wide as the pitch. They are too coarse for the gel beside the forces, where
    both agree, and fine enough for the sides.
    """
    gel = contact.thickness_mm, contact.poisson_ratio
    changed = _under(*gel, MARGIN_MM, forces) - _under(*gel, WIDE_MM, forces)
    return np.asarray(changed * [1.0, 1.0, -1.0])


@cache
def _solver(thickness_mm: float, poisson_ratio: float, margin_mm: float) -> tuple[SuperLU, Places]:
    """Factors of a block, and the places of the markers' motion in its solution."""
    block = Block.of(thickness_mm, np.zeros((SIDE, SIDE)), PITCH_MM, margin_mm)
    free = np.flatnonzero(np.repeat(~block.fixed, 3))
    place = np.full(3 * len(block.nodes_mm), -1)
    place[free] = np.arange(len(free))
    matrix = stiffness(block.nodes_mm, block.cells, poisson_ratio)[free][:, free].tocsc()
    options = {"SymmetricMode": True}
    solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return solver, place[(3 * block.markers[0].ravel()[:, None] + np.arange(3)).ravel()]


def _under(thickness_mm: float, poisson_ratio: float, margin_mm: float, forces: Array) -> Array:
    solver, places = _solver(thickness_mm, poisson_ratio, margin_mm)
    loads = np.zeros(solver.shape[0])
    loads[places] = forces.ravel()
    return np.asarray(solver.solve(loads)[places].reshape(SIDE, SIDE, 3))


def _rms(off_mm: Array, chosen: Bools) -> float:
    return float(np.sqrt((off_mm[chosen] ** 2).sum(axis=1).mean()))


def main() -> None:
    """Print a table: motion of the free markers, and the share that each model leaves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=("w", "j"))
    arguments = parser.parse_args()
    found = defaultdict(list)
    for contact in contacts(arguments.half):
        layer, forces = by_layer(contact)
        both = layer + of_sides(contact, forces)
        for where in (contact.free, contact.beyond):
            off = [_rms(model - contact.motion_mm, where) for model in (np.zeros_like(layer), layer, both)]
            which = "all" if where is contact.free else "a pitch from the contact"
            found[contact.name, contact.thickness_mm, which].append(off)
    print("| contacts | gel, mm | number | free markers | moved, um | layer, % | with free sides, % |")
    print("|---|---|---|---|---|---|---|")
    for (name, thickness_mm, which), off in sorted(found.items()):
        moved, *left = np.sqrt(np.mean(np.square(off), axis=0))
        shares = " | ".join(f"{100 * each / moved:.0f}" for each in left)
        print(f"| {name} | {thickness_mm:g} | {len(off)} | {which} | {1e3 * moved:.0f} | {shares} |")


if __name__ == "__main__":
    main()
