"""Programs of other authors feed the host: GStreamer and ffmpeg, with frames that have no headers."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from test_recording_readers import host_binary
from test_streams import folder_digests

import gelstereo

pytestmark = pytest.mark.long

WIDTH, HEIGHT = 1280, 480


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory, noisy_press) -> Path:
    """A configuration, the frames one after the other, and the same frames as images."""
    import cv2

    folder = tmp_path_factory.mktemp("desk")
    (folder / "rig.toml").write_text(gelstereo.Scene().rig.to_toml())
    (folder / "cell.toml").write_text('rig_file = "rig.toml"\nsense.localize = "never"\n')
    joints = [np.hstack((frame.left, frame.right)) for frame in noisy_press]
    assert joints[0].shape == (HEIGHT, WIDTH)
    (folder / "frames.raw").write_bytes(b"".join(joint.tobytes() for joint in joints))
    for index, joint in enumerate(joints):
        cv2.imwrite(str(folder / f"joint_{index:05d}.png"), joint)
    return folder


FEEDERS = {
    "gst-launch-1.0": (
        "gst-launch-1.0 -q filesrc location=frames.raw"
        f" ! rawvideoparse width={WIDTH} height={HEIGHT} format=gray8 framerate=30/1"
        f" ! videoconvert ! video/x-raw,format=GRAY8,width={WIDTH},height={HEIGHT} ! fdsink fd=1"
    ),
    "ffmpeg": ("ffmpeg -loglevel error -framerate 30 -i joint_%05d.png -f rawvideo -pix_fmt gray pipe:1"),
}


@pytest.mark.parametrize("program", FEEDERS)
def test_host_senses_what_others_send_to_the_same_bits(program, desk, noisy_press) -> None:
    if shutil.which(program) is None:
        pytest.skip(
            f"{program} is not installed (Debian: gstreamer1.0-tools, gstreamer1.0-plugins-base, ffmpeg)"
        )
    host = f"{Path(host_binary()).resolve()} sense --config cell.toml --stream - --raw-size {WIDTH}x{HEIGHT}"
    done = subprocess.run(
        f"{FEEDERS[program]} | {host} --every --jsonl",
        shell=True,
        cwd=desk,
        capture_output=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr.decode()
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    expected = folder_digests(desk / "cell.toml", noisy_press)
    assert [line["digest"] for line in lines] == expected, done.stderr.decode()
