"""Prints of any layout: drawn dots that a press moves, and two views to pair."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo import MarkerState, MarkerTracker
from gelstereo._native import pair_views
from gelstereo_bench.sensitivity.figures import Case, Evaluation

__all__ = ["load"]

Array = npt.NDArray[np.float64]

_SIZE_PX = (480, 360)
_SPACING_PX = 18.0
_RADIUS_PX = 4.0
#: Fixed-point bits of `cv2.circle`.
_SHIFT = 4
_SEEDS = 6


def _layout(kind: str, random: np.random.Generator) -> Array:
    """(n, 2) dots, px, in the inner part of the image."""
    if kind == "random":
        kept: list[Array] = []
        while len(kept) < 180:
            at = random.uniform((60.0, 60.0), (420.0, 300.0))
            if all(np.hypot(*(at - other)) > 0.75 * _SPACING_PX for other in kept):
                kept.append(at)
        kept_px: Array = np.array(kept)
        return kept_px
    row, col = np.mgrid[:13, :19].astype(float)
    if kind == "hexagonal":
        points = np.stack([col + 0.5 * (row % 2), row * np.sqrt(0.75)], axis=-1)
    elif kind == "square":
        points = np.stack([col, row], axis=-1)
    else:
        turns = [(ring, np.arange(6 * ring) / (6 * ring)) for ring in range(1, 8)]
        rings = [
            np.column_stack([ring * np.cos(2 * np.pi * t), ring * np.sin(2 * np.pi * t)]) for ring, t in turns
        ]
        points = np.vstack([np.zeros((1, 2)), *rings])
    points_px: Array = points.reshape(-1, 2) * _SPACING_PX
    return np.asarray(points_px - points_px.mean(axis=0) + (240.0, 180.0), np.float64)


def _moved(rest_px: Array, depth: float, shift_px: Array) -> Array:
    """Dots spread by a press of `depth` spacings near the middle, and moved as a whole."""
    far = rest_px - (225.0, 190.0)
    spread = depth * _SPACING_PX * far / 60.0 * np.exp(0.5 - 0.5 * (far**2).sum(axis=1) / 60.0**2)[:, None]
    moved_px: Array = rest_px + spread + shift_px
    return moved_px


def _image(dots_px: Array, random: np.random.Generator) -> npt.NDArray[np.uint8]:
    image = np.full(_SIZE_PX[::-1], 170, np.uint8)
    for at in np.rint(dots_px * 2**_SHIFT).astype(int):
        centre, radius = (int(at[0]), int(at[1])), round(_RADIUS_PX * 2**_SHIFT)
        cv2.circle(image, centre, radius, 30, -1, cv2.LINE_AA, _SHIFT)
    noisy = cv2.GaussianBlur(image, (0, 0), 0.8) + random.normal(0.0, 2.0, image.shape)
    return np.asarray(np.clip(noisy, 0.0, 255.0), np.uint8)


@dataclass
class _Sequence:
    images: list[npt.NDArray[np.uint8]]
    dots_px: list[Array]


def _sequence(kind: str, seed: int) -> _Sequence:
    """A press that deepens, a jump of 1.2 spacings, hidden dots and specks."""
    random = np.random.default_rng([seed, 17])
    rest_px = _layout(kind, random)
    turn = random.uniform(-np.pi, np.pi)
    jump = 1.2 * _SPACING_PX * np.array([np.cos(turn), np.sin(turn)])
    still = np.zeros(2)
    ways = [(0.0, still), (0.3, still), (0.6, still), (0.9, 0.4 * jump), (0.9, 1.4 * jump), (0.3, jump)]
    images, dots_px = [], []
    for number, (depth, shift_px) in enumerate(ways):
        at = _moved(rest_px, depth, shift_px)
        shown = random.uniform(size=len(at)) >= (0.05 if number else 0.0)
        specks = random.uniform((60.0, 60.0), (420.0, 300.0), (4 if number else 0, 2))
        images.append(_image(np.vstack([at[shown], specks]), random))
        dots_px.append(at)
    return _Sequence(images, dots_px)


def _follow(sequences: dict[str, list[_Sequence]]) -> Evaluation:
    out = Evaluation()
    for kind, runs in sequences.items():
        right = wrong = held = unsure = 0
        for run in runs:
            tracker = MarkerTracker()
            names: npt.NDArray[np.intp] = np.empty(0, np.intp)
            for image, dots_px in zip(run.images, run.dots_px, strict=True):
                found = tracker.process(image)
                out.see(found.positions_px, found.state)
                if len(names) == 0:
                    apart = np.linalg.norm(found.positions_px[:, None] - dots_px, axis=-1)
                    names = apart.argmin(axis=1)
                    continue
                off_px = np.linalg.norm(found.positions_px - dots_px[names], axis=1)
                seen = found.state == MarkerState.SEEN
                right += int((seen & (off_px < 0.3 * _SPACING_PX)).sum())
                wrong += int((seen & (off_px >= 0.3 * _SPACING_PX)).sum())
                held += int((~seen).sum())
                unsure += not found.is_certain
        out.figures[f"{kind} print: followed, %"] = 100.0 * right / max(right + wrong + held, 1)
        out.figures[f"{kind} print: wrong names"] = wrong
        out.figures[f"{kind} print: uncertain frames"] = unsure
    return out


def _pairs() -> Evaluation:
    """Both views of a tilted gel, with dots that one of them does not show."""
    out = Evaluation()
    paired = wrong = there = 0
    for kind in ("random", "square", "hexagonal"):
        for seed in range(_SEEDS):
            random = np.random.default_rng([seed, 18])
            left = _layout(kind, random)
            slope = random.uniform(-0.06, 0.06, 2)
            rows = random.uniform(-1.0, 1.0)
            shift = np.column_stack([110.0 + left @ slope, np.full(len(left), rows)])
            right = left - shift + random.normal(0.0, 0.1, left.shape)
            shown = random.permutation(len(right))[: round(0.95 * len(right))]
            found = pair_views(left, right[shown])
            there += len(shown)
            if found is None:
                out.see([seed])
                continue
            out.see(found)
            same = found[:, 0] == shown[found[:, 1]]
            paired, wrong = paired + int(same.sum()), wrong + int((~same).sum())
    out.figures["views of a print: paired, %"] = 100.0 * paired / there
    out.figures["views of a print: wrong pairs"] = wrong
    return out


def load() -> dict[str, Case]:
    """Draw all images."""
    kinds = ("random", "hexagonal", "square", "ring")
    sequences = {kind: [_sequence(kind, seed) for seed in range(_SEEDS)] for kind in kinds}
    return {"scattered": Case(lambda: _follow(sequences)), "views": Case(_pairs)}
