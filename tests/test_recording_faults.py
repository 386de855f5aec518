"""Recordings whose writer was killed, whose disk was full or whose file was cut, in readers that nobody here
wrote.

Readers that need an index get what ``gelstereo-host recover`` makes of the file.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from test_recording_readers import host_binary, rerun_columns

FRAME = "/gelstereo/frame"
#: Seconds after the rest frame at which a process is killed.
KILLED_AFTER_S = (0.05, 0.4, 0.9)


def host(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [host_binary(), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def killed(folder: Path, after_s: float) -> Path:
    """A recording of a job that was killed as ``kill -9`` does, while the fingers closed slowly."""
    config, path = folder / "slow.toml", folder / "killed.mcap"
    config.write_text("[task]\nclosing_speed_mm_s = 0.1\n")
    command = [host_binary(), "run", "--config", str(config), "--record", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert any(line.startswith("rest") for line in process.stdout)
        time.sleep(after_s)
        process.send_signal(signal.SIGKILL)
    return path


def cut(folder: Path, share: float) -> Path:
    """A piece of an unfinished recording."""
    whole = killed(folder, 1.0).read_bytes()
    path = folder / "cut.mcap"
    path.write_bytes(whole[: int(len(whole) * share)])
    return path


def full(folder: Path) -> Path:
    """A recording on a file system of 3 MB; the job goes on and says so."""
    disk, kept = folder / "disk", folder / "full.mcap"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(disk)]
    if os.name != "posix" or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("this user may not mount a tmpfs")
    try:
        done = host("run", "--json", "--record", disk / "run.mcap")
        assert done.returncode == 2 and "No space left" in done.stderr, done.stderr
        assert json.loads(done.stdout)["outcome"]["kind"] == "inserted"
        kept.write_bytes((disk / "run.mcap").read_bytes())
    finally:
        subprocess.run(["umount", str(disk)], check=True)
    return kept


FAULTS: dict[str, Callable[[Path], Path]] = {
    **{f"killed after {s} s": (lambda folder, s=s: killed(folder, s)) for s in KILLED_AFTER_S},
    **{f"cut at {share:.0%}": (lambda folder, share=share: cut(folder, share)) for share in (0.2, 0.55, 0.9)},
    "disk full": full,
}


@pytest.fixture(scope="module", params=FAULTS.values(), ids=FAULTS.keys())
def broken(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return request.param(tmp_path_factory.mktemp("broken"))


@pytest.fixture(scope="module")
def fixed(broken: Path) -> Path:
    """What ``recover`` makes of it; the broken file stays as it is."""
    path, before = broken.with_name("fixed.mcap"), broken.read_bytes()
    done = host("recover", broken, path)
    assert done.returncode == 0, done.stderr
    assert broken.read_bytes() == before
    return path


def replayed_frames(path: Path) -> int:
    done = host("replay", "--json", path)
    report = json.loads(done.stdout)
    assert done.returncode == 0 and report["differing"] == 0 and report["other_pixels"] == 0, done.stdout
    return int(report["frames"])


def test_replay_gives_the_same_bits_before_and_after_recovery(broken: Path, fixed: Path) -> None:
    frames = replayed_frames(broken)
    assert frames > 0 and replayed_frames(fixed) == frames


def test_mcap_streams_the_broken_file_up_to_its_last_chunk(broken: Path) -> None:
    stream_module = pytest.importorskip("mcap.stream_reader", reason="PyPI's mcap is not installed")
    records = pytest.importorskip("mcap.records")
    exceptions = pytest.importorskip("mcap.exceptions")

    def frames(stream) -> Iterator[str]:
        channels = {}
        for record in stream_module.StreamReader(stream).records:
            if isinstance(record, records.Channel):
                channels[record.id] = record.topic
            elif isinstance(record, records.Message) and channels[record.channel_id] == FRAME:
                yield FRAME

    count = 0
    with broken.open("rb") as stream, pytest.raises((exceptions.EndOfFile, exceptions.InvalidMagic)):
        for _ in frames(stream):
            count += 1
    # It takes whole chunks, of half a second each.
    assert replayed_frames(broken) - 16 <= count <= replayed_frames(broken)


def test_mcap_reads_the_recovered_file_by_its_index(broken: Path, fixed: Path) -> None:
    reader_module = pytest.importorskip("mcap.reader", reason="PyPI's mcap is not installed")
    with fixed.open("rb") as stream:
        reader = reader_module.make_reader(stream, validate_crcs=True)
        statistics = reader.get_summary().statistics
        frames = list(reader.iter_messages(topics=[FRAME]))
        assert len(frames) == replayed_frames(broken)
        assert statistics.message_count == sum(1 for _ in reader.iter_messages())
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        assert "[params.detect]" in metadata["gelstereo"]["config_toml"]


def test_rosbags_and_mcap_ros2_decode_every_message_of_the_recovered_file(broken: Path, fixed: Path) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel", reason="PyPI's rosbags is not installed")
    ros2 = pytest.importorskip("mcap_ros2.reader", reason="PyPI's mcap-ros2-support is not installed")
    from rosbags.typesys import Stores, get_typestore

    frames = replayed_frames(broken)
    with highlevel.AnyReader([fixed], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        decoded = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == FRAME]
    assert len(decoded) == frames
    texts = [m.ros_msg.data for m in ros2.read_ros2_messages(str(fixed)) if m.channel.topic == FRAME]
    assert texts == [message.data for message in decoded]


def test_rerun_finds_images_and_clouds_in_the_recovered_file(fixed: Path, tmp_path: Path) -> None:
    columns = rerun_columns(fixed, tmp_path)
    assert "EncodedImage:blob: " in columns and "Points3D:positions: " in columns
