"""Whole numbers in few bytes: zigzag varints, and columns of them behind a header (room: maps; host).

In: integers. Out: bytes, seven bits each, and the integers back.
Layout of columns: size of the header, the header, then of each column its count, its size and its varints; sizes and
counts are little-endian `uint32`.
"""

from collections.abc import Iterable

import numpy as np

_SIZE = np.dtype("<u4")
_MOST_COLUMNS = 64
"""No form has more. A file of zeros would be millions of empty ones, and take a minute to be refused."""


def pack_integers(values: np.ndarray) -> bytes:
    """Returns integers as zigzag varints, seven bits a byte, low ones first."""
    values = np.asarray(values, dtype=np.int64)
    rest = ((values << 1) ^ (values >> 63)).astype(np.uint64)
    rows = []
    while True:
        more = rest >= 128
        rows.append(np.where(more, (rest & 127) | 128, rest))
        if not more.any():
            break
        rest = rest >> 7
    table = np.stack(rows, axis=1).astype(np.uint8)
    used = np.ones(table.shape, dtype=bool)
    used[:, 1:] = np.cumprod(table[:, :-1] >= 128, axis=1).astype(bool)
    return table[used].tobytes()


def unpack_integers(packed: bytes, count: int) -> np.ndarray:
    """Returns the integers of `pack_integers`.

    Raises:
        ValueError: another number of them.
    """
    raw = np.frombuffer(packed, dtype=np.uint8)
    last = np.flatnonzero(raw < 128)
    if len(last) != count or (count and last[-1] != len(raw) - 1) or (not count and len(raw)):
        raise ValueError("a column has the wrong length")
    if not count:
        return np.zeros(0, dtype=np.int64)
    start = np.concatenate([[0], last[:-1] + 1]).astype(np.int64)
    place = np.arange(len(raw)) - np.repeat(start, last - start + 1)
    if (place > 9).any():
        raise ValueError("a number is too long")
    parts = (raw & 127).astype(np.uint64) << (7 * place).astype(np.uint64)
    values = np.add.reduceat(parts, start)
    return (values >> 1).astype(np.int64) ^ -(values & 1).astype(np.int64)


def joined_columns(header: bytes, columns: Iterable[np.ndarray]) -> bytes:
    """Returns a header and columns of integers as one run of bytes."""
    parts = [np.array([len(header)], dtype=_SIZE).tobytes(), header]
    for column in columns:
        packed = pack_integers(column)
        parts += [np.array([len(column), len(packed)], dtype=_SIZE).tobytes(), packed]
    return b"".join(parts)


def split_columns(joined: bytes) -> tuple[bytes, list[np.ndarray]]:
    """Returns the header and the columns of `joined_columns`.

    Raises:
        ValueError, IndexError: cut short, a column of another length, or too many of them.
    """
    width = _SIZE.itemsize
    at = width + int(np.frombuffer(joined[:width], dtype=_SIZE)[0])
    header, columns = joined[width:at], []
    while at < len(joined):
        if len(columns) == _MOST_COLUMNS:
            raise ValueError(f"more than {_MOST_COLUMNS} columns")
        count, length = (int(v) for v in np.frombuffer(joined[at : at + 2 * width], dtype=_SIZE))
        at += 2 * width
        columns.append(unpack_integers(joined[at : at + length], count))
        at += length
    return header, columns
