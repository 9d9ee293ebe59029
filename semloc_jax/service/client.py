"""`semloc pull`: the newest version of a map that is served, by differences (room: service; host).

In: the address of a server, a map file. Out: the file in its newest version; where anything is wrong it stays.
"""

import json
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import quote, urlsplit

from semloc_jax.errors import SemlocError
from semloc_jax.maps.versions.difference import applied
from semloc_jax.maps.versions.history import write_version
from semloc_jax.maps.versions.sdiff import SdiffFile
from semloc_jax.maps.versions.state import MapState, read_state
from semloc_jax.storage import require_room, writing

_TIMEOUT_S = 30.0
_MOST_BYTES = 1 << 28


def pull(url: str, path: Path, have: int | None = None) -> tuple[MapState | None, MapState, int]:
    """Brings a map file to the newest version of a server.

    Args:
        url: address of `semloc serve`.
        path: the .gpkg file; one that is not there is fetched whole.
        have: number of the version that the file must hold; None takes what it holds.

    Returns:
        The version before (None where there was none), the version now, and the bytes that were fetched.

    Raises:
        SemlocError: the server cannot be reached or refuses, or what it sends does not belong on the file.
    """
    if urlsplit(url).scheme not in ("http", "https"):
        raise SemlocError(f"{url}: expected an address such as http://127.0.0.1:8766")
    if path.suffix.lower() != ".gpkg":
        raise SemlocError(f"{path}: versions are kept in GeoPackages; give a name that ends in .gpkg")
    if not path.is_file():
        if have is not None:
            raise SemlocError(f"{path}: no such file; leave --have out to fetch the whole map")
        content = _fetched(url, "/map")
        with writing(path) as partial:
            partial.write_bytes(content)
            state = read_state(partial)
        return None, state, len(content)
    before = read_state(path)
    if have is not None and have != before.version:
        raise SemlocError(
            f"{path}: holds version {before.version}, not {have}; leave --have out or give {before.version}"
        )
    content = _fetched(url, f"/diff?have={quote(before.digest)}", f"; another --out than {path} gets the whole map")
    state = applied(before, SdiffFile(content, f"difference of {url}").on(before))
    if state.digest != before.digest:
        write_version(state, path, before, path, f"pull of {urlsplit(url).hostname}")
    return before, state, len(content)


def _fetched(url: str, what: str, remedy: str = "") -> bytes:
    """What a server answers; no more than it may send. The remedy is named where it refuses."""
    address = url.rstrip("/") + what
    try:
        with urllib.request.urlopen(address, timeout=_TIMEOUT_S) as answer:
            content = answer.read(_MOST_BYTES + 1)
    except urllib.error.HTTPError as error:
        with error:
            said = error.read(1000)
        try:
            text = str(json.loads(said)["error"])
        except (ValueError, KeyError, TypeError):
            text = f"code {error.code}"
        raise SemlocError(f"{url}: refuses {what.split('?')[0]}: {text}{remedy}") from error
    except (OSError, ValueError) as error:
        raise SemlocError(f"{url}: cannot be reached ({str(error)[:100]}); is `semloc serve` running there?") from error
    require_room(len(content), _MOST_BYTES, url, "bytes", "get the map another way")
    return content
