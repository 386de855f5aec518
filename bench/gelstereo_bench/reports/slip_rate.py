"""False alarms of slip an hour, of parts that are held for minutes and of gels that creep under them.

Balls, pegs and plates are pressed and stick. Then they are held, or they sink by a share of their depth for
each decade of time, as under a constant load. Markers have the noise of the report `slip`.

Run ``python -m gelstereo_bench.reports.slip_rate`` to fill docs/slip.md; it takes some ten minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Params, RestSurface, Scene, Simulator, SlipStatus, SlipTracker
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.slip import KINDS, SIDE, SIGMA_MM, Step, part_shape, touched

__all__ = ["CREEP", "Held", "alarms", "held", "main"]

Array = npt.NDArray[np.float64]

FRAME_RATE_HZ = 30.0
#: Frames in which a part is pressed, and frames of a creep that are computed; others lie between them.
_PRESSING, _COMPUTED = 5, 24
#: Depth by which a part sinks for each decade of time from a tenth of a second on, over its depth.
CREEP = 0.03
_FIRST_S = 0.1


@dataclass(frozen=True)
class Held:
    """A contact that sticks: frames while it is pressed, and computed frames afterwards with their times."""

    kind: str
    pressing: list[Step]
    steps: list[Step]
    times_s: Array

    def at(self, time_s: float) -> tuple[Array, Step]:
        """True markers at this time since it was pressed, and the computed frame before."""
        k = int(np.clip(np.searchsorted(self.times_s, time_s, side="right") - 1, 0, len(self.steps) - 1))
        now, then = self.steps[k], self.steps[min(k + 1, len(self.steps) - 1)]
        span = self.times_s[min(k + 1, len(self.steps) - 1)] - self.times_s[k]
        share = (time_s - self.times_s[k]) / span if span > 0.0 else 0.0
        return now.points_mm + share * (then.points_mm - now.points_mm), now


def held(count: int, seed: int, minutes: float, creep: float = 0.0) -> Iterator[Held]:
    """Contacts of each kind in turn, with friction of 1 to 2."""
    random = np.random.default_rng(seed)
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        shape, _ = part_shape(kind, random)
        layer = {"friction": random.uniform(1.0, 2.0)}
        gel = {**Scene().to_dict()["gel"], "thickness_mm": random.uniform(3.0, 5.0)}
        simulator = Simulator(Scene().replace(indenter=shape, gel=gel, effects={"elastic_layer": layer}))
        pose = np.eye(4)
        if kind == "peg":
            pose[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
        pose[:3, 3] = 4.0 + random.uniform(-3.0, 3.0), random.uniform(-3.0, 3.0), 40.0
        depth_mm = random.uniform(0.2, 0.5) if kind == "plate" else random.uniform(0.3, 0.8)
        made: list[Step] = []
        times_s = np.concatenate([[0.0], np.geomspace(_FIRST_S, 60.0 * minutes, _COMPUTED - 1)])
        sunk = depth_mm * (1.0 + creep * np.log10(1.0 + times_s / _FIRST_S))
        rest = simulator.advance(None, frame=0)
        made.append(Step(rest.points_mm, np.zeros(len(rest.points_mm), np.uint8), None))
        for depth in [*(depth_mm * np.linspace(0.2, 0.8, _PRESSING - 1)), *(sunk if creep else sunk[:1])]:
            pose = np.asarray(simulator.pressed(pose, float(depth)))
            frame = simulator.advance(pose, frame=len(made))
            assert frame.loads is not None
            made.append(Step(frame.points_mm, frame.loads.stick, pose))
        yield Held(kind, made[:_PRESSING], made[_PRESSING:], times_s[: len(made) - _PRESSING])


def alarms(contact: Held, random: np.random.Generator, seconds: float, *, patch_is_known: bool) -> int:
    """Alarms of a contact that sticks: each time that slip is reported after it was not."""
    rest_mm = contact.pressing[0].points_mm
    rest, count = RestSurface(rest_mm), len(rest_mm)
    params = Params().replace(slip={"method": "rigid", "frame_rate_hz": FRAME_RATE_HZ})
    tracker = SlipTracker(rest, params, cols=SIDE)
    covariance = np.tile(np.diag(SIGMA_MM**2), (count, 1, 1))
    found, slipped = 0, False
    frames = [(step.points_mm, step) for step in contact.pressing]
    later = (contact.at(k / FRAME_RATE_HZ) for k in range(round(seconds * FRAME_RATE_HZ)))
    for true_mm, step in (*frames, *later):
        points_mm = true_mm + SIGMA_MM * random.normal(size=rest_mm.shape)
        patch = touched(step, rest, None if patch_is_known else points_mm)
        _, slip = tracker.run(points_mm, covariance, patch.tolist())
        slips = slip is not None and slip.status >= SlipStatus.INCIPIENT
        found += slips and not slipped
        slipped = slips
    return found


def _row(name: str, contacts: list[Held], seed: int, seconds: float, known: bool) -> list[str]:
    random = np.random.default_rng(seed)
    found = [alarms(contact, random, seconds, patch_is_known=known) for contact in contacts]
    hours = len(contacts) * seconds / 3600.0
    with_any = sum(each > 0 for each in found)
    return [
        name,
        "known" if known else "from heights",
        f"{hours:.1f}",
        str(sum(found)),
        f"{sum(found) / hours:.1f}",
        f"{with_any} of {len(contacts)}",
    ]


def main(arguments: list[str] | None = None) -> int:
    """Fill the table in docs/slip.md."""
    parser = argparse.ArgumentParser(prog="python -m gelstereo_bench.reports.slip_rate", description=__doc__)
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    parser.add_argument("--contacts", type=int, default=24, help="number of contacts (%(default)s)")
    parser.add_argument("--minutes", type=float, default=5.0, help="for which each is held (%(default)s)")
    options = parser.parse_args(arguments)
    rows = []
    for name, creep in (("held", 0.0), ("creeping", CREEP)):
        contacts = list(held(options.contacts, 40, options.minutes, creep))
        for known in (True, False):
            rows.append(_row(name, contacts, 41, 60.0 * options.minutes, known))
            print(" ".join(rows[-1]), flush=True)
    head = ["contacts", "patch", "hours", "false alarms", "an hour", "contacts with any"]
    replace_between(options.docs / "slip.md", "rates", table(head, rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
