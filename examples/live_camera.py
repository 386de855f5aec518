"""Contact from a stereo camera that OpenCV opens; both views stand side by side in its images.

    python examples/live_camera.py --camera 0 --rig rig.toml --pitch-mm 0.8

Nothing may touch the gel when the program starts. Ctrl-C ends it. `gelstereo live` does more: it shows and
records. `gelstereo.cameras` reads cameras with their timestamps, and survives unplugging; OpenCV does
neither.
"""

from __future__ import annotations

import argparse

import cv2

import gelstereo as gs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--camera", required=True, help="number of the camera, or a video file")
    parser.add_argument("--rig", required=True, help="rig file of `gelstereo calibrate`")
    parser.add_argument("--pitch-mm", type=float, help="distance of neighbouring markers")
    arguments = parser.parse_args()

    rig = gs.Rig.load(arguments.rig)
    params = gs.Params.preset("fast")
    if arguments.pitch_mm is not None:
        params = params.replace({"lattice.pitch_mm": arguments.pitch_mm})
    pipeline = gs.Pipeline(rig, params)

    capture = cv2.VideoCapture(int(arguments.camera) if arguments.camera.isdigit() else arguments.camera)
    if not capture.isOpened():
        raise SystemExit(f"there is no camera {arguments.camera}")
    width, height = rig.size_px
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, 2 * width)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)

    while True:
        arrived, colours = capture.read()
        if not arrived:
            print("the camera sends nothing more")
            break
        grey = cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY)
        try:
            frame = pipeline.process(grey[:, :width], grey[:, width:])
        except gs.Error as error:
            # A dark or covered image: the next good one continues.
            print(f"no result: {error}")
            continue
        print(
            f"frame {frame.index}: {frame.patch.sum()} markers in contact, "
            f"deepest {frame.indentation_mm.max():.2f} mm, motion {frame.motion_px:.2f} px"
        )


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        print("stopped")
