"""How much a file may ask for (room: ground; host).

In: compressed bytes, JSON text, numbers of rows that a file asks for. Out: the content, or a sentence before memory is
taken.
"""

import contextlib
import json
import math
import zipfile
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from semloc_jax.errors import SemlocError, UsageError

MOST_UNPACKED_BYTES = 1 << 30
"""Of one compressed file; a sweep of a lidar has some 10 MB."""
FARTHEST_M = 1e8
"""No place on the earth, in any coordinates, projected grids included, is farther from its origin."""
MOST_PIXELS = 2**27
"""A small file can state any size of a picture; no camera has so many pixels."""
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
                        "expected a sweep of a recording; get the file again"
                    )
                if not part and not member.eof and not rest:
                    raise SemlocError(f"{where}: ends before its gzip stream does; get the file again")
    except zlib.error as error:
        raise SemlocError(f"{where}: is no gzip file ({error}); get the file again") from error
    return bytes(found)


def npy_array(path: Path, where: str) -> Any:
    """The array of an npy file; a head that states more than the file holds is refused before memory is taken for it.

    Raises:
        SemlocError: no npy file of numbers.
    """
    import numpy as np

    with reading(where):
        return np.array(np.load(path, mmap_mode="r"))


def npz_arrays(
    path: Path, where: str, most_bytes: int = MOST_UNPACKED_BYTES, names: Collection[str] | None = None
) -> dict[str, Any]:
    """The arrays of an npz file by name; what each states as its size is checked before memory is taken for it.

    Args:
        path: The file.
        where: The file, for messages.
        most_bytes: No more than this is unpacked.
        names: Arrays to read, those of them that are there; None for all.

    Raises:
        SemlocError: no npz file, larger than `most_bytes`, or an array that states more than is there.
    """
    import numpy as np

    found = {}
    with reading(where), zipfile.ZipFile(path) as archive:
        members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
        if names is not None:
            members = [member for member in members if member.filename.removesuffix(".npy") in names]
        require_room(sum(m.file_size for m in members), most_bytes, where, "bytes", "get the file again")
        for member in members:
            with archive.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                read_header = {(1, 0): np.lib.format.read_array_header_1_0}.get(
                    version, np.lib.format.read_array_header_2_0
                )
                shape, is_fortran, dtype = read_header(stream)
                if dtype.hasobject:
                    raise ValueError("an array of objects")
                size = math.prod(shape) * dtype.itemsize
                require_room(size, member.file_size, f"{where}: {member.filename}", "bytes", "get the file again")
                flat = np.frombuffer(stream.read(size), dtype)
                name = member.filename.removesuffix(".npy")
                found[name] = flat.reshape(shape, order="F" if is_fortran else "C").copy()
    return found


def npz_names(path: Path, where: str) -> list[str]:
    """The names of the arrays of an npz file.

    Raises:
        SemlocError: no npz file.
    """
    with reading(where), zipfile.ZipFile(path) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]


def json_document(text: str | bytes, where: str) -> dict[str, Any]:
    """The JSON of a file, whose outermost value is an object.

    Raises:
        SemlocError: no JSON, nested without end, or no object.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SemlocError(f"{where}: {str(error)[:120] or type(error).__name__}; expected JSON") from error
    if not isinstance(found, dict):
        raise SemlocError(f"{where}: holds {type(found).__name__}; expected an object {{...}}")
    return found


def require_room(count: float, most: float, where: str, what: str, remedy: str) -> None:
    """Raise before memory is taken for more than `most` of something.

    Raises:
        SemlocError: `count` is larger or no number.
    """
    if not count <= most:
        raise SemlocError(f"{where}: asks for {count:.3g} {what}; expected at most {most:.3g}; {remedy}")


@contextlib.contextmanager
def reading(where: str) -> Iterator[None]:
    """Whatever a damaged file makes a reader stumble over becomes one sentence that names the file.

    Raises:
        SemlocError: the block raised anything else.
    """
    try:
        yield
    except (SemlocError, UsageError, FileNotFoundError, PermissionError):  # these name themselves
        raise
    except Exception as error:  # parsers pass on whatever they stumble over
        said = " ".join(str(error).split())[:120]
        raise SemlocError(
            f"{where}: its content is not what such a file holds ({type(error).__name__}: {said}); get the file again, "
            "or see --debug"
        ) from error
