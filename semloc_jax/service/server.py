"""`semloc serve`: a map and its differences over HTTP, uploads of drives with a token (room: service; host).

In: a map file with its history, requests. Out: MapServer. Only what is asked for by name is answered; every number and
every upload is checked, sizes and rates have limits. Uploads wait in MAP.history/inbox for `semloc merge --inbox`.
"""

import errno
import hashlib
import hmac
import json
import threading
import time
from collections.abc import Callable
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.mapping.crowd.ledger import inbox_of
from semloc_jax.maps.io.compact import compact_bytes
from semloc_jax.maps.io.packed_drive import unpacked
from semloc_jax.maps.versions.difference import difference
from semloc_jax.maps.versions.history import VersionRow, version_at, versions_of
from semloc_jax.maps.versions.sdiff import sdiff_bytes
from semloc_jax.maps.versions.state import MapState, read_state
from semloc_jax.storage import write_bytes
from semloc_jax.web.answering import BINARY, JSON, Answer, AnsweringHandler, Refused

MOST_UPLOAD_BYTES = 256_000
"""A drive of 25 km at 10 kB/km."""
_MOST_INBOX = 10_000
_MOST_SIDE_M = 4096.0
_MOST_FIELDS, _MOST_CONNECTIONS, _MOST_HELD = 4, 64, 32
"""Parameters of a question, connections at once, versions and steps that are remembered."""
_RATE_PER_S, _BURST, _MOST_CLIENTS = 20.0, 60.0, 10_000


class MapServer(ThreadingHTTPServer):
    """Serves one map file; what a merge writes to the file is served from then on."""

    daemon_threads = True

    def __init__(self, path: Path, token: str, host: str = "127.0.0.1", port: int = 8766) -> None:
        """Takes the port; 0 takes any that is free.

        Args:
            path: the map, with its history beside it.
            token: what an upload must show.
            host: where to listen; 127.0.0.1: this machine alone.
            port: where to listen.

        Raises:
            SemlocError: no map, a token that can be guessed, or the port cannot be had.
        """
        if len(token) < 16:
            raise SemlocError(f"token of {len(token)} characters; expected 16 or more")
        self.path, self.token = path, token
        self._lock, self._state, self._stamp = threading.Lock(), read_state(path), _stamp(path)
        self._left: dict[str, tuple[float, float]] = {}
        self._connections = threading.Semaphore(_MOST_CONNECTIONS)
        self._history_lock, self._held, self._rows = threading.Lock(), dict[str, Any](), list[VersionRow]()
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            why = "in use" if getattr(error, "errno", 0) == errno.EADDRINUSE else str(error)
            raise SemlocError(f"{host}:{port}: {why}; give another --host or --port") from error

    @property
    def url(self) -> str:
        """Address of the map."""
        return f"http://{self.server_address[0]}:{self.server_address[1]}"

    def state(self) -> MapState:
        """The newest version of the file."""
        with self._lock:
            stamp = _stamp(self.path)
            if stamp != self._stamp:
                self._state, self._stamp = read_state(self.path), stamp
            return self._state

    def at(self, name: str | None) -> MapState:
        """The version of a number or a digest; None for the newest."""
        newest = self.state()
        if name is None or name == newest.digest:
            return newest
        with self._history_lock:
            if self._held.get("newest") != newest.digest:
                self._held, self._rows = {"newest": newest.digest}, versions_of(self.path)
            row = next((row for row in self._rows if name in (str(row.version), row.digest)), None)
            if row is None:
                raise Refused(404, f"version {name[:12]} is not in the history of this map; get /map")
            return self._remembered(f"version {row.version}", lambda: version_at(self.path, row.version))

    def step_from(self, name: str) -> bytes:
        """The difference from a version to the newest; the same cars ask for the same step."""
        base, newest = self.at(name), self.state()
        with self._history_lock:
            key = f"step {base.digest} {newest.digest}"
            return self._remembered(key, lambda: sdiff_bytes(difference(base, newest, "pull"), base))

    def _remembered(self, key: str, make: Callable[[], Any]) -> Any:
        if key not in self._held:
            if len(self._held) >= _MOST_HELD:
                del self._held[next(k for k in self._held if k != "newest")]
            self._held[key] = make()
        return self._held[key]

    def verify_request(self, *_: object) -> bool:
        """Whether there is room for one more connection."""
        return self._connections.acquire(blocking=False)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answers one connection, and makes room for the next."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._connections.release()

    def take_turn(self, client: str) -> None:
        """Refuses a client that asks more often than it may."""
        now = time.monotonic()
        with self._lock:
            left, then = self._left.get(client, (_BURST, now))
            left = min(_BURST, left + (now - then) * _RATE_PER_S)
            if len(self._left) >= _MOST_CLIENTS:
                self._left.clear()
            self._left[client] = (max(left - 1.0, 0.0), now)
        if left < 1.0:
            raise Refused(429, f"more than {_RATE_PER_S:.0f} requests a second; wait")

    def keep(self, content: bytes) -> str:
        """Checks an upload and keeps it for the next merge; its hash."""
        drive = unpacked(content, "upload")
        digest = hashlib.sha256(content).hexdigest()
        inbox = inbox_of(self.path)
        inbox.mkdir(parents=True, exist_ok=True)
        with self._lock:
            if not (inbox / f"{digest}.slocal").is_file():
                if sum(1 for _ in inbox.iterdir()) >= _MOST_INBOX:
                    raise Refused(507, f"{_MOST_INBOX} drives wait for a merge; try later")
                write_bytes(inbox / f"{digest}.slocal", content)
        return json.dumps({"drive": digest, "elements": len(drive.beliefs.beliefs)})


def _stamp(path: Path) -> tuple[int, int, int]:
    found = path.stat()
    return found.st_mtime_ns, found.st_size, found.st_ino


class _Handler(AnsweringHandler):
    """One connection."""

    server: MapServer

    def do_GET(self) -> None:
        """Version, map, tile, difference."""
        self.answer(lambda: self._in_turn(self._get))

    def do_POST(self) -> None:
        """A packed drive."""
        self.answer(lambda: self._in_turn(self._post))

    def _in_turn(self, act: Callable[[], Answer]) -> Answer:
        self.server.take_turn(str(self.client_address[0]))
        return act()

    def _get(self) -> tuple[int, str, bytes]:
        split = urlsplit(self.path)
        try:
            asked = dict(parse_qsl(split.query, max_num_fields=_MOST_FIELDS))
        except ValueError as error:
            raise Refused(400, f"more than {_MOST_FIELDS} parameters") from error
        if split.path == "/version" and not asked:
            return 200, JSON, json.dumps(_summary(self.server.state())).encode()
        if split.path == "/map" and not asked:
            return 200, BINARY, self.server.path.read_bytes()
        if split.path == "/tile" and set(asked) <= {"bbox", "version"} and "bbox" in asked:
            return 200, BINARY, _tile(self.server.at(asked.get("version")), asked["bbox"])
        if split.path == "/diff" and set(asked) == {"have"}:
            return 200, BINARY, self.server.step_from(asked["have"])
        raise Refused(404, "GET knows /version, /map, /tile?bbox=W,S,E,N[&version=V], /diff?have=V_OR_DIGEST")

    def _post(self) -> tuple[int, str, bytes]:
        if urlsplit(self.path).path != "/drives":
            raise Refused(404, "POST knows /drives")
        shown = self.headers.get("Authorization", "").encode("utf-8", "replace")
        if not hmac.compare_digest(shown, f"Bearer {self.server.token}".encode()):
            raise Refused(401, "no valid token; expected the header Authorization: Bearer TOKEN")
        return 202, JSON, self.server.keep(self.content(MOST_UPLOAD_BYTES)).encode()


def _summary(state: MapState) -> dict[str, Any]:
    tiles = {f"{x},{y}": digest for (x, y), digest in state.tiles.items()}
    return {"version": state.version, "digest": state.digest, "content": state.content, "tiles": tiles}


def _tile(state: MapState, text: str) -> bytes:
    """What lies in a box [m], in the compact form."""
    words = text.split(",")
    try:
        west, south, east, north = (float(word) for word in words)
    except ValueError as error:
        raise Refused(400, f"bbox {text[:60]!r}; expected W,S,E,N in metres of the map") from error
    box = np.array([west, south, east, north])
    if not np.isfinite(box).all() or not 0.0 < east - west <= _MOST_SIDE_M or not 0.0 < north - south <= _MOST_SIDE_M:
        raise Refused(400, f"bbox {text[:60]!r}; expected W < E and S < N, at most {_MOST_SIDE_M:.0f} m apart")
    inside = [
        e
        for e in state.map.elements
        if (e.points[:, :2].max(axis=0) >= box[:2]).all() and (e.points[:, :2].min(axis=0) <= box[2:]).all()
    ]
    if not inside:
        raise Refused(404, "nothing lies in that box")
    return compact_bytes(state.map.with_elements(inside))
