"""Frames that Python writes and the host reads through a pipe."""

from __future__ import annotations

import io
import json
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_recording_readers import host_binary

import gelstereo
from gelstereo import streams

FIELDS = struct.Struct("<4sBBBBQQIIIII")


@given(
    half=st.integers(1, 40),
    rows=st.integers(1, 20),
    layout=st.sampled_from(["side_by_side", "side_by_side_swapped", "interleaved", "interleaved_swapped"]),
    captured_ns=st.one_of(st.none(), st.integers(1, 2**64 - 1)),
    sequence=st.integers(0, 2**64 - 1),
)
def test_header_has_the_bytes_of_the_table(half, rows, layout, captured_ns, sequence) -> None:
    payload = bytes(2 * half * rows)
    head = streams.header(
        payload, sequence=sequence, captured_ns=captured_ns, size_px=(2 * half, rows), layout=layout
    )
    magic, version, kind, where, flags, number, moment, width, height, length, crc, own = FIELDS.unpack(head)
    assert (magic, version, kind, flags) == (b"\x89GSF", 1, 0, 1)
    assert (number, moment, width, height, length) == (
        sequence,
        captured_ns or 0,
        2 * half,
        rows,
        len(payload),
    )
    assert where == ["side_by_side", "side_by_side_swapped", "interleaved", "interleaved_swapped"].index(
        layout
    )
    assert (crc, own) == (zlib.crc32(payload), zlib.crc32(head[:40]))


def test_nonsense_is_refused_in_words() -> None:
    writer = streams.FrameWriter(io.BytesIO())
    grey = np.zeros((4, 6), np.uint8)
    with pytest.raises(ValueError, match="valid is uint8 of"):
        writer.write_pair(grey.astype(float), grey)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="both views must have one size"):
        writer.write_pair(grey, grey[:2])
    with pytest.raises(ValueError, match="valid is an even width"):
        writer.write(grey[:, :5])
    with pytest.raises(ValueError, match="valid is one of side_by_side"):
        writer.write(grey, layout="stacked")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="valid is 1 to"):
        writer.write_jpeg(b"", (6, 4))
    with pytest.raises(ValueError, match="captured_ns is 0"):
        writer.write(grey, captured_ns=0)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A configuration of the simulated sensor for real images."""
    folder = tmp_path_factory.mktemp("cell")
    (folder / "rig.toml").write_text(gelstereo.Scene().rig.to_toml())
    (folder / "cell.toml").write_text('rig_file = "rig.toml"\nsense.localize = "never"\n')
    return folder / "cell.toml"


def sense(cell: Path, pipe: bytes, *extra: str) -> tuple[list[dict], str]:
    command = [host_binary(), "sense", "--config", str(cell), "--stream", "-", "--every", "--jsonl", *extra]
    done = subprocess.run(command, input=pipe, capture_output=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr.decode()
    return [json.loads(line) for line in done.stdout.splitlines()], done.stderr.decode()


def folder_digests(cell: Path, frames: list[gelstereo.SimulatedFrame]) -> list[str]:
    """What the host makes of the same frames as images in a folder."""
    import cv2

    pairs = cell.parent / "pairs"
    pairs.mkdir(exist_ok=True)
    for index, frame in enumerate(frames):
        cv2.imwrite(str(pairs / f"left_{index:05d}.png"), frame.left)
        cv2.imwrite(str(pairs / f"right_{index:05d}.png"), frame.right)
    source = 'source = { kind = "folder", path = "pairs", frame_rate_hz = 30.0 }\n'
    (cell.parent / "folder.toml").write_text(cell.read_text() + source)
    command = [host_binary(), "sense", "--config", str(cell.parent / "folder.toml"), "--jsonl"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    digests = [json.loads(line)["digest"] for line in done.stdout.splitlines()]
    assert len(digests) == len(frames)
    return digests


def test_host_senses_what_python_writes_to_the_same_bits(cell, noisy_press) -> None:
    pipe = io.BytesIO()
    writer = streams.FrameWriter(pipe)
    for frame in noisy_press:
        writer.write_pair(frame.left, frame.right)
    lines, _ = sense(cell, pipe.getvalue())
    assert [line["digest"] for line in lines] == folder_digests(cell, noisy_press)
    assert [line["capture"]["sequence"] for line in lines] == list(range(len(lines)))
    moments = [line["time_ns"] for line in lines]
    assert moments == sorted(moments) and moments[0] > 0


def test_jpeg_of_opencv_arrives(cell, noisy_press) -> None:
    import cv2

    pipe = io.BytesIO()
    writer = streams.FrameWriter(pipe)
    for frame in noisy_press[:2]:
        joint = np.hstack((frame.left, frame.right))
        done, jpeg = cv2.imencode(".jpg", joint, [cv2.IMWRITE_JPEG_QUALITY, 98])
        assert done
        writer.write_jpeg(jpeg.tobytes(), (joint.shape[1], joint.shape[0]))
    lines, log = sense(cell, pipe.getvalue())
    assert [line.get("error") for line in lines] == [None, None], log


def test_frames_that_lost_bytes_are_told(cell, noisy_press) -> None:
    pipe = io.BytesIO()
    writer = streams.FrameWriter(pipe)
    for frame in noisy_press[:4]:
        writer.write_pair(frame.left, frame.right)
    whole = pipe.getvalue()
    size = len(whole) // 4
    lines, log = sense(cell, whole[: size + 500] + whole[size + 700 :], "--log", "json")
    assert [line["capture"]["sequence"] for line in lines] == [0, 3]
    assert "differs from its checksum" in log and lines[1]["capture"]["dropped"] == 2


def test_example_feeds_the_host(cell) -> None:
    """examples/feed_host.py with the simulated camera, through a real pipe."""
    import os
    import sys

    example = Path(__file__).parents[1] / "examples" / "feed_host.py"
    feed = subprocess.Popen([sys.executable, str(example), "--frames", "8"], stdout=subprocess.PIPE)
    command = [host_binary(), "sense", "--config", str(cell), "--stream", "-", "--every", "--log", "json"]
    done = subprocess.run(
        command, stdin=feed.stdout, capture_output=True, check=False, timeout=120, env=os.environ
    )
    assert feed.stdout is not None
    feed.stdout.close()
    assert (feed.wait(60), done.returncode) == (0, 0), done.stderr.decode()
    ended = json.loads(done.stderr.splitlines()[-1])
    assert (ended["report"], ended["totals"]["frames"], ended["totals"]["bad_frames"]) == ("ended", 8, 0)
    # Both clocks are the same one: a frame takes some milliseconds, and not years.
    assert 0 < ended["latency"]["p50_ms"] < 60_000
