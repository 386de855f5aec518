"""The command ``gelstereo live``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelstereo import Compliance, Error, Rig, Template
from gelstereo.cli.extras import module_of
from gelstereo.cli.files import write_image
from gelstereo.cli.options import add_guess, add_params, count, guess_of, params_of
from gelstereo.geometry import shape_mesh
from gelstereo.live.meter import Reading
from gelstereo.live.picture import LivePicture
from gelstereo.live.run import LiveRun
from gelstereo.live.sensing import ExpectedPart, LiveSensor
from gelstereo.live.shown import Shown
from gelstereo.live.source import DEFAULT_RATE_HZ, CameraSource, FolderSource, LiveSource, SceneSource
from gelstereo.live.web import DEFAULT_PORT, WebViewer
from gelstereo.live.window import show_window
from gelstereo.templates import MM_PER_UNIT
from gelstereo.view.canvas import Image
from gelstereo.view.window import window_problem

EXAMPLES = """examples:
  gelstereo live --scene scenes/grasp_cylinder.toml --frames 60         a simulated sensor
  gelstereo live --folder out/press --frames 6 --show none --picture last.png     images, there and back
  gelstereo live --scene scenes/grasp_cylinder.toml --frames 30 --show none --record out/live.mcap

With a camera: gelstereo live --camera /dev/video0 --rig rig.toml --record run.mcap
Nothing may touch the gel in the first frame. Ctrl-C ends the run and completes the recording.
"""

#: Tolerance of a scene's triangulated part.
_SHAPE_TOLERANCE_MM = 0.02
#: Mesh file formats that the host reads.
_HOST_MESHES = (".stl", ".obj")
#: Interval of status lines on the terminal, seconds.
_REPORT_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--camera", metavar="DEVICE", help="camera: /dev/video0, or serial: and its USB serial number"
    )
    source.add_argument("--scene", type=Path, metavar="FILE", help="simulated sensor: a scene file (TOML)")
    source.add_argument(
        "--folder", type=Path, help="images left/NAME.png and right/NAME.png, played there and back"
    )
    parser.add_argument(
        "--rig", type=Path, help="rig file; a scene has its own, a folder may have FOLDER/rig.toml"
    )
    parser.add_argument(
        "--rate-hz",
        type=float,
        default=DEFAULT_RATE_HZ,
        help="frames a second of a camera or folder (%(default)s)",
    )
    _add_camera(parser)
    add_params(parser)
    parser.add_argument(
        "--compliance",
        type=Path,
        metavar="FILE",
        help="compliance matrix of a narrow gel, written by gelstereo compliance, for forces",
    )
    part = parser.add_argument_group("pose of the part")
    part.add_argument(
        "--template",
        type=Path,
        metavar="MESH",
        help="mesh of the part, or a saved .template; a scene has its own",
    )
    part.add_argument("--units", choices=list(MM_PER_UNIT), help="unit of the mesh; STEP files say it")
    add_guess(parser)
    parser.add_argument("--record", type=Path, metavar="FILE", help="MCAP file to write while sensing")
    parser.add_argument(
        "--images",
        choices=["png", "raw"],
        default="png",
        help="how plain images are recorded; Motion JPEG of a camera is kept as it came (%(default)s)",
    )
    parser.add_argument(
        "--frames", type=count, metavar="N", help="end after so many frames; for ever if left out"
    )
    parser.add_argument(
        "--show",
        choices=["auto", "window", "web", "rerun", "none"],
        default="auto",
        help="viewer; auto is a window where possible, else a web page of this computer (%(default)s)",
    )
    parser.add_argument(
        "--port",
        type=int,
        default=DEFAULT_PORT,
        help="port of the web page, 0 for any free one (%(default)s)",
    )
    parser.add_argument(
        "--picture", type=Path, metavar="FILE", help="write the last picture at the end (.png, ...)"
    )
    parser.add_argument(
        "--rrd", type=Path, metavar="FILE", help="with --show rerun: write a file for Rerun instead"
    )


def _add_camera(parser: argparse.ArgumentParser) -> None:
    camera = parser.add_argument_group("camera", "what is left out is as gelstereo.cameras.open has it")
    camera.add_argument(
        "--right-camera", metavar="DEVICE", help="right camera, if each view has its own device"
    )
    camera.add_argument(
        "--layout", help="where both views stand in the frames of one device, as side_by_side"
    )
    camera.add_argument("--format", help="how the camera sends pixels, as mjpg")
    camera.add_argument(
        "--size-px",
        type=int,
        nargs=2,
        metavar=("W", "H"),
        help="size of the device's frames; from the rig if left out",
    )
    camera.add_argument("--exposure-us", type=float, help="exposure time, microseconds")
    camera.add_argument("--gain", type=int, help="gain in the camera's own unit")


def run(arguments: argparse.Namespace) -> int:
    """Sense, show and record until the end; return the exit code."""
    setup = _setup(arguments)
    matrix = None if arguments.compliance is None else Compliance.load(arguments.compliance)
    sensor = LiveSensor(setup.rig, params_of(arguments), setup.part, matrix)
    live = LiveRun(setup.source, sensor, arguments.frames)
    picture = LivePicture(setup.rig, setup.part, f"gelstereo live: {setup.source.name}")

    def draw(shown: Shown) -> Image:
        return picture.draw(shown.result, shown.reading, shown.recording)

    try:
        # Open the viewer first: if that fails, no file is left behind.
        with _viewer(arguments, setup, live, draw) as show:
            if arguments.record is not None:
                record = module_of("gelstereo live --record", "gelstereo.live.record")
                live.recorder = record.LiveRecorder(
                    arguments.record,
                    setup.rig,
                    sensor.params,
                    setup.shape,
                    compliance=arguments.compliance,
                    png=arguments.images == "png",
                    wall_clock=arguments.camera is not None,
                )
            with live:
                show()
            live.wait(0.0)
    except KeyboardInterrupt:
        # The usual end of a run; the recording is complete at this point.
        sys.stderr.write("\n")
    last = live.newest.newer_than(0, 0.0)
    if arguments.picture is not None and last is not None:
        write_image(arguments.picture, draw(last[1]))
    return _report(live, arguments.record)


@dataclass(frozen=True)
class _Setup:
    source: LiveSource
    rig: Rig
    part: ExpectedPart | None
    #: The part's shape, for the recording.
    shape: dict[str, Any] | None = None


def _setup(arguments: argparse.Namespace) -> _Setup:
    part, shape = _part(arguments)
    if arguments.scene is not None:
        if arguments.rig is not None:
            raise Error("a scene has its own rig; leave out --rig, or change the scene")
        scene = SceneSource(arguments.scene)
        if part is None:
            part, shape = _part_of(scene, arguments.scene.parent)
        return _Setup(scene, scene.rig, part, shape)
    if arguments.folder is not None:
        rig = Rig.load(arguments.rig or arguments.folder / "rig.toml")
        return _Setup(FolderSource(arguments.folder, arguments.rate_hz), rig, part, shape)
    if arguments.rig is None:
        raise Error("a camera needs its calibrated rig: add --rig rig.toml, written by `gelstereo calibrate`")
    rig = Rig.load(arguments.rig)
    camera = CameraSource(
        arguments.camera,
        right_device=arguments.right_camera,
        layout=arguments.layout,
        format=arguments.format,
        size_px=arguments.size_px or _device_size_px(rig, arguments),
        frame_rate_hz=arguments.rate_hz,
        exposure_us=arguments.exposure_us,
        gain=arguments.gain,
    )
    return _Setup(camera, rig, part, shape)


def _device_size_px(rig: Rig, arguments: argparse.Namespace) -> tuple[int, int]:
    """Frame size of a device whose views have the rig's size: side by side, the frames are twice as wide."""
    width, height = rig.size_px
    beside = arguments.right_camera is None and not (arguments.layout or "").startswith("interleaved")
    return (2 * width if beside else width), height


def _part(arguments: argparse.Namespace) -> tuple[ExpectedPart | None, dict[str, Any] | None]:
    """The requested part, and its shape if the host can read it from a recording."""
    path, shape = arguments.template, None
    if path is None:
        return None, None
    if path.suffix == ".template":
        template = Template.load(path)
    else:
        template = Template.from_mesh(path, units=arguments.units)
        if path.suffix.lower() in _HOST_MESHES and arguments.units is not None:
            shape = {"kind": "mesh", "path": str(path), "units": arguments.units}
    return ExpectedPart(template, guess_of(arguments)), shape


def _part_of(scene: SceneSource, folder: Path) -> tuple[ExpectedPart | None, dict[str, Any] | None]:
    """The scene's part, expected at its first pose in the scene; None without a part. `folder` is the
    scene's.
    """
    start = scene.simulator[0].t_sensor_object
    shape = scene.simulator.scene.to_dict().get("indenter")
    if shape is None or start is None:
        return None, None
    if shape["kind"] == "mesh":
        shape = {**shape, "path": str(folder / shape["path"])}
        template = Template.from_mesh(shape["path"], units=shape["units"])
    else:
        template = Template.from_triangles(*shape_mesh(shape, _SHAPE_TOLERANCE_MM))
    return ExpectedPart(template, start), shape


@contextmanager
def _viewer(
    arguments: argparse.Namespace, setup: _Setup, live: LiveRun, draw: Callable[[Shown], Image]
) -> Iterator[Callable[[], None]]:
    """Context of the requested viewer; yields a function that shows the run until it ends."""
    kind, problem = arguments.show, window_problem("use --show web")
    if kind == "auto":
        kind = "web" if problem else "window"
    if kind == "window":
        if problem is not None:
            raise Error(problem)
        yield lambda: show_window(live.newest, draw)
    elif kind == "web":
        with WebViewer(live.newest, draw, arguments.port) as web:
            print(f"picture    {web.url} (Ctrl-C ends)", flush=True)
            yield lambda: _wait(live)
    elif kind == "rerun":
        rerun = module_of("gelstereo live --show rerun", "gelstereo.live.rerun_viewer")
        with rerun.RerunViewer(arguments.rrd, setup.part) as viewer:
            yield lambda: viewer.follow(live.newest)
    else:
        yield lambda: _wait(live)


def _wait(live: LiveRun) -> None:
    """Wait for the end; on a terminal, print the figures every second."""
    while not live.wait(_REPORT_S):
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{_figures(live.reading)}\x1b[K")
            sys.stderr.flush()


def _figures(reading: Reading) -> str:
    latency = f"latency {reading.p50_ms:.1f} ms (p99 {reading.p99_ms:.1f})"
    counts = f"dropped {reading.dropped}, stale {reading.stale}, failed {reading.failed}"
    return f"{reading.frames} frames, {reading.rate_hz:.1f} Hz, {latency}, {counts}"


def _report(live: LiveRun, record: Path | None) -> int:
    """Print a summary of the run; return the exit code, 1 if its recording is not complete."""
    print(f"sensed     {_figures(live.reading)}")
    for event in live.reading.events:
        print(f"event      {event.after_s:.1f} s: {event.text}")
    if live.recording_error is not None:
        print(f"gelstereo: {record}: {live.recording_error}", file=sys.stderr)
        return 1
    if record is not None:
        print(f"recording  {record}")
    return 0
