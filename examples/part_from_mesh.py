"""A part's mesh, checked, pressed into the simulated sensor, and found again: would touch find this part?

    python examples/part_from_mesh.py scenes/parts/usb_plug.stl --units mm --turn-deg 90 0 0

The part's origin is pressed towards the middle of the gel, after it was turned. Try the ways in which the
gripper holds your part. STEP files contain their unit: leave out --units.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import trimesh

import gelstereo as gs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--units", choices=["mm", "cm", "m", "inch"], help="unit of the mesh")
    parser.add_argument("--turn-deg", type=float, nargs=3, default=[0.0, 0.0, 0.0], help="rotation vector")
    parser.add_argument("--press-mm", type=float, default=1.2, help="how deep it is pressed")
    parser.add_argument("--save", type=Path, help="write the template")
    arguments = parser.parse_args()

    template = gs.Template.from_mesh(arguments.mesh, units=arguments.units).with_symmetries()
    size_mm = np.ptp(template.points_mm, axis=0)
    print(f"size      {size_mm.round(2)} mm: is this your part?")
    print(f"surface   {template.surface!r}")
    print(f"the same  {template.symmetries or 'in no other pose'}")
    if arguments.save is not None:
        template.save(arguments.save)

    # The same part as an indenter, in a file that the simulator reads.
    vertices_mm, triangles = gs.templates.load_mesh(arguments.mesh, arguments.units)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "part.stl"
        trimesh.Trimesh(vertices_mm, triangles, process=False).export(file)
        simulator = gs.simulate(
            {
                "indenter": {"kind": "mesh", "path": str(file), "units": "mm"},
                "effects": {"shoulder": {}, "spread": {}, "defocus": {}, "sensor_noise": {}},
            }
        )
    above = gs.geometry.se3_exp([*np.radians(arguments.turn_deg), 0.0, 0.0, 0.0]).copy()
    above[:3, 3] = [4.0, 0.0, 60.0]
    truth = simulator.pressed(above, press_mm=arguments.press_mm)
    rest, pressed = simulator.press(), simulator.press(truth)

    params = gs.Params.preset("balanced")
    pipeline = gs.Pipeline(simulator.scene.rig, params)
    pipeline.process(rest.left, rest.right)
    frame = pipeline.process(pressed.left, pressed.right)

    guess = truth @ gs.geometry.se3_exp([0.03, -0.02, 0.04, 0.4, -0.3, 0.3])
    found = gs.localize(frame, template, guess=guess, params=params)
    print(f"contact   {frame.patch.sum()} markers")
    print(f"verdict   {found.verdict}")
    print(f"free      {'; '.join(map(str, found.free)) or 'nothing'}")
    sigma = np.sqrt(np.diag(found.determined_covariance))
    print(f"sigma     {sigma[3:].round(4)} mm, {np.degrees(sigma[:3]).round(3)} deg, of the other directions")


if __name__ == "__main__":
    main()
