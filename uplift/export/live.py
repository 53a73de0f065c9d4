"""Poses as they come, on a page that this machine shows to itself: a server of server-sent events on 127.0.0.1."""

from __future__ import annotations

import base64
import io
import json
import threading
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from uplift.config.files import as_bytes
from uplift.errors import UserError
from uplift.export.html import scripted_page
from uplift.export.scene import bone_sides
from uplift.models.live import LivePose
from uplift.skeleton import Skeleton
from uplift.skeleton.core import joint_sides

__all__ = ["LivePage"]

_HOST = "127.0.0.1"
_WIDE, _QUALITY = 480, 60
"""Of the pictures that are sent, px and JPEG quality."""
_WAIT_S = 5.0


class LivePage:
    """A page at `address` that shows what `show` was given last; a context manager.

    It listens to this machine alone, and answers no page of another site (a request must name it by its own address).
    Raises UserError where no port is free, or ``port`` is taken.
    """

    def __init__(self, title: str, skeleton: Skeleton, notes: Sequence[str] = (), port: int = 0):
        self._page = _page(title, skeleton, notes)
        self._message, self._number, self._ended = "", 0, False
        self._news = threading.Condition()
        try:
            self._server = ThreadingHTTPServer((_HOST, port), _handler(self))
        except OSError as error:
            raise UserError(f"live: no page can be shown at {_HOST}:{port} ({error.strerror}).") from None
        self._server.daemon_threads = True
        self.address = f"http://{_HOST}:{self._server.server_address[1]}/"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def show(self, frame: int, image: UInt8[np.ndarray, "height width 3"], people: Sequence[LivePose]) -> None:
        """Send a frame and its people to whoever looks."""
        message = json.dumps(
            {
                "frame": frame,
                "size": [image.shape[1], image.shape[0]],
                "jpeg": _jpeg(image),
                "people": [_person(one, image) for one in people],
            },
            allow_nan=False,
        )
        with self._news:
            self._message, self._number = message, self._number + 1
            self._news.notify_all()

    def after(self, number: int) -> tuple[int, str | None]:
        """Return the number and text of the newest message once it is newer than ``number``; None where all has ended."""
        with self._news:
            self._news.wait_for(lambda: self._number > number or self._ended, timeout=_WAIT_S)
            return self._number, None if self._ended and self._number <= number else self._message

    @property
    def page(self) -> bytes:
        """The page's file."""
        return self._page

    def __enter__(self) -> LivePage:
        return self

    def __exit__(self, *error: object) -> None:
        with self._news:
            self._ended = True
            self._news.notify_all()
        self._server.shutdown()
        self._server.server_close()


def _page(title: str, skeleton: Skeleton, notes: Sequence[str]) -> bytes:
    sides = joint_sides(skeleton, skeleton.joints)
    bones = skeleton.bone_indices.tolist()
    data = {"bones": bones, "boneSides": bone_sides(sides, bones)}
    text = scripted_page(
        "live.htm",
        title=title,
        facts=[skeleton.name, "live"],
        styles=["page.css"],
        notes=notes,
        data=data,
        scripts=("live",),
        sections=(),
        curves=None,
        things="poses",
        connect="connect-src 'self'; ",
    )
    return as_bytes(text)


def _jpeg(image: UInt8[np.ndarray, "height width 3"]) -> str:
    picture = Image.fromarray(image)
    picture = picture.reduce(max(1, picture.width // _WIDE))
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=_QUALITY)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _person(one: LivePose, image: np.ndarray) -> dict[str, Any]:
    """Return someone as the page draws it: poses in px from the middle of the image, where the keypoints are."""
    seen = one.confidence > 0
    middle = one.keypoints[seen].mean(0) - [image.shape[1] / 2, image.shape[0] / 2]
    pose = (one.pose - one.pose[seen].mean(0)) * one.size_px + [*middle, 0.0]
    points = [np.round(point, 1).tolist() if there else None for point, there in zip(one.keypoints, seen, strict=True)]
    return {"number": one.number, "keypoints": points, "pose": np.round(pose, 1).tolist()}


def _handler(live: LivePage) -> type[BaseHTTPRequestHandler]:
    """Return what answers requests: the page, and the stream of what it shows."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            host, _, _ = self.headers.get("Host", "").partition(":")
            if host not in (_HOST, "localhost"):  # another site's name that was pointed at this machine
                self.send_error(403)
            elif self.path == "/":
                self._begin("text/html; charset=utf-8")
                self.wfile.write(live.page)
            elif self.path == "/stream":
                self._begin("text/event-stream")
                self._stream()
            else:
                self.send_error(404)

        def _begin(self, kind: str) -> None:
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Cache-Control", "no-store")
            self.end_headers()

        def _stream(self) -> None:
            number = 0
            try:
                while True:
                    before, (number, message) = number, live.after(number)
                    if message is None:
                        self.wfile.write(b"event: end\ndata:\n\n")
                        return
                    text = f"data: {message}\n\n" if number > before else ": still there\n\n"
                    self.wfile.write(text.encode("ascii"))
                    self.wfile.flush()
            except OSError:  # nobody looks any more
                return

        def log_message(self, format: str, *arguments: object) -> None:
            """Say nothing of requests."""

    return Handler
