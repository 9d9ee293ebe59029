"""JSON whose lists of whole numbers stand apart, in few bytes (room: maps; host).

In: what JSON keeps. Out: bytes, and the same back. Layout: size of the text as a varint, the text, varints.
In the text a list of whole numbers is "#6": the next six of the varints; "#3x6" is three lists of six, "#6*5" six that
are multiples of five. A string that begins with # gets another one.
"""

import json
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from semloc_jax.maps.io.varints import pack_integers, unpack_integers
from semloc_jax.maps.versions.records import json_bytes

_MARK = "#"
_LIST = re.compile(r"#(\d+)(?:x(\d+))?(?:\*(\d+))?")
_MOST = 2**62
_LAST_BYTE = 128
"""A varint ends with the first byte below."""


def lifted_bytes(value: Any) -> bytes:
    """The bytes of a value; the same bytes for the same value."""
    numbers: list[int] = []
    text = json_bytes(_lifted(value, numbers))
    return pack_integers(np.array([len(text)])) + text + pack_integers(np.array(numbers, dtype=np.int64))


def from_lifted(content: bytes) -> Any:
    """The value of these bytes.

    Raises:
        ValueError: cut short, or numbers that the text does not name.
    """
    at = next((k + 1 for k, byte in enumerate(content[:10]) if byte < _LAST_BYTE), 0)
    size = int(unpack_integers(content[:at], 1)[0])
    if not 0 < size <= len(content) - at:
        raise ValueError("text of another length")
    tail = content[at + size :]
    numbers = unpack_integers(tail, sum(byte < _LAST_BYTE for byte in tail)).tolist()
    taken = 0

    def take(count: int) -> list[int]:
        nonlocal taken
        if count > len(numbers) - taken:
            raise ValueError("fewer numbers than the text names")
        taken += count
        return numbers[taken - count : taken]

    value = _set_back(json.loads(content[at : at + size]), take)
    if taken != len(numbers):
        raise ValueError("more numbers than the text names")
    return value


def _lifted(value: Any, numbers: list[int]) -> Any:
    if isinstance(value, dict):
        return {key: _lifted(item, numbers) for key, item in value.items()}
    if isinstance(value, str):
        return _MARK + value if value.startswith(_MARK) else value
    if not isinstance(value, list | tuple) or not value:
        return value
    if _is_whole(value):
        return f"{_MARK}{len(value)}{_put(value, numbers)}"
    if all(isinstance(row, list | tuple) and len(row) == len(value[0]) and _is_whole(row) for row in value):
        flat = [number for row in value for number in row]
        return f"{_MARK}{len(value)}x{len(value[0])}{_put(flat, numbers)}"
    return [_lifted(item, numbers) for item in value]


def _is_whole(values: list | tuple) -> bool:
    return bool(values) and all(type(v) is int and abs(v) < _MOST for v in values)


def _put(values: list | tuple, numbers: list[int]) -> str:
    unit = math.gcd(*values)
    numbers += [v // max(unit, 1) for v in values]
    return f"*{unit}" if unit > 1 else ""


def _set_back(value: Any, take: Callable[[int], list[int]]) -> Any:
    if isinstance(value, dict):
        return {key: _set_back(item, take) for key, item in value.items()}
    if isinstance(value, list):
        return [_set_back(item, take) for item in value]
    if not isinstance(value, str) or not value.startswith(_MARK):
        return value
    if value.startswith(2 * _MARK):
        return value[1:]
    found = _LIST.fullmatch(value)
    if found is None:
        raise ValueError("neither numbers nor a string")
    rows, columns, unit = (None if part is None else int(part) for part in found.groups())
    values = [number * (unit or 1) for number in take((rows or 0) * (1 if columns is None else columns))]
    return values if columns is None else [values[k * columns : (k + 1) * columns] for k in range(rows or 0)]
