"""The insertion's report: Tables II and III, go or no-go against outcome, robot errors, failures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gelstereo.view.html import Block, Figure, Grid, Heading, Paragraph
from gelstereo_bench.experiments.batch import Trial
from gelstereo_bench.experiments.insertion import analysis, figures
from gelstereo_bench.experiments.insertion.analysis import PAPER_SHARE, Verdict
from gelstereo_bench.experiments.insertion.grasp import GRASPED, Fit, fit_of
from gelstereo_bench.experiments.insertion.looks import MIN_CHANCE
from gelstereo_bench.experiments.insertion.looks_report import looks_blocks, part_name, share_text
from gelstereo_bench.experiments.insertion.robot import RobotErrors
from gelstereo_bench.experiments.insertion.sense import METHODS
from gelstereo_bench.experiments.insertion.workplace import PRIOR, RANGES, workplace
from gelstereo_bench.experiments.report import Report
from gelstereo_bench.experiments.store import Record
from gelstereo_bench.frontier.scenes import CONDITIONS

__all__ = ["insertion_report", "reason"]

#: Each kind of robot error by itself: name, one unit, the unit's name, and the largest value tried.
ERRORS = (
    ("sensor turned in the hand", RobotErrors(mount_rad=np.deg2rad(1.0)), "deg", 2.0),
    ("sensor shifted in the hand", RobotErrors(mount_mm=1.0), "mm", 1.0),
    ("motion turned", RobotErrors(motion_rad=np.deg2rad(1.0)), "deg", 0.6),
    ("motion shifted", RobotErrors(motion_mm=1.0), "mm", 0.3),
)

_ASKED = (
    "Is a grasped part located well enough to be inserted? Pegs (a) to (d) and a USB plug (e) lie in the "
    "middle of the gripper, rotated within the gel's plane (pitch) and tilted out of it (roll). The part is "
    "located from one contact. The robot aligns it and lowers it straight into a hole that is less than 0.3 "
    "mm wider. The paper grasps each peg 36 times and the plug 10 times; FilterReg inserts "
    f"{100 * PAPER_SHARE:.1f} % (Tables II and III, Fig. 15). A part counts as inserted if its mesh at the "
    "achieved pose lies within the hole's walls; both are rigid. If the contact does not determine a "
    "direction that matters, the robot should decline. The chance of success is predicted from the pose, its "
    "covariance and the other poses that explain the contact. The robot attempts insertion if the chance is "
    f"at least {MIN_CHANCE}."
)


def insertion_report(trials: Sequence[Trial], records: Sequence[Record], inputs: Mapping[str, str]) -> Report:
    """Create tables and figures from the records."""
    found = analysis.verdicts(trials, records)
    fits = {letter: fit_of(letter) for letter in dict.fromkeys(v.part for v in found)}
    ours = [v for v in found if v.method == METHODS[-1].name]
    findings: list[Block] = [
        *_success(found, fits),
        *_chances(ours, fits),
        *looks_blocks(ours, list(fits)),
        *_bounds(trials, records, fits),
        *_ranges(found, fits),
        *_robots(ours, fits),
        *_failures(found, fits),
    ]
    conditions = (
        f"{CONDITIONS}; grasps drawn uniformly: pitch within {RANGES.pitch_rad} rad, roll within "
        f"{RANGES.roll_rad} rad, {RANGES.shift_mm} mm across, pressed {RANGES.press_mm[0]} to "
        f"{RANGES.press_mm[1]} mm"
    )
    summary = [block for block in findings if isinstance(block, Grid)]
    return Report("Grasp, localize, insert", _ASKED, conditions, findings, inputs, summary)


def _of(found: Sequence[Verdict], letter: str | None = None, method: str | None = None) -> list[Verdict]:
    return [v for v in found if letter in (None, v.part) and method in (None, v.method)]


#: Results of the paper's robot (section VI-B): FilterReg over all parts, and both methods on the plug.
_PAPERS = (
    ("the paper's robot, (e) usb plug", 10, ("60.0", "", "20.0", "")),
    ("the paper's robot, all", 154, (f"{100 * PAPER_SHARE:.1f}", "", "", "")),
)


def _success(found: Sequence[Verdict], fits: Mapping[str, Fit]) -> list[Block]:
    """Table II."""
    methods = [method.name for method in METHODS]
    rows = [
        [
            part_name(letter),
            f"{GRASPED[letter].clearance_mm:.2f}",
            str(len(_of(found, letter, methods[0]))),
            *(share_text(_of(found, letter, method)) for method in methods),
        ]
        for letter in fits
    ]
    every = [share_text(_of(found, method=method)) for method in methods]
    rows.append(["all", "", str(len(_of(found, method=methods[0]))), *every])
    rows += [[name, "< 0.3", str(count), *shares] for name, count, shares in _PAPERS]
    caption = "Insertions with a robot that moves exactly, per cent (95 % interval)"
    return [
        Heading("Success (Table II)"),
        Paragraph(
            "All methods learn the goal by grasping the part over the hole: the paper's once, as in the "
            f"paper, ours {len(METHODS[-1].taught_rad)} times, each time at another angle to the markers. "
            "All start from the same guess: along the patch, and otherwise as in that grasp. Ours also "
            "starts from three other guesses and, for a part with ridges, near the poses that it found. It "
            "acts on the mean of the poses that explain the contact. The paper's methods receive the points "
            "of the paper's sensing: all markers deeper than 0.35 mm. Half of these lie on the gel's "
            "shoulder beside the part."
        ),
        Grid(caption, ["part", "clearance mm", "grasps", *methods], rows),
    ]


def _chances(ours: Sequence[Verdict], fits: Mapping[str, Fit]) -> list[Block]:
    """Go or no-go."""
    rows = []
    for letter in (*fits, None):
        chosen = _of(ours, letter)
        go, stay = [v for v in chosen if v.go], [v for v in chosen if not v.go]
        reasons = Counter(map(reason, stay)).most_common(2)
        said = "; ".join(f"{text} ({count})" for text, count in reasons) or "-"
        share = f"{100 * len(go) / len(chosen):.1f}" if chosen else "-"
        rows.append(
            ["all" if letter is None else part_name(letter), share, share_text(go), share_text(stay), said]
        )
    curve = analysis.calibration(ours)
    head = ["part", "attempted, %", "of these inserted, %", "of the others, %", "reason to decline (count)"]
    bins = [
        [f"{mean:.2f}", str(count), *map(str, expected), str(inserted)]
        for (mean, count, inserted), expected in zip(curve, analysis.expected(ours), strict=True)
    ]
    return [
        Heading("Go or no-go"),
        Grid(f"{METHODS[-1].name}: attempted if the predicted chance is at least {MIN_CHANCE}", head, rows),
        Grid(
            f"{METHODS[-1].name}: predicted chance and outcome; the expected range is the central 95 % for "
            "the predicted chances",
            ["mean chance", "grasps", "expected at least", "expected at most", "inserted"],
            bins,
        ),
        Figure(
            "Predicted chance and share inserted, with its 95 % interval; the line is a right prediction",
            figures.calibration_curve(curve),
            "svg",
        ),
    ]


def _bounds(trials: Sequence[Trial], records: Sequence[Record], fits: Mapping[str, Fit]) -> list[Block]:
    """Cramér-Rao bounds of the contacts, against the holes' tolerances."""
    by_part: dict[str, list[Record]] = {letter: [] for letter in fits}
    for trial, record in zip(trials, records, strict=True):
        by_part[trial.configuration["part"]].append(record["bound"])
    rows = [
        [
            part_name(letter),
            _spread([bound["aside_mm"] for bound in bounds], 3),
            f"{0.5 * GRASPED[letter].clearance_mm:.3f}",
            _spread([np.rad2deg(bound["spin_rad"]) for bound in bounds], 2),
            f"{100 * np.mean([bound['chance'] for bound in bounds]):.0f}",
        ]
        for letter, bounds in by_part.items()
    ]
    head = ["part", "lateral mm", "half clearance mm", "about its axis deg", "chance by heights alone, %"]
    caption = (
        "Bound from the heights of the markers in contact on the error of the part in the hole, with the "
        "grasps over the hole: standard deviation, median (least to largest) over grasps"
    )
    return [
        Heading("Limit of the heights", 3),
        Paragraph(
            "The Cramér-Rao bound: no unbiased registration of the heights of the markers in contact is more "
            f"accurate. It includes the prior of {PRIOR.shift_mm} mm and {PRIOR.rotation_rad} rad. On a flat "
            "face the heights leave directions free that only edges determine, by which markers they pass. A "
            "part that is smooth where it is held has no edges, so these directions remain free."
        ),
        Grid(caption, head, rows),
        *_sides(fits),
    ]


def _sides(fits: Mapping[str, Fit]) -> list[Block]:
    """Bound of the irregular part by the side that lies on the gel."""
    if "c" not in fits:
        return []
    place = workplace("c")
    (own,) = GRASPED["c"].faces_rad
    rows = []
    for turn in range(_SIDES):
        spin_rad = own + 2.0 * np.pi * turn / _SIDES
        touching, bound = place.bound_of(replace(place.nominal, spin_rad=spin_rad), _MARKER_SIGMA_MM)
        rows.append(
            [
                f"{360 * turn / _SIDES:.0f}",
                str(touching),
                f"{bound.aside_mm:.3f}",
                f"{np.rad2deg(bound.spin_rad):.2f}",
                f"{100 * bound.chance:.0f}",
            ]
        )
    caption = (
        f"{part_name('c')}: the same bound for one grasp on another side, by its rotation from the side of "
        f"the grasps; nominal press, standard deviation of a marker {1e3 * _MARKER_SIGMA_MM} um"
    )
    head = ["rotated by deg", "markers in contact", "lateral mm", "about its axis deg", "chance, %"]
    return [Grid(caption, head, rows)]


#: Number of sides of the irregular part examined, and standard deviation of a marker along the gel's normal.
_SIDES, _MARKER_SIGMA_MM = 16, 0.0055


def _spread(values: Sequence[float], digits: int) -> str:
    middle, low, high = np.median(values), np.min(values), np.max(values)
    return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def reason(verdict: Verdict) -> str:
    """Reason why the robot declines: the least certain motion that matters, and whether it is free."""
    if verdict.refused is not None:
        return verdict.refused
    motion = f"{verdict.weakest.partition(',')[0]} is too uncertain"
    # Without the position, so that equal reasons are counted together.
    free = " and ".join(free.partition(" through ")[0] for free in verdict.matters)
    return f"{motion} (no face determines {free})" if free else motion


def _ranges(found: Sequence[Verdict], fits: Mapping[str, Fit]) -> list[Block]:
    """Table III."""
    methods = [method.name for method in METHODS]
    rows = [
        [
            part_name(letter),
            f"{GRASPED[letter].clearance_mm:.2f}",
            *(
                _range(_of(found, letter, method), angle)
                for method in methods
                for angle in ("pitch_rad", "roll_rad")
            ),
        ]
        for letter in fits
    ]
    head = [
        "part",
        "clearance mm",
        *(f"{method}, {angle}" for method in methods for angle in ("pitch", "roll")),
    ]
    return [
        Heading("Allowable poses (Table III)"),
        Paragraph(
            f"The largest angle up to which at least {100 * PAPER_SHARE:.1f} % of the grasps are inserted by "
            "a robot that moves exactly; a dash if there is none. It is limited by the range of the drawn "
            "grasps. The paper shows failures at 0.78 rad pitch (a), 0.27 rad roll (c), -0.21 rad roll (d) "
            "and 0.47 rad pitch (e), and attributes them to its coordinate transforms. With exact "
            "transforms, pitch alone has no effect."
        ),
        Grid("Allowable pitch and roll, rad", head, rows),
    ]


def _range(chosen: Sequence[Verdict], angle: str) -> str:
    largest = analysis.allowed(chosen, angle, PAPER_SHARE)
    return "-" if largest is None else f"±{largest:.3f}"


def _robots(ours: Sequence[Verdict], fits: dict[str, Fit]) -> list[Block]:
    """Errors of the robot and of the coordinate transforms."""
    go = [v for v in ours if v.go]
    # Sampled over all parts, which follow one another.
    go = go[:: -(-len(go) // _MAX_SWEPT) or 1]
    if not go:
        return []
    curves, rows = {}, []
    for name, unit, unit_name, limit in ERRORS:

        def share_at(scale: float, unit: RobotErrors = unit) -> float:
            return analysis.share_with(go, fits, unit.times(scale))

        curves[f"{name}, {unit_name}"] = [(float(x), share_at(float(x))) for x in np.linspace(0.0, limit, 9)]
        found = analysis.break_even(share_at, limit)
        rows.append([name, f"{found:.3f} {unit_name}" if found is not None else "not reached"])
    return [
        Heading("Effect of robot errors"),
        Paragraph(
            "Standard deviation of every component, one error at a time. Errors of the sensor's pose in the "
            "hand are drawn once for each of eight robots, those of the motion for every trial. The grasps "
            "are those that our method attempts. An error of the sensor's pose matters in proportion to the "
            "rotation of the part, because the error common to both grasps cancels."
        ),
        Grid(
            f"Error at which success falls to the paper's {100 * PAPER_SHARE:.1f} %",
            ["error", "standard deviation"],
            rows,
        ),
        Figure("Share inserted over the error", figures.error_curves(curves, PAPER_SHARE), "svg"),
    ]


#: Maximum number of grasps in the sweeps of robot errors.
_MAX_SWEPT = 100


def _failures(found: Sequence[Verdict], fits: Mapping[str, Fit]) -> list[Block]:
    """Fig. 15: for every method and part, the failure closest to success, and the share of failures with the
    same cause.
    """
    blocks: list[Block] = [
        Heading("Failures (Fig. 15)"),
        Paragraph("For every method and part, the failure with the median overlap of part and wall."),
    ]
    for method in METHODS:
        failed = {
            letter: sorted(
                (v for v in _of(found, letter, method.name) if not v.inserted and v.refused is None),
                key=lambda v: v.room_mm,
            )
            for letter in fits
        }
        shown = {letter: chosen[len(chosen) // 2] for letter, chosen in failed.items() if chosen}
        if not shown:
            continue
        said = "; ".join(
            f"{part_name(letter)} with {v.hold['pitch_rad']:+.2f} rad pitch and {v.hold['roll_rad']:+.3f} "
            f"rad roll: {analysis.cause(fits[letter], v.placed())}"
            for letter, v in shown.items()
        )
        panels = {letter: (fits[letter], v.placed()) for letter, v in shown.items()}
        caption = (
            f"{method.name}: hole (grey), part at the mouth (blue) and at its tip (red), from above. {said}"
        )
        blocks += [Heading(method.name, 3), Figure(caption, figures.over_the_hole(panels), "svg")]
    return blocks
