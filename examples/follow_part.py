"""Follows a part from frame to frame while it is dragged over the gel.

    python examples/follow_part.py

A `Localizer` starts each frame from the last pose. If that does not explain the contact, it searches again.
"""

from __future__ import annotations

import numpy as np

import gelstereo as gs


def main() -> None:
    sensor = gs.simulate("grasp_cylinder")
    params = gs.Params.preset("balanced")
    pipeline = gs.Pipeline(sensor.scene.rig, params)
    template = gs.Template.from_triangles(
        *gs.geometry.shape_mesh({"kind": "cylinder", "radius_mm": 4.0, "length_mm": 20.0})
    )

    # Where the gripper will hold the part: millimetres in the frame of the left camera, the peg along y.
    expected = gs.geometry.se3_exp([np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]).copy()
    expected[:3, 3] = [4.0, 0.0, 31.0]
    localizer = gs.Localizer(template, guess=expected, params=params)

    for pair in sensor:
        frame = pipeline.process(pair.left, pair.right)
        if not frame.patch.any():
            print(f"{frame.index:3} nothing touches the gel")
            continue
        try:
            found = localizer.process(frame)
        except gs.RegisterError as error:
            # Too few markers touch, as at the first contact.
            print(f"{frame.index:3} no pose: {error}")
            continue
        x, y, z = found.t_sensor_object[:3, 3]
        print(f"{frame.index:3} {found.tracking}, {found.verdict}: x {x:.3f}, y {y:.3f}, z {z:.3f} mm")


if __name__ == "__main__":
    main()
