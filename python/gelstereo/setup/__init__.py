"""From images of a new sensor to one file, `sensor.toml`, for Python, the simulator and `gelstereo-host`.

`Plan` names the images, `set_up` runs the steps, and `load_sensor` opens the result.
"""

from gelstereo.setup.plan import Plan, PlanError, Views
from gelstereo.setup.run import set_up
from gelstereo.setup.sensor import Sensor, load_sensor
from gelstereo.setup.step import Figure, Step

__all__ = ["Figure", "Plan", "PlanError", "Sensor", "Step", "Views", "load_sensor", "set_up"]
