"""Output of moments to Rerun: its viewer, or a file.

Needs the extra ``rerun``: ``pip install gelstereo[rerun]``. Rerun's viewer is started by its own command,
because the SDK would make it listen on every network interface.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import Error
from gelstereo.extras import needs
from gelstereo.states import MarkerState
from gelstereo.view.canvas import SALIENT
from gelstereo.view.picture import STATE_COLOURS, indentation_colours

with needs(__name__):
    import rerun

Floats = npt.NDArray[np.float64]

_HOST, _PORT = "127.0.0.1", 9876
#: Time limit for the viewer's start.
_START_S = 30.0


class RerunStream:
    """A stream to Rerun's viewer, or to a file for it; a context manager.

    Parameters
    ----------
    name
        Name of the program, shown by Rerun.
    file
        An .rrd file to write. Without a file, Rerun's viewer is started, which needs a display.
    instead
        Alternative where there is no display, for the error message.
    """

    def __init__(self, name: str, file: Path | None, instead: str) -> None:
        self._file = file
        self._instead = instead
        self._viewer: subprocess.Popen[bytes] | None = None
        self.stream: Any = rerun.RecordingStream(name)

    def __enter__(self) -> RerunStream:
        if self._file is not None:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            self.stream.save(str(self._file))
        else:
            self._start_viewer()
        self.stream.log("sensor", rerun.ViewCoordinates.RDF, static=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # The viewer stays open until the user closes it. A closed viewer accepts no data, so nothing is
        # flushed to it.
        if self._viewer is None or self._viewer.poll() is None:
            self.stream.flush()
            self.stream.disconnect()

    def _start_viewer(self) -> None:
        if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise Error(f"there is no display for Rerun's viewer; {self._instead}")
        command = [sys.executable, "-m", "rerun", "--bind", _HOST, "--port", str(_PORT), "--expect-data-soon"]
        self._viewer = subprocess.Popen(command, start_new_session=True)
        deadline_s = time.monotonic() + _START_S
        while not _listens():
            self.has_ended()
            if time.monotonic() > deadline_s:
                raise Error(f"Rerun's viewer does not listen on port {_PORT} after {_START_S:g} s")
            time.sleep(0.1)
        self.stream.connect_grpc(f"rerun+http://{_HOST}:{_PORT}/proxy")

    def has_ended(self) -> bool:
        """Whether the user closed the viewer; a viewer that failed raises an error."""
        code = None if self._viewer is None else self._viewer.poll()
        if code:
            raise Error(
                f"Rerun's viewer ended with code {code}; see its messages. Writing to a file needs no viewer"
            )
        return code == 0

    def log_markers(
        self,
        left_px: Floats,
        reference_px: Floats,
        state: npt.NDArray[np.uint8],
        salient: npt.NDArray[np.bool_],
    ) -> None:
        """Log markers over the left image, in the colours of the pictures, with their motion."""
        by_state = np.array([STATE_COLOURS[state][::-1] for state in MarkerState], dtype=np.uint8)
        colours = by_state[state]
        colours[salient] = SALIENT[::-1]
        # Rerun's origin is the image's corner, not the centre of its first pixel.
        now, rest = left_px + 0.5, reference_px + 0.5
        self.stream.log("image/left/markers", rerun.Points2D(now, colors=colours, radii=3.0))
        moved = rerun.LineStrips2D(np.stack([rest, now], axis=1), colors=[255, 255, 255], radii=0.7)
        self.stream.log("image/left/motion", moved)

    def log_gel(self, points_mm: Floats, indentation_mm: Floats) -> None:
        """Log the gel's surface in the colours of its indentation."""
        heights, _ = indentation_colours(indentation_mm)
        gel = rerun.Points3D(points_mm, colors=heights[:, ::-1], radii=0.15)
        self.stream.log("sensor/gel", gel)
        deepest_mm = float(np.max(indentation_mm, initial=0.0))
        self.stream.log("contact/max_indentation_mm", rerun.Scalars(deepest_mm))


def _listens() -> bool:
    with contextlib.suppress(OSError), socket.create_connection((_HOST, _PORT), timeout=1.0):
        return True
    return False
