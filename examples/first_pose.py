"""The first pose: a peg in a simulated sensor, from stereo images to its pose and how well it is known.

python examples/first_pose.py
"""

from __future__ import annotations

import numpy as np

import gelstereo as gs


def main() -> None:
    # A simulated sensor. With a real one: a Rig from `gelstereo calibrate`, and pairs of grey uint8 images.
    sensor = gs.simulate("grasp_cylinder")
    params = gs.Params.preset("balanced")
    pipeline = gs.Pipeline(sensor.scene.rig, params)

    # The first frame is the rest frame: nothing touches the gel in it.
    for pair in sensor:
        frame = pipeline.process(pair.left, pair.right)
    print(f"{frame.patch.sum()} of {len(frame.points_mm)} markers touch the part")

    # The part, and where it should be: here the true pose, off by 2 degrees and half a millimetre.
    peg = {"kind": "cylinder", "radius_mm": 4.0, "length_mm": 20.0}
    template = gs.Template.from_triangles(*gs.geometry.shape_mesh(peg))
    guess = pair.t_sensor_object @ gs.geometry.se3_exp([0.02, -0.02, 0.02, 0.3, -0.3, 0.3])

    found = gs.localize(frame, template, guess=guess, params=params)

    # The pose maps points of the part to the frame of the left camera. Act on it only if it fits.
    sigma = found.sigma_at()
    print(f"verdict   {found.verdict}")
    print(f"position  {found.t_sensor_object[:3, 3].round(3)} mm")
    print(f"sigma     {sigma[3:].round(4)} mm, {np.degrees(sigma[:3]).round(3)} deg")
    print(f"free      {'; '.join(map(str, found.free)) or 'nothing'}")


if __name__ == "__main__":
    main()
