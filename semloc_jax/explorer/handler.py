"""What is answered to each request, and what is refused (room: explorer; host).

In: HTTP requests. Out: files of the page, pictures, JSON, packed arrays; a sentence and a 4xx code for bad requests.
"""

import hmac
import json
import threading
import traceback
from http.server import BaseHTTPRequestHandler
from importlib.resources import files
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

from semloc_jax.errors import SemlocError
from semloc_jax.explorer.messages import packed, read_frame_index, read_query, to_json

MAX_BODY_BYTES = 16384
"""Larger than any question of the page by a factor of ten."""
_MOST_DIGITS = 20
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
}
_JSON, _PACKED, _JPEG = "application/json", "application/octet-stream", "image/jpeg"

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


class _Refused(Exception):
    """A request that is not answered: HTTP code and a sentence."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


class ExplorerHandler(BaseHTTPRequestHandler):
    """One connection of a browser."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "semloc", ""
    timeout = 60.0
    wbufsize = -1
    disable_nagle_algorithm = True  # else head and body wait for each other 40 ms

    def do_GET(self) -> None:
        """Page, pictures, progress, scene."""
        self._answer(self._get)

    def do_POST(self) -> None:
        """Questions about a pose, and other frames."""
        self._answer(self._post)

    def log_message(self, *_: object) -> None:
        """Nothing: dozens of requests a second."""

    def _answer(self, act: Any) -> None:
        try:
            self._check_sender()
            code, kind, body = 200, *act(self._own_path())
        except _Refused as refusal:
            code, kind, body = refusal.code, _JSON, to_json({"error": str(refusal)})
        except SemlocError as error:
            code, kind, body = 400, _JSON, to_json({"error": " ".join(str(error).split())})
        except (ConnectionError, TimeoutError):
            raise
        except Exception as error:
            traceback.print_exc()
            code, kind, body = 500, _JSON, to_json({"error": f"internal error: {type(error).__name__}: {error}"})
        if code != 200:
            self.close_connection = True  # what was not read of the request may not be taken for the next one
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("Referrer-Policy", "no-referrer")
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)
        self.wfile.flush()

    def _check_sender(self) -> None:
        """Refuse requests that came by another name of this machine (DNS rebinding) or from another web page."""
        own = [f"{name}:{self.server.server_port}" for name in ("127.0.0.1", "localhost")]
        if self.headers.get("Host") not in own:
            raise _Refused(403, f"host '{self.headers.get('Host', '')[:60]}'; expected http://{own[0]}/")
        origin = self.headers.get("Origin")
        if origin is not None and origin not in [f"http://{name}" for name in own]:
            raise _Refused(403, f"a page of {origin[:60]} may not ask; open http://{own[0]}/ itself")

    def _own_path(self) -> str:
        """The path behind the token, which only who has seen the address knows: other users of this machine do not."""
        _, given, rest = f"{unquote(urlsplit(self.path).path)}//".split("/", 2)
        if not hmac.compare_digest(given.encode(), self.server.token.encode()):
            raise _Refused(403, "the address lacks its token; open the address that semloc has printed")
        return "/" + rest.removesuffix("/").removesuffix("/")

    def _get(self, path: str) -> tuple[str, bytes]:
        if path == "/api/progress":
            return _JSON, to_json(self.server.progress.state)
        if path == "/api/scene":
            return _JSON, to_json(self.server.session.scene())
        if path.startswith("/api/picture/"):
            return _JPEG, self._picture(path.split("/")[3:])
        if path.startswith("/api/"):
            raise _Refused(404, f"nothing at {path[:60]}; GET knows /api/progress, /api/scene and /api/picture")
        return self._file(path.lstrip("/") or "index.html")

    def _post(self, path: str) -> tuple[str, bytes]:
        session = self.server.session
        content = self._content()
        if path not in ("/api/evaluate", "/api/frame"):
            raise _Refused(404, f"nothing at {path[:60]}; POST knows /api/evaluate and /api/frame")
        if not self.server.progress.state["ready"]:
            raise _Refused(503, "still compiling; ask /api/progress")
        if path == "/api/frame":
            session.open_frame(read_frame_index(content, len(session.drive)))
            return _JSON, to_json(session.scene())
        query = read_query(content, session.num_levels, session.channel_names)
        return _PACKED, packed(*session.answer(query))

    def _picture(self, words: list[str]) -> bytes:
        num_frames = len(self.server.session.drive)
        if len(words) != 3 or not words[0].isascii() or not words[0].isdigit() or int(words[0][:9]) >= num_frames:
            raise _Refused(
                404, f"no such picture; expected /api/picture/FRAME/KIND/CAMERA, frame 0 to {num_frames - 1}"
            )
        return self.server.session.picture(int(words[0]), words[1], words[2])

    def _file(self, name: str) -> tuple[str, bytes]:
        kind = _TYPES.get(PurePosixPath(name).suffix)
        found = files("semloc_jax.explorer") / "page" / name
        if kind is None or "/" in name or "\\" in name or not found.is_file():
            raise _Refused(404, f"no page {name[:60]}; open {self.server.url}")
        return kind, found.read_bytes()

    def _content(self) -> Any:
        """The JSON of a request."""
        if self.headers.get_content_type() != _JSON:
            raise _Refused(400, f"content type {self.headers.get_content_type()}; expected {_JSON}")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()):
            raise _Refused(400, "no Content-Length; expected the number of bytes of the JSON text")
        # One number is checked and read by: digits that were cut or padded would be two.
        num_bytes = int(length) if len(length) <= _MOST_DIGITS else MAX_BODY_BYTES + 1
        if num_bytes > MAX_BODY_BYTES:
            raise _Refused(413, f"{length[:_MOST_DIGITS]} bytes; expected at most {MAX_BODY_BYTES}")
        try:
            return json.loads(self.rfile.read(num_bytes))
        except (ValueError, RecursionError) as error:
            raise _Refused(400, f"the request is not JSON: {error}") from error
