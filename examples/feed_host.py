"""Feeds ``gelstereo-host sense`` from a camera that OpenCV opens, or from a simulated one.

    python examples/feed_host.py --camera 0 | gelstereo-host sense --config cell.toml --stream - --jsonl

Any other camera needs what :func:`camera` does: grey images of both views and the moment of their exposure.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

import gelstereo
from gelstereo.streams import FrameWriter

#: Both views side by side, and the moment of exposure by ``time.monotonic_ns()``.
Joint = tuple[npt.NDArray[np.uint8], int]


def camera(index: int) -> Iterator[Joint]:
    """Frames of a stereo camera that sends both views side by side."""
    import cv2

    capture = cv2.VideoCapture(index)
    while True:
        arrived, colours = capture.read()
        if not arrived:
            raise SystemExit(
                f"camera {index} sends nothing; is it connected, and not used by another program?"
            )
        yield cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY), time.monotonic_ns()


def simulation() -> Iterator[Joint]:
    """A ball pressed into the simulated sensor, over and over."""
    simulator = gelstereo.simulate(
        {
            "indenter": {"kind": "sphere", "radius_mm": 4.0},
            "trajectory": [
                {"time_s": 0.0, "position_mm": [4.0, 0.0, 33.0]},
                {"time_s": 1.0, "position_mm": [4.0, 0.0, 31.2]},
                {"time_s": 2.0, "position_mm": [4.0, 0.0, 33.0]},
            ],
        }
    )
    for index in itertools.cycle(range(len(simulator))):
        frame = simulator[index]
        yield np.hstack((frame.left, frame.right)), time.monotonic_ns()


def main() -> None:
    parser = argparse.ArgumentParser(description="Feeds gelstereo-host sense --stream -.")
    parser.add_argument(
        "--camera", type=int, help="OpenCV's number of the camera; without it, a simulated one"
    )
    parser.add_argument("--frames", type=int, help="end after so many frames")
    arguments = parser.parse_args()
    frames = simulation() if arguments.camera is None else camera(arguments.camera)
    writer = FrameWriter(sys.stdout.buffer)
    for joint, captured_ns in itertools.islice(frames, arguments.frames):
        writer.write(joint, captured_ns=captured_ns)


if __name__ == "__main__":
    try:
        main()
    except BrokenPipeError:
        sys.exit("the host does not listen any more")
