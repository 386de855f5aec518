"""A block of gel with a rim, a dome and a print below its skin, compared with a real sensor.

As in `gelstereo_bench.reports.physics`, the markers in contact are prescribed and the others predicted. The
layer there is flat and endless, with its print on the skin. Here linear finite elements have the sensor's
dome, end at free sides, and have the print at a depth. Thickness and depth are chosen on one part, and the
others judge.

Run ``python -m gelstereo_bench.reports.block`` to fill docs/simulator-physics.md: some minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs
from gelstereo.progress import progress
from gelstereo.recordings import CloudRecording, load_pytac3d, pytac3d_example
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.physics import Gel, Press, episodes_by_part, of_layer, off, presses, rms

with needs(__name__):
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

__all__ = ["Block", "compliance", "main", "predicted", "stiffness"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_THICKNESSES_MM = (6.0, 8.0, 9.0, 10.0, 12.0)
#: Levels of the mesh below the skin, down to the third of which a print is tried.
_LEVELS_MM = (0.0, 0.25, 0.5, 0.75, 1.0)
_MARGIN_MM = 3.0
_POISSON_RATIO = 0.495
#: Prescribed markers are met within this rms, since forces at the skin that meet them exactly would amplify
#: the noise of a print below it.
_MET_MM = 0.010
#: The part on which thickness and depth are chosen.
_CHOSEN_ON = "two balls"
_COLUMNS = [
    "part",
    "moved um",
    "layer off um",
    "block, print on the skin",
    "block, print below it",
    "share, %",
]


@dataclass(frozen=True)
class Block:
    """A mesh of hexahedra, bonded at its back, with free sides.

    Attributes
    ----------
    nodes_mm, cells
        (N, 3), z towards the part; (M, 8) node numbers, x slowest and z fastest, from low to high.
    fixed
        (N,) nodes at the back.
    markers
        (levels, rows, cols) nodes under each marker, from the skin down.
    depths_mm
        Depth of each level at the middle of the gel.
    """

    nodes_mm: Array
    cells: Indices
    fixed: npt.NDArray[np.bool_]
    markers: Indices
    depths_mm: Array

    @classmethod
    def of(cls, thickness_mm: float, dome_mm: Array, pitch_mm: float, margin_mm: float = _MARGIN_MM) -> Block:
        """Elements of one pitch, finer below the skin; `dome_mm` has the height of the rest surface above its
        lowest marker, below which the gel has its thickness.
        """
        count = dome_mm.shape[0]
        rim = max(1, round(margin_mm / pitch_mm))
        along = pitch_mm * (np.arange(count + 2 * rim) - 0.5 * (count + 2 * rim - 1))
        depths = list(_LEVELS_MM)
        while depths[-1] < thickness_mm - 1e-9:
            depths.append(min(thickness_mm, depths[-1] + min(1.25 * (depths[-1] - depths[-2]), 2.0)))
        shares = 1.0 - np.array(depths) / thickness_mm
        x, y = np.meshgrid(along, along)
        top = thickness_mm + np.pad(dome_mm, rim, mode="edge")
        nodes = np.stack(
            [np.broadcast_to(axis[..., None], (*x.shape, len(depths))) for axis in (x, y)], axis=-1
        )
        nodes = np.concatenate([nodes, (top[..., None] * shares)[..., None]], axis=-1)
        number = np.arange(nodes[..., 0].size).reshape(nodes.shape[:3])
        rows, cols, levels = (int(size) - 1 for size in np.shape(number))
        corners = [
            number[i : i + rows, j : j + cols, k : k + levels].ravel()
            for j in (0, 1)
            for i in (0, 1)
            for k in (1, 0)
        ]
        fixed = np.zeros(number.shape, bool)
        fixed[:, :, -1] = True
        inner = slice(rim, rim + count)
        return cls(
            nodes.reshape(-1, 3),
            np.stack(corners, axis=1),
            fixed.ravel(),
            np.moveaxis(number[inner, inner], 2, 0),
            np.array(depths),
        )


def stiffness(nodes_mm: Array, cells: Indices, poisson_ratio: float) -> csc_matrix:
    """Stiffness matrix of linear elasticity for a shear modulus of 1.

    Trilinear elements with one mean dilatation each, which do not lock at Poisson's ratios near 0.5 (Hughes,
    "The Finite Element Method", section 4.5).
    """
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    bulk = 2.0 * (1.0 + poisson_ratio) / (3.0 * (1.0 - 2.0 * poisson_ratio))
    law = np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    law[:3, :3] -= 2.0 / 3.0
    corners = nodes_mm[cells]
    blocks = np.zeros((len(cells), 24, 24))
    growth, volume = np.zeros((len(cells), 24)), np.zeros(len(cells))
    for point in signs / np.sqrt(3.0):
        shape = 1.0 + point * signs
        rates = (
            0.125
            * signs
            * np.stack(
                [shape[:, 1] * shape[:, 2], shape[:, 0] * shape[:, 2], shape[:, 0] * shape[:, 1]], axis=1
            )
        )
        jacobian = np.einsum("nai,aj->nij", corners, rates)
        weight = np.linalg.det(jacobian)
        rates = np.einsum("aj,nji->nai", rates, np.linalg.inv(jacobian))
        strain = np.zeros((len(cells), 6, 8, 3))
        for row, (first, second) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)]):
            strain[:, row, :, first] = rates[:, :, second]
            strain[:, row, :, second] = rates[:, :, first]
        flat = strain.reshape(len(cells), 6, 24)
        blocks += np.einsum("nki,kl,nlj,n->nij", flat, law, flat, weight, optimize=True)
        growth += rates.reshape(len(cells), 24) * weight[:, None]
        volume += weight
    blocks += bulk * growth[:, :, None] * growth[:, None, :] / volume[:, None, None]
    numbers = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), 24)
    rows, cols = (
        np.broadcast_to(n, blocks.shape).ravel() for n in (numbers[:, :, None], numbers[:, None, :])
    )
    return csc_matrix((blocks.ravel(), (rows, cols)), shape=(3 * len(nodes_mm),) * 2)


def compliance(block: Block, poisson_ratio: float = _POISSON_RATIO, levels: int = 4) -> Array:
    """(levels, 3 N, 3 N) motion of the markers at each level under unit forces on the skin over each."""
    free = np.flatnonzero(np.repeat(~block.fixed, 3))
    place = np.full(3 * len(block.nodes_mm), -1)
    place[free] = np.arange(len(free))
    matrix = stiffness(block.nodes_mm, block.cells, poisson_ratio)[free][:, free].tocsc()
    # Orderings for symmetric matrices: the default takes many times as long.
    solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    dofs = [place[(3 * level.ravel()[:, None] + np.arange(3)).ravel()] for level in block.markers[:levels]]
    found = np.empty((levels, len(dofs[0]), len(dofs[0])))
    for first in range(0, len(dofs[0]), 100):
        forces = np.arange(first, min(first + 100, len(dofs[0])))
        loads = np.zeros((len(free), len(forces)))
        loads[dofs[0][forces], forces - first] = 1.0
        motion = solver.solve(loads)
        for level, numbers in enumerate(dofs):
            found[level][:, forces] = motion[numbers]
    return found


def predicted(skin: Array, level: Array, press: Press) -> Array:
    """Motion of all markers of a level, with those in contact moved as recorded by forces on the skin.

    The forces act over the markers in contact. Of those that meet the record within `_MET_MM`, they have the
    least work.
    """
    recorded = press.motion_mm * [1.0, 1.0, -1.0]
    held = np.flatnonzero(np.repeat(press.touches.ravel(), 3))
    aim = recorded.ravel()[held]
    work = skin[np.ix_(held, held)]
    root = np.linalg.cholesky(0.5 * (work + work.T))
    left, sizes, right = np.linalg.svd(
        np.linalg.solve(root, level[np.ix_(held, held)].T).T, full_matrices=False
    )
    along = left.T @ aim
    for weight in sizes[0] ** 2 * np.logspace(0.0, -7.0, 29):
        shares = sizes / (sizes**2 + weight) * along
        missed = along - sizes * shares
        if np.sqrt(3.0 * np.mean((left @ missed) ** 2)) < _MET_MM:
            break
    forces = np.linalg.solve(root.T, right.T @ shares)
    return np.asarray((level[:, held] @ forces).reshape(recorded.shape) * [1.0, 1.0, -1.0])


def dome(recording: CloudRecording) -> Array:
    """Height of the rest surface above its lowest marker, towards the part, without tilt."""
    x, y, z = recording.rest_mm.T
    plane = np.column_stack([x, y, np.ones_like(x)])
    above = z - plane @ np.linalg.lstsq(plane, z, rcond=None)[0]
    return np.asarray((above - above.min()).reshape(recording.rows, recording.cols))


def rows(recording: CloudRecording) -> tuple[list[list[str]], float, float]:
    """Rows of the table, and the thickness and depth chosen."""
    frames = {name: presses(recording, span) for name, span in episodes_by_part(recording).items()}
    everything = slice(0, 3)
    errors: dict[tuple[float, float], dict[str, float]] = {}
    for thickness_mm in progress(_THICKNESSES_MM, "solving blocks"):
        block = Block.of(thickness_mm, dome(recording), recording.pitch_mm)
        found = compliance(block)
        for depth_mm, level in zip(block.depths_mm, found, strict=False):
            errors[thickness_mm, float(depth_mm)] = {
                name: rms(off(predicted(found[0], level, p), p, everything) for p in part)
                for name, part in frames.items()
            }
    flat = min((key for key in errors if key[1] == 0.0), key=lambda key: errors[key][_CHOSEN_ON])
    best = min(errors, key=lambda key: errors[key][_CHOSEN_ON])
    layers = {Gel(t, 0.5): 0.0 for t in (4.0, 6.0, 9.0, 11.0, 14.0)}
    for gel in layers:
        layers[gel] = rms(
            off(of_layer(p, gel, recording.pitch_mm), p, everything) for p in frames[_CHOSEN_ON]
        )
    layer = min(layers, key=lambda gel: layers[gel])
    lines = []
    for name, part in frames.items():
        moved = rms(off(np.zeros_like(p.motion_mm), p, everything) for p in part)
        by_layer = rms(off(of_layer(p, layer, recording.pitch_mm), p, everything) for p in part)
        values = [moved, by_layer, errors[flat][name], errors[best][name]]
        share = f"{100 * by_layer / moved:.0f} to {100 * errors[best][name] / moved:.0f}"
        lines.append([name, *(f"{1e3 * value:.0f}" for value in values), share])
    return lines, *best


def main(arguments: Sequence[str] | None = None) -> None:
    """Fill the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/simulator-physics.md"))
    chosen = parser.parse_args(arguments)
    lines, thickness_mm, depth_mm = rows(load_pytac3d(pytac3d_example("example_1", "AD2-0065L")))
    replace_between(chosen.page, "block", table(_COLUMNS, lines))
    print(f"chosen: {thickness_mm:g} mm thick at its lowest marker, print {depth_mm:g} mm below the skin")


if __name__ == "__main__":
    main()
