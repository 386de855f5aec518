"""The insertion as contact physics (MuJoCo, extra ``physics``): a check of the geometric verdict on a sample.

The part's end is one convex body in a compliant hand, with springs and dampers in all six directions for the
gel. A drive lowers the hand, and stops when the force exceeds a limit, which represents the paper's stop by
marker motion. The hole's walls are boxes. Without the force limit nearly everything "inserts".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs
from gelstereo.geometry import so3_from_matrix
from gelstereo_bench.experiments.insertion.hole import Hole, InsertedEnd

__all__ = ["Hand", "descend"]

Array = npt.NDArray[np.float64]

_M = 1e-3
_WALL_MM = 4.0
#: Number of walls of the polygon for a round hole; its corners are 0.1 % farther out than its sides.
_MAX_WALLS = 64
_ABOVE_MM = 1.0
_SPEED_MM_S = 20.0
_SETTLE_S = 0.03
_MASS_KG = 0.02
_DAMPING_NS_PER_M = 10.0
_DAMPING_NMS_PER_RAD = 1e-3


@dataclass(frozen=True)
class Hand:
    """Compliance of the hand, drive, and time step.

    Stiffnesses are those of a contact of 100 mm2 on 5 mm of gel with a shear modulus of 70 kPa: G A / t in
    shear, and the same at a lever arm of 5 mm for rotation. Stiffer directions have the same value, which is
    the softest assumption.
    """

    stiffness_n_per_mm: float = 1.4
    stiffness_nmm_per_rad: float = 35.0
    force_stop_n: float = 5.0
    friction: float = 0.2
    step_s: float = 2.5e-4

    def times(self, compliance: float) -> Hand:
        """A hand with its compliance multiplied by a factor."""
        return Hand(
            self.stiffness_n_per_mm / compliance,
            self.stiffness_nmm_per_rad / compliance,
            self.force_stop_n,
            self.friction,
            self.step_s,
        )


def descend(hole: Hole, end: InsertedEnd, t_hole_object: Array, hand: Hand, held_mm: float) -> float:
    """Lower a part from above the mouth until it is in or the force limit stops it; returns the tip's depth,
    mm.

    Parameters
    ----------
    hole, end
        The hole, and the part's end that goes in.
    t_hole_object
        The part's pose over the hole after alignment, (4, 4); its height does not matter.
    hand
        Compliance, drive and time step (at most 0.5 ms).
    held_mm
        Distance from the tip to where the part is held; it rotates about that point.

    Returns
    -------
    float
        Depth of the part's deepest point below the mouth; equals the hole's depth if inserted.
    """
    with needs(__name__):
        import mujoco

    points_mm = end.below(hole.mouth_mm, np.eye(4)) - [0.0, 0.0, hole.tip_mm - held_mm]
    model = mujoco.MjModel.from_xml_string(_scene(hole, points_mm, t_hole_object, hand, held_mm))
    data = mujoco.MjData(model)
    travel_mm = _ABOVE_MM + hole.tip_mm - hole.mouth_mm
    lag = model.joint("lag z").qposadr[0]
    while data.time < travel_mm / _SPEED_MM_S + _SETTLE_S:
        data.ctrl[0] = min(data.time * _SPEED_MM_S, travel_mm) * _M
        mujoco.mj_step(model, data)
        if -data.qpos[lag] / _M * hand.stiffness_n_per_mm > hand.force_stop_n:
            break
    part = model.body("part").id
    placed_mm = points_mm @ data.xmat[part].reshape(3, 3).T + data.xpos[part] / _M
    return float(placed_mm[:, 2].max())


def _scene(hole: Hole, points_mm: Array, t_hole_object: Array, hand: Hand, held_mm: float) -> str:
    """MuJoCo model: metres, the mouth at z = 0, z into the hole; the origin of the part's body is where it is
    held.
    """
    rotation = t_hole_object[:3, :3]
    at_mm = rotation @ [0.0, 0.0, hole.tip_mm - held_mm] + t_hole_object[:3, 3]
    at_mm[2] = -_ABOVE_MM - (points_mm @ rotation.T)[:, 2].max()
    x, y, z, w = so3_from_matrix(rotation)
    shift = f'stiffness="{hand.stiffness_n_per_mm / _M}" damping="{_DAMPING_NS_PER_M}"'
    turn = f'stiffness="{hand.stiffness_nmm_per_rad * _M}" damping="{_DAMPING_NMS_PER_RAD}"'
    lags = "".join(
        f'<joint name="lag {name}" type="slide" axis="{axis}" {shift}/>'
        for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
    )
    return f"""
    <mujoco>
      <option timestep="{hand.step_s}" gravity="0 0 0" integrator="implicitfast" cone="elliptic"/>
      <default>
        <geom friction="{hand.friction}" condim="3"
              solref="{2.0 * hand.step_s} 1" solimp="0.99 0.999 0.00001"/>
      </default>
      <asset><mesh name="end" vertex="{_numbers(points_mm * _M)}"/></asset>
      <worldbody>
        {_walls(hole)}
        <body name="hand">
          <inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/>
          <joint name="drive" type="slide" axis="0 0 1"/>
          <body name="lagging" pos="{_numbers(at_mm * _M)}">
            <inertial pos="0 0 0" mass="{_MASS_KG}" diaginertia="1e-6 1e-6 1e-6"/>
            {lags}
            <body name="part" quat="{_numbers(np.array([w, x, y, z]))}">
              <inertial pos="0 0 0" mass="{_MASS_KG}" diaginertia="4e-6 4e-6 1e-6"/>
              <joint name="lean" type="ball" {turn}/>
              <geom type="mesh" mesh="end"/>
            </body>
          </body>
        </body>
      </worldbody>
      <actuator><position joint="drive" kp="1e5" dampratio="1"/></actuator>
    </mujoco>"""


def _walls(hole: Hole) -> str:
    """Boxes with the hole's walls as inner faces."""
    chosen = np.unique(np.linspace(0, len(hole.offsets_mm) - 1, _MAX_WALLS).round().astype(int))
    if len(hole.offsets_mm) <= _MAX_WALLS:
        chosen = np.arange(len(hole.offsets_mm))
    depth_mm = hole.tip_mm - hole.mouth_mm + _WALL_MM
    reach_mm = float(hole.offsets_mm.max()) + 2.0 * _WALL_MM
    boxes = []
    for (nx, ny), offset in zip(hole.normals[chosen], hole.offsets_mm[chosen], strict=True):
        middle = np.array([nx, ny, 0.0]) * (offset + 0.5 * _WALL_MM) + [0.0, 0.0, 0.5 * depth_mm]
        half = np.array([_WALL_MM, 2.0 * reach_mm, depth_mm]) * 0.5 * _M
        boxes.append(
            f'<geom type="box" pos="{_numbers(middle * _M)}" size="{_numbers(half)}" '
            f'xyaxes="{nx} {ny} 0 {-ny} {nx} 0"/>'
        )
    return "".join(boxes)


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.12g}" for value in np.ravel(values))
