"""The live picture as a local web page: an MJPEG stream and a status in JSON.

The server listens only on the loopback interface. Pictures are drawn on request, and every browser gets the
newest one. A slow browser misses pictures but delays nothing.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from gelstereo import Error
from gelstereo.extras import needs
from gelstereo.live.latest import Latest
from gelstereo.live.shown import Shown
from gelstereo.view.canvas import Image

HOST = "127.0.0.1"
DEFAULT_PORT = 8770

#: Pictures per second for each browser. More would take processor time from sensing without visible benefit.
_MAX_RATE_HZ = 15.0
_JPEG_QUALITY = 85
#: Timeout of a browser that reads nothing, and longest wait for a new picture, seconds.
_GIVE_UP_S, _WAIT_S = 10.0, 1.0
_BOUNDARY = "gelstereo-picture"
#: Accepted host names in requests. Any other name indicates DNS rebinding by a foreign page.
_OWN_NAMES = {"127.0.0.1", "localhost"}


class WebViewer:
    """Serves pictures of the newest moment; a context manager."""

    def __init__(
        self, newest: Latest[Shown], draw: Callable[[Shown], Image], port: int = DEFAULT_PORT
    ) -> None:
        self._newest = newest
        self._draw = draw
        self._drawing = threading.Lock()
        self._drawn: tuple[int, bytes] = (0, b"")
        try:
            self._server = _Server((HOST, port), self)
        except OSError as error:
            raise Error(
                f"port {port} of {HOST} cannot be used ({error.strerror}); name another one, or 0 for any "
                "free one"
            ) from error
        self._thread = threading.Thread(target=self._server.serve_forever, name="web", daemon=True)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self._server.server_address[1]}/"

    def __enter__(self) -> WebViewer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def picture(self, after: int) -> tuple[int, bytes] | None:
        """Wait for a picture numbered above `after`; return it as JPEG with its number, or None after a
        timeout.
        """
        found = self._newest.newer_than(after, _WAIT_S)
        if found is None:
            return None
        number, shown = found
        with self._drawing:
            # Several browsers share one picture.
            if self._drawn[0] < number:
                self._drawn = (number, _jpeg(self._draw(shown)))
            return self._drawn

    def status(self) -> dict[str, Any]:
        """The newest moment without its images; empty before the first one."""
        found = self._newest.newer_than(0, 0.0)
        return {} if found is None else found[1].as_json()

    @property
    def ended(self) -> bool:
        """Whether the run has ended."""
        return self._newest.closed


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    # A hanging browser must not block the end of the run.
    block_on_close = False

    def __init__(self, address: tuple[str, int], viewer: WebViewer) -> None:
        self.viewer = viewer
        super().__init__(address, _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors of browsers that disconnect in the middle of a picture."""


class _Handler(BaseHTTPRequestHandler):
    timeout = _GIVE_UP_S
    server: _Server

    def do_GET(self) -> None:
        """Serve the page, its stream, one picture or the status."""
        name = self.headers.get("Host", "")
        if (name.rpartition(":")[0] or name) not in _OWN_NAMES:
            self.send_error(403, f"This page is served under http://{HOST} alone")
            return
        answers = {
            "/": self._page,
            "/stream.mjpg": self._stream,
            "/picture.jpg": self._picture,
            "/status.json": self._status,
        }
        answer = answers.get(self.path.partition("?")[0])
        if answer is None:
            self.send_error(404, f"Nothing is there; valid is {', '.join(answers)}")
            return
        answer()

    def _page(self) -> None:
        self._send("text/html; charset=utf-8", (files("gelstereo.live") / "page.html").read_bytes())

    def _status(self) -> None:
        self._send("application/json", json.dumps(self.server.viewer.status()).encode())

    def _picture(self) -> None:
        found = self.server.viewer.picture(0)
        if found is None:
            self.send_error(503, "There is no picture yet; try again")
            return
        self._send("image/jpeg", found[1])

    def _stream(self) -> None:
        self._start(f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
        viewer, number = self.server.viewer, 0
        while not viewer.ended:
            started_s = time.monotonic()
            found = viewer.picture(number)
            if found is None:
                continue
            number, jpeg = found
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            self.wfile.write(head.encode() + jpeg + b"\r\n")
            time.sleep(max(0.0, started_s + 1.0 / _MAX_RATE_HZ - time.monotonic()))
        self.wfile.write(f"--{_BOUNDARY}--\r\n".encode())

    def _send(self, kind: str, body: bytes) -> None:
        self._start(kind, len(body))
        self.wfile.write(body)

    def _start(self, kind: str, length: int | None = None) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        if length is None:
            self.send_header("Connection", "close")
        else:
            self.send_header("Content-Length", str(length))
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Do not print requests: the page makes two every second."""


def _jpeg(picture: Image) -> bytes:
    with needs(__name__):
        import cv2

    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not done:
        raise Error("the picture cannot be encoded as JPEG")
    return bytes(data)
