"""Digests of what the installed package computes, one a line, with NumPy alone: `python package.py`.

`packages.sh` runs it on two processors; the lines must be equal.
"""

from __future__ import annotations

import hashlib

import gelstereo as gs


def main() -> None:
    """Print the digests of images, frames, a template and a pose."""
    sensor = gs.simulate("grasp_cylinder")
    moments = [sensor[0], sensor[len(sensor) // 2], sensor[-1]]
    for moment in moments:
        digest = hashlib.sha256(moment.left.tobytes() + moment.right.tobytes())
        print(f"images {digest.hexdigest()}")
    part = gs.geometry.shape_mesh({"kind": "cylinder", "radius_mm": 4.0, "length_mm": 20.0})
    peg = gs.Template.from_triangles(*part)
    print(f"template {peg.digest:016x}")
    truth = moments[-1].t_sensor_object
    guess = truth @ gs.geometry.se3_exp([0.02, -0.02, 0.02, 0.3, -0.3, 0.3])
    for name in gs.Params.presets():
        pipeline = gs.Pipeline(sensor.scene.rig, gs.Params.preset(name))
        frames = [pipeline.process(moment.left, moment.right) for moment in moments]
        found = gs.localize(frames[-1], peg, guess=guess, params=pipeline.params)
        print(name, *(f"{frame.digest:016x}" for frame in frames), f"{found.digest:016x}")


main()
