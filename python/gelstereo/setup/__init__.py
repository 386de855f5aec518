"""From images of a new sensor to one file, `sensor.toml`, for Python, the simulator and `gelstereo-host`.

`Plan` names the images, `set_up` runs the steps, and `load_sensor` opens the result. `compare_sensors` tells
two results apart.
"""

from gelstereo.setup.compare import Comparison, Difference, compare_sensors
from gelstereo.setup.plan import Plan, PlanError, Views
from gelstereo.setup.run import set_up
from gelstereo.setup.sensor import Sensor, load_sensor
from gelstereo.setup.step import Figure, Step

__all__ = [
    "Comparison",
    "Difference",
    "Figure",
    "Plan",
    "PlanError",
    "Sensor",
    "Step",
    "Views",
    "compare_sensors",
    "load_sensor",
    "set_up",
]
