"""Choice of settings for a sensor, a part and a computer: what accuracy costs in time.

`simulated_takes` or `recorded_takes` give the frames, `laboratory_of` the measurements on this computer, and
`tune` the settings for a `Goal`.
"""

from gelstereo.tune.cache import Conditions, StaleCache
from gelstereo.tune.contacts import Part
from gelstereo.tune.goal import Goal, Outcome, TuneError
from gelstereo.tune.intervals import Interval
from gelstereo.tune.measure import Figures, Laboratory
from gelstereo.tune.result import Check, Tuned
from gelstereo.tune.run import conditions_of, laboratory_of, tune
from gelstereo.tune.rungs import Rung
from gelstereo.tune.setting import Setting
from gelstereo.tune.takes import Shot, Take, Takes, recorded_takes, simulated_takes

__all__ = [
    "Check",
    "Conditions",
    "Figures",
    "Goal",
    "Interval",
    "Laboratory",
    "Outcome",
    "Part",
    "Rung",
    "Setting",
    "Shot",
    "StaleCache",
    "Take",
    "Takes",
    "TuneError",
    "Tuned",
    "conditions_of",
    "laboratory_of",
    "recorded_takes",
    "simulated_takes",
    "tune",
]
