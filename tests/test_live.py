"""Live runs: every source gives the same frames, results do not depend on who looks, and what is written is
read.
"""

from __future__ import annotations

import dataclasses
import http.client
import itertools
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gelstereo as gs
from gelstereo.cli import main
from gelstereo.live import FolderSource, LiveFrame, LiveSensor, SceneSource
from gelstereo.live.latest import Latest
from gelstereo.live.meter import Meter
from gelstereo.live.picture import LivePicture
from gelstereo.live.run import LiveRun
from gelstereo.live.sensing import ExpectedPart, LiveResult
from gelstereo.live.shown import Shown
from gelstereo.live.source import _there_and_back
from gelstereo.live.web import WebViewer
from gelstereo.view.window import window_problem

SCENES = Path(__file__).parents[1] / "scenes"
SCENE = SCENES / "grasp_cylinder.toml"
#: Bounds of "does not hang", seconds: generous, for machines that are busy with other things.
PATIENCE_S = 60.0


class Played:
    """A source that gives these frames, as quickly as they are taken."""

    name = "frames of a test"
    rate_hz = None

    def __init__(self, frames: list[LiveFrame]) -> None:
        self.frames = frames
        self.closed = False

    def __iter__(self) -> Iterator[LiveFrame]:
        for frame in self.frames:
            if self.closed:
                return
            yield frame

    def close(self) -> None:
        self.closed = True


@pytest.fixture(scope="module")
def scene() -> gs.Simulator:
    return gs.simulate(SCENE)


@pytest.fixture(scope="module")
def frames(scene: gs.Simulator) -> list[LiveFrame]:
    """A press from rest to contact, and a frame that did not come."""
    taken = [0, 8, 16, 24, 30, 36, 44]
    out = [LiveFrame(scene[k].left, scene[k].right, n, n * 33_000_000) for n, k in enumerate(taken)]
    gone = "camera X is gone (No such device); trying again in 500 ms"
    return [*out, dataclasses.replace(out[-1], stale=True, dropped=2, event=gone)]


@pytest.fixture(scope="module")
def part(scene: gs.Simulator) -> ExpectedPart:
    peg = gs.Template.from_triangles(
        *gs.geometry.shape_mesh({"kind": "cylinder", "radius_mm": 4.0, "length_mm": 20.0})
    )
    start = scene[0].t_sensor_object
    assert start is not None
    return ExpectedPart(peg, start)


@pytest.fixture(scope="module")
def results(scene: gs.Simulator, frames: list[LiveFrame], part: ExpectedPart) -> list[LiveResult]:
    sensor = LiveSensor(scene.scene.rig, gs.Params.preset("balanced"), part)
    return [sensor.process(frame) for frame in frames]


def test_a_result_is_the_pipelines(
    scene: gs.Simulator, frames: list[LiveFrame], results: list[LiveResult]
) -> None:
    pipeline = gs.Pipeline(scene.scene.rig, gs.Params.preset("balanced"))
    for frame, result in zip(frames[:-1], results, strict=False):
        assert result.sensed is not None
        assert result.sensed.digest == pipeline.process(frame.left, frame.right).digest
    assert results[-1].sensed is None and results[-1].latency_ms is None


def test_the_held_part_is_located(scene: gs.Simulator, results: list[LiveResult]) -> None:
    assert results[0].located is None
    found, truth = results[6].located, scene[44].t_sensor_object
    assert found is not None and truth is not None
    # The axis of the peg and its distance; its spin is free, and so is the slide where its ends do not press.
    assert found.t_sensor_object[:3, 2] @ truth[:3, 2] > 0.9995
    assert found.t_sensor_object[2, 3] == pytest.approx(truth[2, 3], abs=0.05)


def test_a_frame_that_cannot_be_sensed_is_a_result(frames: list[LiveFrame], scene: gs.Simulator) -> None:
    sensor = LiveSensor(scene.scene.rig, gs.Params())
    blank = np.full_like(frames[0].left, 128)
    result = sensor.process(dataclasses.replace(frames[0], left=blank))
    assert result.sensed is None and result.problem
    assert sensor.process(frames[0]).sensed is not None


@given(count=st.integers(1, 40), taken=st.integers(1, 200))
def test_playing_there_and_back_never_jumps(count: int, taken: int) -> None:
    order = list(itertools.islice(_there_and_back(count), taken))
    assert order[0] == 0
    assert all(abs(b - a) == (1 if count > 1 else 0) for a, b in itertools.pairwise(order))
    assert set(order) == set(range(min(count, taken)))


def test_a_scene_gives_the_simulators_images_on_a_steady_clock(scene: gs.Simulator) -> None:
    source = SceneSource(SCENE)
    for index, frame in enumerate(itertools.islice(source, 3)):
        assert np.array_equal(frame.left, scene[index].left) and np.array_equal(
            frame.right, scene[index].right
        )
        assert (frame.sequence, frame.driver_ns, frame.stale) == (index, None, False)
        assert frame.time_ns == round(index * 1e9 / 30.0)


def test_a_folder_gives_its_images(tmp_path: Path, frames: list[LiveFrame]) -> None:
    for frame in frames[:2]:
        for view in ("left", "right"):
            (tmp_path / view).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / view / f"{frame.sequence}.png"), getattr(frame, view))
    played = list(itertools.islice(FolderSource(tmp_path, rate_hz=500.0), 4))
    assert [np.array_equal(a.left, frames[k].left) for a, k in zip(played, [0, 1, 0, 1], strict=True)] == [
        True
    ] * 4


@given(
    st.lists(
        st.tuples(st.floats(0.0, 0.3), st.booleans(), st.booleans(), st.integers(0, 5)),
        min_size=1,
        max_size=80,
    )
)
def test_the_meter_counts_every_result_once(steps: list[tuple[float, bool, bool, int]]) -> None:
    now_s = 0.0
    meter = Meter(clock=lambda: now_s)
    image = np.zeros((2, 2), dtype=np.uint8)
    for step_s, stale, event, dropped in steps:
        now_s += step_s
        text = f"event {now_s}" if event else None
        frame = LiveFrame(image, image, 0, 0, dropped=dropped, stale=stale, event=text)
        problem = "blank" if not stale else None
        reading = meter.count(LiveResult(frame, problem=problem, latency_ms=None if stale else 3.0))
    assert reading.frames + reading.stale == len(steps)
    assert reading.failed == reading.frames
    assert reading.dropped == sum(dropped for *_, dropped in steps)
    assert reading.p50_ms in (0.0, 3.0) and reading.rate_hz >= 0.0
    numbers = [event.number for event in reading.events]
    assert numbers == sorted(set(numbers)) and len(numbers) <= 5


def test_the_meter_measures_rate_and_latency() -> None:
    now_s = 0.0
    meter = Meter(clock=lambda: now_s)
    image = np.zeros((2, 2), dtype=np.uint8)
    for index in range(100):
        now_s = index / 25.0
        reading = meter.count(LiveResult(LiveFrame(image, image, index, 0), latency_ms=float(index)))
    assert reading.rate_hz == pytest.approx(25.0)
    # Of the last two seconds alone.
    assert reading.p50_ms == pytest.approx(74.0, abs=0.6) and reading.p99_ms > 97.0


def test_who_reads_the_latest_skips_and_never_goes_back() -> None:
    latest: Latest[int] = Latest()
    assert latest.newer_than(0, 0.0) is None
    latest.put(7)
    latest.put(8)
    assert latest.newer_than(0, 0.0) == (2, 8)
    assert latest.newer_than(2, 0.0) is None
    threading.Timer(0.05, latest.close).start()
    assert latest.newer_than(2, PATIENCE_S) is None and latest.closed
    assert latest.newer_than(0, 0.0) == (2, 8)


def shown(result: LiveResult) -> Shown:
    return Shown(result, Meter().count(result), "recording run.mcap, 1.0 MB")


@pytest.fixture
def picture(scene: gs.Simulator, part: ExpectedPart) -> LivePicture:
    return LivePicture(scene.scene.rig, part)


def test_the_picture_shows_what_there_is(results: list[LiveResult], picture: LivePicture) -> None:
    rest, held, stale = (shown(results[k]) for k in (0, 6, 7))
    drawn = [picture.draw(s.result, s.reading, s.recording) for s in (rest, held, stale)]
    assert len({image.shape for image in drawn}) == 1

    def has(image: np.ndarray, colour: tuple[int, int, int]) -> bool:
        return bool((image == colour).all(axis=2).any())

    salient, outline, alarm = (30, 104, 240), (120, 235, 120), (40, 40, 205)
    assert [has(image[56:620, 16:776], outline) for image in drawn] == [False, True, False]
    assert [has(image[56:620, 16:776], salient) for image in drawn] == [False, True, False]
    assert [has(image[56:60, 16:776], alarm) for image in drawn] == [False, False, True]


@pytest.fixture
def web(results: list[LiveResult], picture: LivePicture) -> Iterator[tuple[WebViewer, Latest[Shown]]]:
    newest: Latest[Shown] = Latest()
    with WebViewer(newest, lambda s: picture.draw(s.result, s.reading, s.recording), port=0) as viewer:
        newest.put(shown(results[6]))
        yield viewer, newest
        newest.close()


def connection(viewer: WebViewer) -> http.client.HTTPConnection:
    host, port = re.fullmatch(r"http://([\d.]+):(\d+)/", viewer.url).groups()  # type: ignore[union-attr]
    assert host == "127.0.0.1"
    return http.client.HTTPConnection(host, int(port), timeout=PATIENCE_S)


def get(viewer: WebViewer, path: str, **headers: str) -> tuple[int, bytes]:
    client = connection(viewer)
    client.request("GET", path, headers=headers)
    answer = client.getresponse()
    return answer.status, answer.read()


def test_the_page_needs_nothing_from_elsewhere(web: tuple[WebViewer, Latest[Shown]]) -> None:
    status, page = get(web[0], "/")
    assert status == 200 and b"stream.mjpg" in page and b"status.json" in page
    assert b"//" not in page.replace(b"<!doctype", b"")


def test_the_status_is_the_result(web: tuple[WebViewer, Latest[Shown]], results: list[LiveResult]) -> None:
    status, body = get(web[0], "/status.json")
    told, found = json.loads(body), results[6].located
    assert status == 200 and found is not None and results[6].sensed is not None
    assert told["markers"]["seen"] == 625
    assert told["contact"]["motion_px"] == results[6].sensed.motion_px
    assert told["pose"]["t_sensor_object"] == found.t_sensor_object.tolist()
    assert told["recording"] == "recording run.mcap, 1.0 MB"


def test_the_stream_is_jpeg_pictures_and_shows_new_ones(
    web: tuple[WebViewer, Latest[Shown]], results: list[LiveResult], picture: LivePicture
) -> None:
    viewer, newest = web
    client = connection(viewer)
    client.request("GET", "/stream.mjpg")
    answer = client.getresponse()
    kind = answer.getheader("Content-Type") or ""
    boundary = kind.partition("boundary=")[2]
    assert kind.startswith("multipart/x-mixed-replace") and boundary
    for result in (results[6], results[0]):
        assert answer.readline().rstrip() == f"--{boundary}".encode()
        assert answer.readline().rstrip() == b"Content-Type: image/jpeg"
        length = int(answer.readline().rpartition(b":")[2])
        answer.readline()
        image = cv2.imdecode(np.frombuffer(answer.read(length), np.uint8), cv2.IMREAD_COLOR)
        answer.readline()
        moment = shown(result)
        expected = picture.draw(moment.result, moment.reading, moment.recording)
        _, encoded = cv2.imencode(".jpg", expected, [cv2.IMWRITE_JPEG_QUALITY, 85])
        assert np.array_equal(image, cv2.imdecode(encoded, cv2.IMREAD_COLOR))
        newest.put(shown(results[0]))


def test_pages_of_other_names_are_refused(web: tuple[WebViewer, Latest[Shown]]) -> None:
    assert get(web[0], "/status.json", Host="evil.example:80")[0] == 403
    assert get(web[0], "/elsewhere")[0] == 404


def test_a_browser_that_takes_nothing_delays_nobody(
    web: tuple[WebViewer, Latest[Shown]], results: list[LiveResult]
) -> None:
    viewer, newest = web
    port = connection(viewer).port
    stuck = socket.create_connection(("127.0.0.1", port))
    stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stuck.sendall(b"GET /stream.mjpg HTTP/1.1\r\nHost: 127.0.0.1:1\r\n\r\n")
    for index in range(40):
        newest.put(shown(results[index % 7]))
        time.sleep(0.01)
    assert get(viewer, "/picture.jpg")[0] == 200
    stuck.close()


def test_what_is_not_installed_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in ("record", "rerun_viewer"):
        monkeypatch.delitem(sys.modules, f"gelstereo.live.{module}", raising=False)
    words = ["live", "--scene", str(SCENE), "--frames", "1", "--show"]
    for module, extra, more in (
        ("rosbags.typesys", "recording", ["none", "--record", str(tmp_path / "run.mcap")]),
        ("rerun", "rerun", ["rerun", "--rrd", str(tmp_path / "run.rrd")]),
    ):
        monkeypatch.setitem(sys.modules, module, None)
        assert main([*words, *more]) == 2
        assert f"pip install 'gelstereo[{extra}]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_camera_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gs.simulate(SCENE).scene.rig.save(tmp_path / "rig.toml")
    words = ["live", "--camera", "/dev/null", "--show", "none"]
    assert main(words) == 2
    assert "--rig" in capsys.readouterr().err
    assert main([*words, "--rig", str(tmp_path / "rig.toml"), "--record", str(tmp_path / "run.mcap")]) == 2
    assert "/dev/null" in capsys.readouterr().err
    assert not (tmp_path / "run.mcap").exists()


def test_a_port_in_use_is_an_error(web: tuple[WebViewer, Latest[Shown]]) -> None:
    with pytest.raises(gs.Error, match=r"port \d+ of 127\.0\.0\.1 cannot be used"):
        WebViewer(Latest(), lambda shown: np.zeros((2, 2, 3), np.uint8), connection(web[0]).port)


def test_a_viewer_that_never_looks_does_not_stop_sensing(
    frames: list[LiveFrame], scene: gs.Simulator
) -> None:
    with LiveRun(Played(frames * 3), LiveSensor(scene.scene.rig, gs.Params.preset("balanced"))) as live:
        assert live.wait(PATIENCE_S)
    assert live.reading.frames == 21 and live.reading.stale == 3 and live.newest.closed


def test_an_error_of_the_source_ends_the_run_and_is_told(
    scene: gs.Simulator, frames: list[LiveFrame]
) -> None:
    class Broken(Played):
        def __iter__(self) -> Iterator[LiveFrame]:
            yield self.frames[0]
            raise gs.Error("the camera is on fire")

    source = Broken(frames)
    live = LiveRun(source, LiveSensor(scene.scene.rig, gs.Params()))
    with live, pytest.raises(gs.Error, match="on fire"):
        live.wait(PATIENCE_S)
    assert source.closed and live.newest.closed


def test_there_is_no_window_without_a_display(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert window_problem("use --show web") is not None
    assert main(["live", "--scene", str(SCENE), "--show", "window", "--record", "never.mcap"]) == 2
    assert "--show web" in capsys.readouterr().err
    assert not Path("never.mcap").exists()


def test_ctrl_c_ends_the_web_page_and_completes_the_recording(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="PyPI's rosbags is not installed")
    from mcap.reader import make_reader

    path = tmp_path / "run.mcap"
    command = [sys.executable, "-m", "gelstereo.cli.main", "live", "--scene", str(SCENE), "--port", "0"]
    program = "import sys; from gelstereo.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", program, *command[3:], "--show", "web", "--record", str(path)]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as live:
        assert live.stdout is not None
        url = re.search(r"http://127\.0\.0\.1:(\d+)/", live.stdout.readline())
        assert url is not None
        client = http.client.HTTPConnection("127.0.0.1", int(url[1]), timeout=PATIENCE_S)
        deadline_s = time.monotonic() + PATIENCE_S
        frames = 0
        while frames < 3 and time.monotonic() < deadline_s:
            client.request("GET", "/status.json")
            frames = json.loads(client.getresponse().read()).get("source", {}).get("frames", 0)
            time.sleep(0.05)
        live.send_signal(signal.SIGINT)
        out, err = live.communicate(timeout=PATIENCE_S)
    assert live.returncode == 0, err
    assert "sensed" in out and str(path) in out
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.statistics is not None and summary.statistics.message_count > 12
