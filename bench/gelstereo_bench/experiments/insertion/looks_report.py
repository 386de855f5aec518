"""The report's section on further looks: attempted grasps, success, and time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelstereo.view.html import Block, Grid, Heading, Paragraph
from gelstereo_bench.experiments.insertion.analysis import Verdict, wilson
from gelstereo_bench.experiments.insertion.grasp import GRASPED
from gelstereo_bench.experiments.insertion.looks import CELL, MAX_LOOKS, MIN_CHANCE, Regrasp

__all__ = ["PACE", "Pace", "looks_blocks", "part_name", "share_text"]


@dataclass(frozen=True)
class Pace:
    """Speeds of a regrasp; those of a slow arm and a slow hand."""

    #: Travel of each finger while opening and closing.
    opening_mm: float = 10.0
    finger_mm_s: float = 50.0
    #: Distance that the hand rises over the part, and comes down again.
    lift_mm: float = 30.0
    arm_mm_s: float = 100.0
    wrist_rad_s: float = 1.0
    #: Travel from first touch to full indentation.
    press_s: float = 4.0 / 30.0

    def regrasp_s(self, regrasp: Regrasp) -> float:
        """Time from the decision to look again to the image that is registered, s."""
        fingers_s = 2.0 * self.opening_mm / self.finger_mm_s
        arm_s = 2.0 * self.lift_mm / self.arm_mm_s
        return fingers_s + arm_s + abs(regrasp.turn_rad) / self.wrist_rad_s + self.press_s


#: Speeds used in the report.
PACE = Pace()


def part_name(letter: str) -> str:
    """Name of a part in the report."""
    return f"({letter}) {GRASPED[letter].name.replace('_', ' ')}"


def share_text(chosen: Sequence[Verdict]) -> str:
    """Success rate with its 95 % interval, in per cent; a dash without grasps."""
    if not chosen:
        return "-"
    return _percent(sum(v.inserted for v in chosen), len(chosen))


def looks_blocks(ours: Sequence[Verdict], letters: Sequence[str]) -> list[Block]:
    """Create tables of the looks after the first."""
    rows, kinds = [], []
    for letter in (*letters, None):
        chosen = [v for v in ours if letter in (None, v.part)]
        name = "all" if letter is None else part_name(letter)
        rows.append([name, str(len(chosen)), *_attempts(chosen)])
        if letter is not None:
            kinds += _regrasps(name, chosen)
    head = [
        "part",
        "grasps",
        *(f"attempted after {n} look{'s'[: n > 1]}, %" for n in range(1, MAX_LOOKS)),
        f"after {MAX_LOOKS} (95 % interval)",
        "of these inserted, %",
        "of those with further looks, %",
        "further looks, mean",
        "extra time s, mean (longest)",
    ]
    blocks: list[Block] = [
        Heading("Further looks"),
        Paragraph(
            "The first grasp is made while the part stands in its holder. If the chance is below "
            f"{MIN_CHANCE}, the hand opens, moves by a known amount and closes on the standing part again, "
            f"up to {MAX_LOOKS} looks in all. The look with the highest predicted chance is chosen. Poses "
            "are fused with their likelihoods. Between two looks the part may move, and the positions of arm "
            f"and fingers are uncertain. In total these are {CELL.shift_mm} mm and {CELL.turn_rad} rad, "
            "standard deviations of every component. The robot acts on the last look."
        ),
        Paragraph(
            f"Time: fingers open and close by {PACE.opening_mm:.0f} mm at {PACE.finger_mm_s:.0f} mm/s, the "
            f"hand rises by {PACE.lift_mm:.0f} mm and comes down at {PACE.arm_mm_s:.0f} mm/s, and rotates at "
            f"{PACE.wrist_rad_s:.0f} rad/s. The time to compute a belief is not included."
        ),
        Grid("surface search, with further looks: attempts and insertions", head, rows),
    ]
    if kinds:
        caption = "Further looks by rotation of the hand about the part's axis"
        blocks.append(Grid(caption, ["part", "rotated by deg", "looks", "limit reached, %"], kinds))
    return blocks


def _attempts(chosen: Sequence[Verdict]) -> list[str]:
    """Cells of one row."""
    done = [v for v in chosen if v.last.go]
    again = [v for v in done if v.further]
    after = [sum(v.last.go and len(v.further) < n for v in chosen) for n in range(1, MAX_LOOKS)]
    tried = [v for v in chosen if v.further]
    times = [sum(PACE.regrasp_s(look.regrasp) for look in v.further if look.regrasp) for v in tried]
    return [
        *(f"{100 * count / len(chosen):.1f}" for count in after),
        _percent(len(done), len(chosen)),
        share_text([v.last for v in done]),
        share_text([v.last for v in again]),
        f"{np.mean([len(v.further) for v in tried]):.2f}" if tried else "-",
        f"{np.mean(times):.1f} ({np.max(times):.1f})" if times else "-",
    ]


def _regrasps(name: str, chosen: Sequence[Verdict]) -> list[list[str]]:
    """Rows with the number of times each rotation was chosen, and how often it was sufficient."""
    looks = [look for v in chosen for look in v.further if look.regrasp is not None]
    turns = Counter(round(np.rad2deg(look.regrasp.turn_rad)) for look in looks if look.regrasp)
    reached = Counter(round(np.rad2deg(look.regrasp.turn_rad)) for look in looks if look.regrasp and look.go)
    return [
        [name, str(turn), str(count), f"{100 * reached[turn] / count:.0f}"]
        for turn, count in sorted(turns.items())
    ]


def _percent(successes: int, trials: int) -> str:
    low, high = wilson(successes, trials)
    return f"{100 * successes / trials:.1f} ({100 * low:.1f} to {100 * high:.1f})"
