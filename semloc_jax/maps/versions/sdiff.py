"""Differences between versions as files of few bytes, .sdiff (room: maps; host).

In: MapDifference, the version it belongs on. Out: bytes, and the difference back.
Layout: b"SDIF", version, CRC-32 of the rest, the first 8 bytes of the digest of the base, the digest of the target,
LZMA of `terse`; in version 2, which is read still, of `lifted_json`. Elements of the base are named by their place in
it, a new one is told as what makes it differ from one that is known; columns of many elements stand together,
coordinates and counts as differences. How the frame of the map has moved stands last, where it has.
"""

import lzma
import zlib
from itertools import accumulate
from pathlib import Path

from semloc_jax.errors import SemlocError
from semloc_jax.maps.versions.datum import Datum, steps
from semloc_jax.maps.versions.difference import CANONICAL, MapDifference
from semloc_jax.maps.versions.lifted_json import from_lifted
from semloc_jax.maps.versions.likeness import coded_names, decoded_names, likened, told_records
from semloc_jax.maps.versions.state import DATUM, VERSION, MapState, datum_of
from semloc_jax.maps.versions.tables import against, rows_of, table, upon
from semloc_jax.maps.versions.terse import from_terse, terse_bytes
from semloc_jax.storage import reading, write_bytes

MAGIC, _BEFORE = b"SDIF\x03", b"SDIF\x02"
CHECK_BYTES = 4
_BASE_BYTES, _TARGET_BYTES = 8, 32
_FILTERS = [{"id": lzma.FILTER_LZMA1, "preset": 9, "dict_size": 1 << 24, "lc": 0, "lp": 0, "pb": 0}]
_LARGEST_PAYLOAD = 1 << 27
_NEVER = object()
"""What no member of a file is."""


def sdiff_bytes(step: MapDifference, base: MapState) -> bytes:
    """The file of a difference; the same bytes for the same difference."""
    row = {name: k for k, name in enumerate(base.records)}
    modified = {name: against(columns, base.records[name]) for name, columns in step.modified.items()}
    like = list(likened(step.added, base))
    stated = base.members
    document = [
        step.base_version,
        [part for key, v in step.members.items() if key != DATUM and stated.get(key, _NEVER) != v for part in (key, v)],
        step.order if step.order is None or isinstance(step.order, str) else steps(step.order),
        step.note,
        [len(step.removed), len(modified), len(like)],
        steps([row[name] for name in step.removed]),
        table({row[name]: columns for name, columns in modified.items()}),
        coded_names(step.added, [k for k, _ in like], base),
        [k for k, _ in like],
        table(dict(enumerate(columns for _, columns in like)))[1],
    ]
    datum = datum_of(step.members.get(DATUM))
    if datum != base.datum:
        document.append(datum.against(base.datum))
    packed = lzma.compress(terse_bytes(document), format=lzma.FORMAT_RAW, filters=_FILTERS)
    rest = bytes.fromhex(step.base)[:_BASE_BYTES] + bytes.fromhex(step.target) + packed
    return MAGIC + _check(rest) + rest


def write_sdiff(step: MapDifference, base: MapState, path: str | Path) -> int:
    """Writes a difference; returns the number of its bytes."""
    content = sdiff_bytes(step, base)
    write_bytes(path, content)
    return len(content)


class SdiffFile:
    """A difference as it lies in a file: which step it is can be read without the map that it belongs on."""

    def __init__(self, content: bytes, where: str):
        """Checks the content.

        Raises:
            SemlocError: no difference, cut short, or altered.
        """
        begin = len(MAGIC) + CHECK_BYTES
        if not content.startswith((MAGIC, _BEFORE)):
            raise SemlocError(f"{where}: no difference of two maps; expected a file of `semloc diff`")
        rest, read = content[begin:], from_terse if content.startswith(MAGIC) else from_lifted
        if len(rest) <= _BASE_BYTES + _TARGET_BYTES or _check(rest) != content[len(MAGIC) : begin]:
            raise SemlocError(f"{where}: its content is not what was written (cut short or altered); get it again")
        self.base, self.target = rest[:_BASE_BYTES].hex(), rest[_BASE_BYTES : _BASE_BYTES + _TARGET_BYTES].hex()
        with reading(where):
            decoder = lzma.LZMADecompressor(format=lzma.FORMAT_RAW, filters=_FILTERS)
            text = decoder.decompress(rest[_BASE_BYTES + _TARGET_BYTES :], max_length=_LARGEST_PAYLOAD)
            base_version, members, self._order, note, counts, *self._body = read(text)
            told = members if isinstance(members, dict) else dict(zip(members[::2], members[1::2], strict=True))
            self.base_version, self._members, self.note = int(base_version), dict(told), str(note)
            self.version = int(self._members.get(VERSION, base_version))
            self.num_removed, self.num_modified, self.num_added = (int(count) for count in counts)
        self._where = where

    @classmethod
    def read(cls, path: str | Path) -> "SdiffFile":
        """The file of a path.

        Raises:
            SemlocError: no such file, no difference, cut short, or altered.
        """
        path = Path(path)
        if not path.is_file():
            raise SemlocError(f"difference {path}: no such file; `semloc diff A B --out {path.name}` writes one")
        return cls(path.read_bytes(), f"difference {path.name}")

    def is_on(self, digest: str) -> bool:
        """Whether it belongs on the version with that digest."""
        return digest.startswith(self.base)

    def on(self, base: MapState) -> MapDifference:
        """The difference on the version it belongs on.

        Raises:
            SemlocError: it belongs on another one.
        """
        if not self.is_on(base.digest):
            raise SemlocError(
                f"{self._where}: is for version {self.base_version} ({self.base[:12]}), and map {base.map.name} is "
                f"version {base.version} ({base.digest[:12]}); apply it to that one"
            )
        names = list(base.records)
        with reading(self._where):
            removed, modified, ids, like, added, *moved = self._body
            datum = Datum.upon(moved[0], base.datum) if moved else base.datum
            still = {key: value for key, value in base.members.items() if key != DATUM}
            return MapDifference(
                base.digest,
                self.base_version,
                self.target,
                still | self._members | ({} if datum.is_still else {DATUM: datum.to_json()}),
                tuple(names[k] for k in accumulate(removed)),
                {names[k]: upon(columns, base.records[names[k]]) for k, columns in rows_of(modified).items()},
                told_records(decoded_names(ids, like, base), like, added, base),
                self._order if self._order in (None, CANONICAL) else tuple(accumulate(self._order)),
                self.note,
            )


def _check(rest: bytes) -> bytes:
    return zlib.crc32(rest).to_bytes(CHECK_BYTES, "little")
