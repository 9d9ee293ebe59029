"""How much a file may ask for (room: ground; host).

In: compressed bytes, JSON text, numbers of rows that a file asks for. Out: the content, or a sentence before memory is
taken.
"""

import json
import zlib
from typing import Any

from semloc_jax.errors import SemlocError

MOST_UNPACKED_BYTES = 1 << 30
"""Of one compressed file; a sweep of a lidar has some 10 MB."""
_GZIP = 16 + zlib.MAX_WBITS
_STEP_BYTES = 1 << 20


def decompressed(content: bytes, where: str, most_bytes: int = MOST_UNPACKED_BYTES) -> bytes:
    """The content of a gzip file.

    Args:
        content: The compressed bytes.
        where: The file, for messages.
        most_bytes: No more than this is unpacked.

    Raises:
        SemlocError: it is larger, cut short or no gzip.
    """
    found, rest = bytearray(), content
    try:
        while rest:
            member = zlib.decompressobj(_GZIP)
            while not member.eof:
                part = member.decompress(rest, _STEP_BYTES)
                rest = member.unused_data.lstrip(b"\0") if member.eof else member.unconsumed_tail
                found += part
                if len(found) > most_bytes:
                    raise SemlocError(
                        f"{where}: unpacks to more than {most_bytes / 1e6:.0f} MB from {len(content) / 1e6:.1f} MB; "
                        "expected a sweep of a recording; get the file anew"
                    )
                if not part and not member.eof and not rest:
                    raise SemlocError(f"{where}: ends before its gzip stream does; get the file anew")
    except zlib.error as error:
        raise SemlocError(f"{where}: is no gzip file ({error}); get the file anew") from error
    return bytes(found)


def json_document(text: str | bytes, where: str, kind: type = dict) -> Any:
    """The JSON of a file, whose outermost value is of the kind (dict or list).

    Raises:
        SemlocError: no JSON, nested without end, or another kind.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SemlocError(f"{where}: {str(error)[:120] or type(error).__name__}; expected JSON") from error
    if not isinstance(found, kind):
        wanted = {dict: "an object {...}", list: "a list [...]"}[kind]
        raise SemlocError(f"{where}: holds {type(found).__name__}; expected {wanted}")
    return found


def require_room(count: float, most: float, where: str, what: str, remedy: str) -> None:
    """Raise before memory is taken for more than `most` of something.

    Raises:
        SemlocError: `count` is larger or no number.
    """
    if not count <= most:
        raise SemlocError(f"{where}: asks for {count:.3g} {what}; expected at most {most:.3g}; {remedy}")
