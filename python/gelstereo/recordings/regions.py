"""Contacts: salient markers, split into separate contacts, each with its core."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Contact", "contacts", "episodes"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

#: Two peaks form one contact unless the saddle between them is below this fraction of the lower peak.
_SADDLE_SHARE = 0.8
#: At the edge of a Hertzian contact the indentation is half of that in its middle, so deeper markers touch.
_CORE_SHARE = 0.5


@dataclass(frozen=True)
class Contact:
    """One contact in one frame, by indices of markers."""

    #: All its salient markers, including the gel's shoulder around it.
    salient: Indices
    #: The markers in contact: at least half as deep as the deepest.
    core: Indices
    #: Depth of the deepest marker.
    depth_mm: float


def contacts(indentation_mm: Array, rows: int, cols: int, threshold_mm: float) -> list[Contact]:
    """Split the salient markers of one frame into contacts, the deepest first.

    A watershed with a minimum prominence. Markers are processed from the deepest to the shallowest, and each
    joins the contacts among its eight neighbours. Two contacts that meet stay separate if the saddle between
    them is deep enough.

    Parameters
    ----------
    indentation_mm
        Indentation of every marker (rows * cols,).
    threshold_mm
        Indentation from which a marker is salient.
    """
    owner = np.full(rows * cols, -1)
    members: dict[int, list[int]] = {}
    salient = np.flatnonzero(indentation_mm > threshold_mm)
    for marker in salient[np.argsort(-indentation_mm[salient], kind="stable")]:
        around = {int(owner[n]) for n in _neighbours(int(marker), rows, cols) if owner[n] >= 0}
        peaks = sorted(around, key=lambda contact: -float(indentation_mm[members[contact][0]]))
        if not peaks:
            owner[marker], members[int(marker)] = marker, [int(marker)]
            continue
        first = peaks[0]
        for other in peaks[1:]:
            if indentation_mm[marker] > _SADDLE_SHARE * indentation_mm[members[other][0]]:
                owner[members[other]] = first
                members[first] += members.pop(other)
        owner[marker] = first
        members[first].append(int(marker))
    found = [_contact(np.array(indices), indentation_mm) for indices in members.values()]
    return sorted(found, key=lambda contact: -contact.depth_mm)


def _contact(indices: Indices, indentation_mm: Array) -> Contact:
    depth_mm = float(indentation_mm[indices].max())
    core = indices[indentation_mm[indices] >= _CORE_SHARE * depth_mm]
    return Contact(np.sort(indices), np.sort(core), depth_mm)


def _neighbours(marker: int, rows: int, cols: int) -> list[int]:
    row, col = divmod(marker, cols)
    return [
        r * cols + c
        for r in range(max(row - 1, 0), min(row + 2, rows))
        for c in range(max(col - 1, 0), min(col + 2, cols))
        if (r, c) != (row, col)
    ]


def episodes(indentation_mm: Array, threshold_mm: float) -> list[range]:
    """Find the runs of frames in which at least one marker is salient; indentation is (frames, markers)."""
    touched = np.concatenate([[False], (indentation_mm > threshold_mm).any(axis=1), [False]])
    edges = np.flatnonzero(np.diff(touched.astype(int)))
    return [range(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
