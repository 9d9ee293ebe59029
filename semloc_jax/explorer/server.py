"""The page and its numbers over HTTP, for this machine alone (room: explorer; host).

In: ExplorerSession. Out: ExplorerServer: page, pictures, JSON and packed arrays at http://127.0.0.1:PORT/TOKEN/.
Only programs on this machine can connect, of web pages only our own (Host and Origin of every request are checked), and
of users only those that know the address, which holds a token.
"""

import errno
import os
import secrets
import sys
import threading
import webbrowser
from collections.abc import Callable
from http.server import ThreadingHTTPServer
from socketserver import TCPServer

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.alignment.pose_prior import PriorSource
from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.explorer.handler import ExplorerHandler, Progress
from semloc_jax.explorer.session import ExplorerSession
from semloc_jax.inputs.mask_source import MaskSource, mask_source
from semloc_jax.inputs.priors import prior_source
from semloc_jax.maps import SemanticMap

HOST, PORT = "127.0.0.1", 8765


class ExplorerServer(ThreadingHTTPServer):
    """Serves one session in the background from `start` to `close`; a context manager does both."""

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = os.name != "nt"  # where it would let two servers have one port

    def __init__(self, session: ExplorerSession, port: int = PORT) -> None:
        """Take the port; 0 takes any that is free.

        Raises:
            SemlocError: the port is in use, forbidden, or none at all.
        """
        self.session, self.progress = session, Progress()
        self.token = secrets.token_urlsafe(18)
        self._workers: list[threading.Thread] = []
        if not 0 <= port <= 65535:
            raise SemlocError(f"port {port}: expected a number from 0 (any free one) to 65535")
        try:
            super().__init__((HOST, port), ExplorerHandler)
        except OSError as error:
            why = "in use by another program" if error.errno == errno.EADDRINUSE else error.strerror
            raise SemlocError(
                f"port {port} of this machine: {why}; give another --port, or 0 for any free one"
            ) from error

    def server_activate(self) -> None:
        """Listen with room for a browser that opens many connections at once."""
        self.request_queue_size = 32
        super().server_activate()

    def server_bind(self) -> None:
        """Bind without looking up the name of the machine, which may take seconds."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = HOST, self.server_address[1]

    @property
    def url(self) -> str:
        """Address of the page; who knows it may look."""
        return f"http://{HOST}:{self.server_port}/{self.token}/"

    def start(self) -> "ExplorerServer":
        """Answer requests and compile, both in the background."""
        self._workers = [threading.Thread(target=target, daemon=True) for target in (self.serve_forever, self._warm_up)]
        for thread in self._workers:
            thread.start()
        return self

    def close(self) -> None:
        """Stop answering, give the port back, and let a compilation under way come to its end."""
        self.progress.stop()
        if self._workers:
            self.shutdown()
        self.server_close()
        for thread in self._workers:
            thread.join()

    def wait(self) -> None:
        """Return when the server was closed by another thread; an interrupt passes through."""
        while self._workers and self._workers[0].is_alive():
            self._workers[0].join(timeout=0.5)

    def __enter__(self) -> "ExplorerServer":
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def handle_error(self, request: object, client_address: object) -> None:
        """Nothing for a browser that has gone away; else the traceback of the standard library."""
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)

    def _warm_up(self) -> None:
        try:
            self.session.warm_up(self.progress.report)
        except InterruptedError:
            pass
        except Exception as error:  # shown on the page; nothing else waits for this thread
            self.progress.fail(f"{type(error).__name__}: {' '.join(str(error).split())}")


def serve(
    drive: Drive,
    semantic_map: SemanticMap,
    masks: MaskSource | str,
    prior: PriorSource | str = "gnss",
    frame: int = 0,
    config: LocalizeConfig | None = None,
    level: int = 1,
    around: str = "truth",
    port: int = PORT,
    open_browser: bool = True,
    announce: Callable[[str], None] = print,
) -> None:
    """Serve the explorer of one frame until it is interrupted (Ctrl-C).

    Args:
        drive: The drive.
        semantic_map: The map.
        masks: A MaskSource, or the name of masks of the drive.
        prior: A PriorSource, `gnss`, `truth` or a trajectory file.
        frame: Index of the frame at first.
        config: None for the defaults.
        level: Level of the cost maps at first.
        around: `truth` or `prior`: where the vehicle stands at first.
        port: Port on this machine; 0 takes any free one.
        open_browser: Whether to show the page in the browser of this machine.
        announce: Called with the address, and at the end.

    Raises:
        SemlocError: the frame cannot be read, or the port cannot be had.
    """
    source = mask_source(masks, drive) if isinstance(masks, str) else masks
    give_prior = prior_source(prior, drive) if isinstance(prior, str) else prior
    localizer = FrameLocalizer(semantic_map, source.table, config)
    session = ExplorerSession(drive, localizer, source, give_prior, frame, level, around)
    with ExplorerServer(session, port) as server:
        announce(f"explorer: {server.url} (Ctrl-C ends it)")
        if open_browser and _has_screen():
            webbrowser.open(server.url)
        try:
            server.wait()
        except KeyboardInterrupt:
            announce("explorer: closed")


def _has_screen() -> bool:
    """Whether a browser would open a window; without one, some open in the terminal and block it."""
    return sys.platform in ("darwin", "win32") or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
