"""What is answered to each request, and what is refused (room: explorer; host).

In: HTTP requests. Out: files of the page, pictures, JSON, packed arrays; a sentence and a 4xx code for bad requests.
"""

import hmac
import json
import threading
from collections.abc import Callable
from importlib.resources import files
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

from semloc_jax.explorer.messages import packed, read_frame_index, read_query, to_json
from semloc_jax.web.answering import BINARY, JSON, Answer, AnsweringHandler, Refused

MAX_BODY_BYTES = 16384
"""Larger than any question of the page by a factor of ten."""
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
}
_JPEG = "image/jpeg"

_POLICY = "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'"


class Progress:
    """How far compilation has come, for the page; threads may read it while another writes."""

    def __init__(self) -> None:
        self._lock, self._stopped = threading.Lock(), False
        self._state: dict[str, Any] = {"text": "starting", "done": 0, "of": 1, "ready": False, "error": None}

    @property
    def state(self) -> dict[str, Any]:
        """What is under way, how much is done, whether all is, and what went wrong."""
        with self._lock:
            return dict(self._state)

    def report(self, text: str, done: int, of: int) -> None:
        """Note the next part.

        Raises:
            InterruptedError: the client no longer waits for the answer.
        """
        with self._lock:
            if self._stopped:
                raise InterruptedError
            self._state.update(text=text, done=done, of=of, ready=done == of)

    def fail(self, text: str) -> None:
        """Note that it cannot be finished."""
        with self._lock:
            self._state["error"] = text

    def stop(self) -> None:
        """Let the next `report` raise."""
        with self._lock:
            self._stopped = True


class ExplorerHandler(AnsweringHandler):
    """One connection of a browser."""

    timeout = 60.0
    own_headers = (
        ("Cache-Control", "no-store"),
        ("Content-Security-Policy", _POLICY),
        ("Referrer-Policy", "no-referrer"),
    )

    def do_GET(self) -> None:
        """Page, pictures, progress, scene."""
        self.answer(lambda: self._checked(self._get))

    def do_POST(self) -> None:
        """Questions about a pose, and other frames."""
        self.answer(lambda: self._checked(self._post))

    def _checked(self, act: Callable[[str], tuple[str, bytes]]) -> Answer:
        self._check_sender()
        return 200, *act(self._own_path())

    def _check_sender(self) -> None:
        """Refuse requests that came by another name of this machine (DNS rebinding) or from another web page."""
        own = [f"{name}:{self.server.server_port}" for name in ("127.0.0.1", "localhost")]
        if self.headers.get("Host") not in own:
            raise Refused(403, f"host '{self.headers.get('Host', '')[:60]}'; expected http://{own[0]}/")
        origin = self.headers.get("Origin")
        if origin is not None and origin not in [f"http://{name}" for name in own]:
            raise Refused(403, f"a page of {origin[:60]} may not ask; open http://{own[0]}/ itself")

    def _own_path(self) -> str:
        """The path behind the token, which only who has seen the address knows: other users of this machine do not."""
        _, given, rest = f"{unquote(urlsplit(self.path).path)}//".split("/", 2)
        if not hmac.compare_digest(given.encode(), self.server.token.encode()):
            raise Refused(403, "the address lacks its token; open the address that semloc has printed")
        return "/" + rest.removesuffix("/").removesuffix("/")

    def _get(self, path: str) -> tuple[str, bytes]:
        if path == "/api/progress":
            return JSON, to_json(self.server.progress.state)
        if path == "/api/scene":
            return JSON, to_json(self.server.session.scene())
        if path.startswith("/api/picture/"):
            return _JPEG, self._picture(path.split("/")[3:])
        if path.startswith("/api/"):
            raise Refused(404, f"nothing at {path[:60]}; GET knows /api/progress, /api/scene and /api/picture")
        return self._file(path.lstrip("/") or "index.html")

    def _post(self, path: str) -> tuple[str, bytes]:
        session = self.server.session
        content = self._question()
        if path not in ("/api/evaluate", "/api/frame"):
            raise Refused(404, f"nothing at {path[:60]}; POST knows /api/evaluate and /api/frame")
        if not self.server.progress.state["ready"]:
            raise Refused(503, "still compiling; ask /api/progress")
        if path == "/api/frame":
            session.open_frame(read_frame_index(content, len(session.drive)))
            return JSON, to_json(session.scene())
        query = read_query(content, session.num_levels, session.channel_names)
        return BINARY, packed(*session.answer(query))

    def _picture(self, words: list[str]) -> bytes:
        num_frames = len(self.server.session.drive)
        if len(words) != 3 or not words[0].isascii() or not words[0].isdigit() or int(words[0][:9]) >= num_frames:
            raise Refused(404, f"no such picture; expected /api/picture/FRAME/KIND/CAMERA, frame 0 to {num_frames - 1}")
        return self.server.session.picture(int(words[0]), words[1], words[2])

    def _file(self, name: str) -> tuple[str, bytes]:
        kind = _TYPES.get(PurePosixPath(name).suffix)
        found = files("semloc_jax.explorer") / "page" / name
        if kind is None or "/" in name or "\\" in name or not found.is_file():
            raise Refused(404, f"no page {name[:60]}; open {self.server.url}")
        return kind, found.read_bytes()

    def _question(self) -> Any:
        """The JSON of a request."""
        if self.headers.get_content_type() != JSON:
            raise Refused(400, f"content type {self.headers.get_content_type()}; expected {JSON}")
        content = self.content(MAX_BODY_BYTES)
        try:
            return json.loads(content)
        except (ValueError, RecursionError) as error:
            raise Refused(400, f"the request is not JSON: {error}") from error
