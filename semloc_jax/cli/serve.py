"""`semloc serve`: a map over HTTP (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import OK


@dataclass(frozen=True)
class Options:
    """Serve a map, its differences and tiles, and take packed drives.

    GET /version, /map, /diff?have=V_OR_DIGEST (.sdiff), /tile?bbox=W,S,E,N&version=V (.smap, metres of the map).
    POST /drives takes a .slocal with 'Authorization: Bearer TOKEN', at most 256 kB; it waits for 'semloc merge
    MAP --inbox --out MAP'. At most 20 requests a second for each client, 64 connections at once. Ctrl-C ends it.
    """

    map: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MAP")]
    """The .gpkg file, with its history beside it; what a merge writes to it is served from then on."""
    token_file: Path | None = None
    """A file with the token that uploads must show; default: a new one, which is printed."""
    host: str = "127.0.0.1"
    """Where to listen. Anything but 127.0.0.1 lets other machines in, without encryption: put a proxy before it."""
    port: int = 8766
    """Port; 0 takes any that is free."""


def run(options: Options) -> int:
    """Serve until interrupted."""
    import secrets

    from semloc_jax.errors import SemlocError
    from semloc_jax.service.server import MapServer

    if options.token_file is not None and not options.token_file.is_file():
        raise SemlocError(f"--token-file {options.token_file}: no such file")
    given = options.token_file
    token = secrets.token_urlsafe(24) if given is None else given.read_text(encoding="utf-8", errors="replace").strip()
    with MapServer(options.map, token, options.host, options.port) as server:
        print(f"map: {server.url} (Ctrl-C ends it)", flush=True)
        if given is None:
            print(f"token of uploads: {token}", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print("closed")
    return OK
