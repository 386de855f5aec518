"""The command ``gelstereo simulate``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gelstereo import Error, SimulatedFrame, simulate
from gelstereo.cli.files import write_image
from gelstereo.progress import progress
from gelstereo.simulation import plan_record

EXAMPLES = """examples:
  gelstereo simulate scenes/press_sphere.toml --output out/sphere
  gelstereo simulate scenes/board_0_8.toml --output out/board --frames 0 15
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("scene", type=Path, help="scene file (TOML)")
    parser.add_argument(
        "--output",
        type=Path,
        required=True,
        help="folder for left/NNNN.png, right/NNNN.png, truth.npz, rig.toml, scene.toml, plan.json; "
        "only for what the scene asks, if it says so",
    )
    parser.add_argument(
        "--frames",
        type=int,
        nargs="+",
        metavar="N",
        help="frames to render, counted among those that arrive; all if left out",
    )


def run(arguments: argparse.Namespace) -> int:
    """Simulate the scene; return the exit code."""
    simulator = simulate(arguments.scene)
    wanted = _wanted(arguments.frames, len(simulator))
    print(simulator.plan, end="")
    asked = simulator.scene.to_dict().get("asked")
    kind = "images" if asked is None else asked["kind"]
    arguments.output.mkdir(parents=True, exist_ok=True)
    frames = []
    for index in progress(wanted, "rendering" if kind == "images" else "simulating"):
        frames.append(simulator[index])
        if kind == "images":
            _write_images(frames[-1], arguments.output)
    _write_truth(arguments.output / "truth.npz", frames, views=kind != "points")
    simulator.plan.scene.rig.save(arguments.output / "rig.toml")
    record = json.dumps(plan_record(simulator.plan), indent=1)
    (arguments.output / "plan.json").write_text(record + "\n", encoding="utf-8")
    simulator.scene.save(arguments.output / "scene.toml")
    written = {
        "images": "stereo frames and their truth",
        "positions": "frames' markers, in space and in both images",
    }
    what = written.get(kind, "frames' markers in space")
    print(f"wrote {len(frames)} {what} to {arguments.output}")
    return 0


def _wanted(frames: Sequence[int] | None, count: int) -> Sequence[int]:
    """Indices of the frames to render; each must exist in the scene."""
    for index in frames or ():
        if not 0 <= index < count:
            raise Error(f"there is no frame {index}; the scene has {count}, counted from 0")
    return range(count) if frames is None else frames


def _write_images(frame: SimulatedFrame, folder: Path) -> None:
    write_image(folder / "left" / f"{frame.index:04d}.png", frame.left)
    write_image(folder / "right" / f"{frame.index:04d}.png", frame.right)


def _write_truth(path: Path, frames: list[SimulatedFrame], *, views: bool) -> None:
    names = ["index", "time_s", "points_mm", "indentation_mm", "in_contact"]
    if views:
        names += ["normals", "left_px", "right_px"]
    if all(frame.t_sensor_object is not None for frame in frames):
        names.append("t_sensor_object")
    if any(len(frame.t_sensor_objects) > 1 for frame in frames):
        names.append("touched_by")
    arrays: dict[str, Any] = {name: np.stack([getattr(frame, name) for frame in frames]) for name in names}
    np.savez_compressed(path, **arrays)
