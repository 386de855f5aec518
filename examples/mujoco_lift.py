"""A gripper lifts a peg in MuJoCo; the simulated sensor in one finger shows what it would see and feel.

    pip install mujoco
    python examples/mujoco_lift.py --images out/lift

MuJoCo has rigid fingers, and gives the peg's orientation and its force on the finger. For each tactile
frame, the peg is moved in the simulated gel until the gel pushes and pulls with this force: `pressed_with`
gives the first depth, and `advance` drags the gel on from the last frame. `Pipeline` then senses the images
as those of a camera.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import gelstereo as gs

MASS_KG, GRAVITY_M_S2 = 0.06, 9.81
GRIP_N = 2.0
RADIUS_MM, LENGTH_MM = 4.0, 16.0
FRAME_RATE_HZ = 30.0
YOUNG_KPA = 120.0
#: Largest difference between the forces of gel and MuJoCo.
FORCE_TOLERANCE_N = 0.005

#: Metres. The fingers close along x, and the peg lies along y.
WORLD = f"""
<mujoco>
  <option timestep="0.001" cone="elliptic" impratio="20" noslip_iterations="5"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="peg" pos="0 0 {1e-3 * RADIUS_MM}">
      <freejoint/>
      <geom name="peg" type="cylinder" size="{1e-3 * RADIUS_MM} {0.5e-3 * LENGTH_MM}" euler="90 0 0"
            mass="{MASS_KG}" friction="0.8"/>
    </body>
    <body name="hand" gravcomp="1" pos="0 0 {1e-3 * RADIUS_MM}">
      <inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/>
      <joint name="lift" type="slide" axis="0 0 1"/>
      <body name="left" gravcomp="1" pos="-0.02 0 0">
        <joint name="left" type="slide" axis="1 0 0" damping="20"/>
        <geom name="left" type="box" size="0.005 0.012 0.003" pos="-0.005 0 0" mass="0.05" friction="0.8"/>
      </body>
      <body name="right" gravcomp="1" pos="0.02 0 0">
        <joint name="right" type="slide" axis="-1 0 0" damping="20"/>
        <geom name="right" type="box" size="0.005 0.012 0.003" pos="0.005 0 0" mass="0.05" friction="0.8"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="lift" joint="lift" kp="4000" dampratio="1"/>
    <motor name="left" joint="left"/>
    <motor name="right" joint="right"/>
  </actuator>
</mujoco>"""

#: The sensor looks out of the left finger: z (away from the camera) is the world's x, y (down) its -z.
R_WORLD_SENSOR = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Lifted:
    """One tactile frame.

    Attributes
    ----------
    time_s, height_mm
        Time, and the height of the peg over its place on the floor.
    force_n
        MuJoCo's force of the peg on the left finger, sensor axes.
    pair
        Images and true loads of the simulated gel.
    sensed
        What the pipeline makes of the images.
    """

    time_s: float
    height_mm: float
    force_n: np.ndarray
    pair: gs.SimulatedFrame
    sensed: gs.Frame


class Finger:
    """The sensor in the left finger."""

    def __init__(self) -> None:
        scene = gs.Scene().replace(
            indenter={"kind": "cylinder", "radius_mm": RADIUS_MM, "length_mm": LENGTH_MM},
            effects={"elastic_layer": {"young_kpa": YOUNG_KPA}, "defocus": {}, "sensor_noise": {}},
        )
        self.gel = scene.to_dict()["gel"]
        params = gs.Params.preset("balanced").replace(
            force={"method": "ridge", "thickness_mm": self.gel["thickness_mm"], "young_kpa": YOUNG_KPA},
            slip={"method": "rigid", "frame_rate_hz": FRAME_RATE_HZ},
        )
        self.simulator = gs.Simulator(scene)
        self.pipeline = gs.Pipeline(scene.rig, params)
        self.shear_mm = np.zeros(2)
        self.frames = 0

    def touch(self, r_world_object: np.ndarray, force_n: np.ndarray) -> gs.SimulatedFrame:
        """Press the peg into the gel with a force, sensor axes."""
        frame, self.frames = self.frames, self.frames + 1
        if force_n[2] > -0.02:  # nothing presses
            self.shear_mm[:] = 0.0
            return self.simulator.advance(frame=frame)
        pose = np.eye(4)
        pose[:3, :3] = R_WORLD_SENSOR.T @ r_world_object
        pose[:3, 3] = [*self.gel["centre_mm"], self.gel["surface_mm"]]
        pose = self.simulator.pressed_with(pose, -force_n[2]).copy()
        stiffness_n_per_mm = self.stiffness_n_per_mm(pose, -force_n[2])
        pose[:2, 3] += self.shear_mm
        # `pressed_with` is for a part that is put down; this one has been dragged, too.
        for _ in range(8):
            pair = self.simulator.advance(pose, frame=frame)
            missing_n = force_n - pair.loads.force_n
            if np.linalg.norm(missing_n) < FORCE_TOLERANCE_N:
                break
            pose[:3, 3] += missing_n / stiffness_n_per_mm
        self.shear_mm = pose[:2, 3] - self.gel["centre_mm"]
        return pair

    def stiffness_n_per_mm(self, pose: np.ndarray, pressing_n: float) -> np.ndarray:
        """Stiffness of the pressed gel along the sensor's axes."""
        deeper = self.simulator.pressed_with(pose, 1.05 * pressing_n)
        normal = 0.05 * pressing_n / (pose[2, 3] - deeper[2, 3])
        # While the gel sticks, its force is linear in the shear.
        sheared = [
            self.simulator.press(pose, shear_mm=shear_mm).loads for shear_mm in ((0.02, 0.0), (0.0, 0.02))
        ]
        return np.array([sheared[0].force_n[0] / 0.02, sheared[1].force_n[1] / 0.02, normal])


def force_on(model: mujoco.MjModel, data: mujoco.MjData, finger: str) -> np.ndarray:
    """Force of the peg on a finger, newtons along the world's axes."""
    peg, pad = model.geom("peg").id, model.geom(finger).id
    total = np.zeros(3)
    for number in range(data.ncon):
        contact = data.contact[number]
        if {contact.geom1, contact.geom2} == {peg, pad}:
            wrench = np.zeros(6)
            mujoco.mj_contactForce(model, data, number, wrench)
            # The contact's force acts on the second body, along axes that are the rows of its frame.
            on_second = contact.frame.reshape(3, 3).T @ wrench[:3]
            total += on_second if contact.geom2 == pad else -on_second
    return total


def lift(seconds: float = 1.2) -> Iterator[Lifted]:
    """Close, lift by 20 mm and hold."""
    model = mujoco.MjModel.from_xml_string(WORLD)
    data = mujoco.MjData(model)
    finger = Finger()
    steps_a_frame = round(1.0 / (FRAME_RATE_HZ * model.opt.timestep))
    for frame in range(round(seconds * FRAME_RATE_HZ)):
        for _ in range(steps_a_frame):
            grip_n = GRIP_N * np.clip(data.time / 0.2, 0.0, 1.0)
            data.ctrl[:] = 0.02 * np.clip((data.time - 0.4) / 0.4, 0.0, 1.0), grip_n, grip_n
            mujoco.mj_step(model, data)
        peg = model.body("peg").id
        force_n = R_WORLD_SENSOR.T @ force_on(model, data, "left")
        # The peg's own axis is z; MuJoCo's geometry is turned in its body.
        rotation = data.geom_xmat[model.geom("peg").id].reshape(3, 3)
        # The first frame is the rest frame: nothing touches.
        pair = finger.touch(rotation, force_n if frame else np.zeros(3))
        sensed = finger.pipeline.process(pair.left, pair.right)
        yield Lifted(data.time, 1e3 * data.xpos[peg][2] - RADIUS_MM, force_n, pair, sensed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--images", type=Path, help="folder for the left images")
    arguments = parser.parse_args()
    for number, now in enumerate(lift()):
        felt = now.sensed.wrench.force_n if now.sensed.wrench else np.zeros(3)
        slip = gs.SlipStatus(now.sensed.slip.status).name if now.sensed.slip else "-"
        print(
            f"{now.time_s:5.2f} s, {now.height_mm:5.1f} mm up: MuJoCo {np.round(now.force_n, 2)} N, "
            f"felt {np.round(felt, 2)} N, slip {slip}"
        )
        if arguments.images:
            import cv2

            arguments.images.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(arguments.images / f"{number:04}.png"), now.pair.left)
    print(f"weight {MASS_KG * GRAVITY_M_S2:.3f} N; two fingers hold it")


if __name__ == "__main__":
    main()
