"""Requests answered in one way: content with its length, or a code and a sentence (room: web; host).

In: what a server answers to a request. Out: AnsweringHandler, Refused.
"""

import json
import traceback
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler

from semloc_jax.errors import SemlocError

JSON, BINARY = "application/json", "application/octet-stream"
_MOST_DIGITS = 20
Answer = tuple[int, str, bytes]
"""Code, content type, content."""


class Refused(Exception):
    """A request that is not answered: HTTP code and a sentence."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


class AnsweringHandler(BaseHTTPRequestHandler):
    """One connection.

    Attributes:
        own_headers: sent with every answer.
    """

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "semloc", ""
    timeout = 20.0
    wbufsize = -1
    disable_nagle_algorithm = True  # else head and body wait for each other 40 ms
    own_headers: tuple[tuple[str, str], ...] = ()

    def log_message(self, *_: object) -> None:
        """Nothing: who asked for what is nobody's business."""

    def answer(self, act: Callable[[], Answer]) -> None:
        """Sends what `act` gives, or why it does not."""
        try:
            code, kind, body = act()
        except Refused as refusal:
            code, kind, body = refusal.code, JSON, _said(str(refusal))
        except SemlocError as error:
            code, kind, body = 400, JSON, _said(" ".join(str(error).split()))
        except (ConnectionError, TimeoutError):
            raise
        except Exception as error:  # what it says may hold paths of this machine: that is for its own console
            traceback.print_exc()
            code, kind, body = 500, JSON, _said(f"internal error: {type(error).__name__}")
        if code >= 400:
            self.close_connection = True  # what was not read of the request may not be taken for the next one
        self.send_response(code)
        headers = [("Content-Type", kind), ("Content-Length", str(len(body))), ("X-Content-Type-Options", "nosniff")]
        for name, value in (*headers, *self.own_headers):
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)
        self.wfile.flush()

    def content(self, most_bytes: int) -> bytes:
        """The body of a request.

        Raises:
            Refused: no length, or more than that.
        """
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()):
            raise Refused(411, "no Content-Length; expected the number of bytes")
        # One number is checked and read by: digits that were cut or padded would be two.
        num_bytes = int(length) if len(length) <= _MOST_DIGITS else most_bytes + 1
        if num_bytes > most_bytes:
            raise Refused(413, f"{length[:_MOST_DIGITS]} bytes; expected at most {most_bytes}")
        return self.rfile.read(num_bytes)


def _said(text: str) -> bytes:
    return json.dumps({"error": text}).encode()
