"""What `gelstereo-host sense --publish` sends, read by programs that nobody here wrote.

ROS 2 messages over zenoh are read by zenoh's own Python binding and by hiroz, a ROS 2 node (tests/ros_peer).
A plain WebSocket client stands for Foxglove. rosbags decodes the messages and computes the hashes of their
types.

$GELSTEREO_HOST_LIVE names a host that was built with `--features zenoh,foxglove`, and $GELSTEREO_ROS_PEER the
built ros-peer.
"""

from __future__ import annotations

import json
import os
import socket
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

RESULTS = {
    "/gelstereo/points": "sensor_msgs/msg/PointCloud2",
    "/gelstereo/frame": "std_msgs/msg/String",
    "/gelstereo/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/gelstereo/stage": "std_msgs/msg/String",
    "/gelstereo/capture": "std_msgs/msg/String",
    "/gelstereo/contact": "std_msgs/msg/String",
}
LIMIT_S = 60.0


def given(variable: str, what: str) -> str:
    if path := os.environ.get(variable):
        return str(Path(path).resolve())
    pytest.skip(f"${variable} names no {what}")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def sensing(folder: Path, settings: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """The host, until the block ends; then it must end well."""
    (folder / "live.toml").write_text(settings)
    host = given("GELSTEREO_HOST_LIVE", "gelstereo-host with zenoh and foxglove")
    command = [host, "sense", "--config", "live.toml", "--log", "json", *arguments]
    with open(folder / "log.jsonl", "w") as log:
        running = subprocess.Popen(command, cwd=folder, stderr=log, text=True)
        try:
            yield running
        finally:
            running.terminate()
            code = running.wait(LIMIT_S)
    text = (folder / "log.jsonl").read_text()
    assert code == 0, text
    assert json.loads(text.splitlines()[-1])["reason"] == "stopped", text


@pytest.fixture(scope="module")
def ros():
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def zenoh_settings(port: int, more: str = "") -> str:
    return f'[sense.zenoh]\nconnect = []\nlisten = ["tcp/127.0.0.1:{port}"]\ndomain_id = 7\n{more}'


@contextmanager
def zenoh_session(port: int):
    zenoh = pytest.importorskip("zenoh")
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    begun = time.monotonic()
    while True:
        try:
            session = zenoh.open(config)
            break
        except zenoh.ZError:
            assert time.monotonic() < begun + LIMIT_S, "the host does not listen"
            time.sleep(0.2)
    with session:
        yield session


def dds(name: str) -> str:
    package, kind, message = name.split("/")
    return f"{package}::{kind}::dds_::{message}_"


def collect(session, pattern: str, enough) -> dict[str, list]:
    samples: dict[str, list] = {}

    def keep(sample) -> None:
        samples.setdefault(str(sample.key_expr), []).append(sample)

    subscriber = session.declare_subscriber(pattern, keep)
    begun = time.monotonic()
    while not enough(samples):
        assert time.monotonic() < begun + LIMIT_S, sorted(samples)
        time.sleep(0.1)
    subscriber.undeclare()
    return samples


def test_zenoh_has_keys_tokens_attachments_and_messages_of_ros(tmp_path, ros) -> None:
    port = free_port()
    with sensing(tmp_path, zenoh_settings(port), "--publish", "zenoh"), zenoh_session(port) as session:
        expected = {
            f"7{topic}/{dds(kind)}/{ros.hash_rihs01(kind)}": (topic, kind) for topic, kind in RESULTS.items()
        }
        samples = collect(session, "7/**", lambda seen: len(seen) == len(RESULTS))
        assert set(samples) == set(expected)
        for key, (topic, kind) in expected.items():
            gids, numbers = set(), []
            for sample in samples[key]:
                message = ros.deserialize_cdr(sample.payload.to_bytes(), kind)
                number, stamp_ns, length, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
                assert length == 16 and abs(stamp_ns - time.time_ns()) < 600e9
                gids.add(gid)
                numbers.append(number)
                if topic == "/gelstereo/points":
                    assert (message.height, message.width, message.point_step) == (25, 25, 20)
                if topic == "/gelstereo/pose":
                    assert 0.02 < message.pose.pose.position.z < 0.05, "metres"
            assert len(gids) == 1 and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        tokens = [str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/7/**", timeout=5)]
        kinds = [token.split("/")[5] for token in tokens]
        assert sorted(kinds) == ["MP"] * len(RESULTS) + ["NN"]
        published = {token.split("/")[9].replace("%", "/") for token in tokens if "/MP/" in token}
        assert published == set(RESULTS)


def test_humble_gets_its_own_word_for_the_hash(tmp_path) -> None:
    port = free_port()
    settings = zenoh_settings(port, 'type_hash = "not_supported"\nimages = true\n')
    with sensing(tmp_path, settings, "--publish", "zenoh"), zenoh_session(port) as session:
        samples = collect(session, "7/**/TypeHashNotSupported", lambda seen: len(seen) >= 4)
        assert any("left/image" in key for key in samples)


def test_a_ros_node_of_another_hand_lists_and_reads_the_topics(tmp_path) -> None:
    port = free_port()
    peer = given("GELSTEREO_ROS_PEER", "ros-peer (cargo build --manifest-path tests/ros_peer/Cargo.toml)")
    with sensing(tmp_path, zenoh_settings(port), "--publish", "zenoh"):
        with zenoh_session(port):
            pass  # It listens.
        done = subprocess.run(
            [peer, f"tcp/127.0.0.1:{port}", "7"], capture_output=True, text=True, check=False, timeout=120
        )
    assert done.returncode == 0, done.stderr
    said = [line.split(" ", 2) for line in done.stdout.splitlines()]
    topics = {line[1]: line[2] for line in said if line[0] == "topic"}
    assert topics == {topic: dds(kind) for topic, kind in RESULTS.items()}
    assert ["node", "gelstereo"] in said
    rest = {line[0]: line[1:] for line in said}
    assert json.loads(" ".join(rest["contact"])).keys() >= {"touching", "salient", "motion_px"}
    assert rest["points"] == ["25", "25 20 gelstereo_left_optical_frame"]
    assert 0.02 < float(rest["pose"][1].split()[1]) < 0.05


@contextmanager
def viewer(port: int):
    """A WebSocket client with the subprotocol that Foxglove and Lichtblick ask for."""
    client = pytest.importorskip("websockets.sync.client")
    begun = time.monotonic()
    while True:
        try:
            connection = client.connect(
                f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=None
            )
            break
        except OSError:
            assert time.monotonic() < begun + LIMIT_S, "the host does not listen"
            time.sleep(0.2)
    with connection:
        yield connection


def test_a_viewer_gets_schemas_and_messages_by_websocket(tmp_path) -> None:
    port = free_port()
    topics = {
        **RESULTS,
        "/gelstereo/wrench": "geometry_msgs/msg/WrenchStamped",
        "/gelstereo/slip": "std_msgs/msg/String",
        "/gelstereo/left/image": "sensor_msgs/msg/Image",
        "/gelstereo/right/image": "sensor_msgs/msg/Image",
    }
    settings = (
        f"sense.foxglove.port = {port}\n"
        '[params.force]\nmethod = "ridge"\nthickness_mm = 5.0\nyoung_kpa = 100.0\n'
        '[params.slip]\nmethod = "rigid"\n'
    )
    with sensing(tmp_path, settings, "--publish", "foxglove"), viewer(port) as socket_:
        channels: dict[int, dict] = {}
        while len(channels) < len(topics):
            told = json.loads(socket_.recv(LIMIT_S))
            for channel in told.get("channels", []):
                channels[channel["id"]] = channel
        assert {c["topic"]: c["schemaName"] for c in channels.values()} == topics
        assert {(c["encoding"], c["schemaEncoding"]) for c in channels.values()} == {("cdr", "ros2msg")}
        socket_.send(
            json.dumps(
                {
                    "op": "subscribe",
                    "subscriptions": [{"id": number, "channelId": number} for number in channels],
                }
            )
        )
        seen: dict[str, object] = {}
        begun = time.monotonic()
        while len(seen) < len(topics):
            assert time.monotonic() < begun + LIMIT_S, sorted(seen)
            data = socket_.recv(LIMIT_S)
            if isinstance(data, str):
                continue
            opcode, subscription, _time_ns = struct.unpack_from("<BIQ", data)
            assert opcode == 1
            channel = channels[subscription]
            seen[channel["topic"]] = store_of(channel).deserialize_cdr(data[13:], channel["schemaName"])
    image = seen["/gelstereo/left/image"]
    assert (image.width, image.height, image.encoding) == (640, 480, "mono8")
    assert "touching" in json.loads(seen["/gelstereo/contact"].data)
    assert "status" in json.loads(seen["/gelstereo/slip"].data)
    force = seen["/gelstereo/wrench"].wrench.force
    assert force.x**2 + force.y**2 + force.z**2 > 0.0


def store_of(channel: dict):
    """Types as the schema's own text has them, which is what a viewer goes by."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
    return store


def test_only_this_computer_can_connect(tmp_path) -> None:
    """Without other settings, sockets are bound to the loopback address alone."""
    ports = free_port(), free_port()
    settings = zenoh_settings(ports[0]) + f"[sense.foxglove]\nport = {ports[1]}\n"
    with sensing(tmp_path, settings, "--publish", "zenoh", "--publish", "foxglove") as running:
        with viewer(ports[1]):
            pass
        inodes = set()
        for entry in Path(f"/proc/{running.pid}/fd").iterdir():
            target = os.readlink(entry)
            if target.startswith("socket:["):
                inodes.add(target[8:-1])
        listening = []
        for table in ("tcp", "tcp6", "udp", "udp6"):
            for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
                fields = line.split()
                if fields[9] in inodes and (table.startswith("udp") or fields[3] == "0A"):
                    listening.append((table, fields[1].split(":")[0]))
        assert ("tcp", "0100007F") in listening
        assert all(entry == ("tcp", "0100007F") for entry in listening), listening
