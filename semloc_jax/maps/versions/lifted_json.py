"""JSON whose lists of whole numbers stand apart: what differences of before are written in (room: maps; host).

In: bytes. Out: what JSON keeps. Layout: size of the text as a varint, the text, varints.
In the text a list of whole numbers is "#6": the next six of the varints; "#3x6" is three lists of six, "#6*5" six that
are multiples of five, "#6/" six numbers that are whole thousandths, "#b" one of the words that most differences hold.
A string that begins with # has another one.
"""

import json
import re
import string
from collections.abc import Callable
from typing import Any

from semloc_jax.maps.io.varints import unpack_integers
from semloc_jax.maps.versions.terse import WORDS

_MARK = "#"
_LIST = re.compile(r"#(\d+)(?:x(\d+))?(?:\*(\d+))?(/)?")
_THOUSAND = 1000
_WORDS = WORDS[: WORDS.index("canonical")]
"""What is told by one letter: the words of today that were there then."""
_LETTERS = string.ascii_letters
_LAST_BYTE = 128
"""A varint ends with the first byte below."""


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


def _set_back(value: Any, take: Callable[[int], list[int]]) -> Any:
    if isinstance(value, dict):
        return {key: _set_back(item, take) for key, item in value.items()}
    if isinstance(value, list):
        return [_set_back(item, take) for item in value]
    if not isinstance(value, str) or not value.startswith(_MARK):
        return value
    if value.startswith(2 * _MARK):
        return value[1:]
    if len(value) == 2 and value[1] in _LETTERS[: len(_WORDS)]:
        return _WORDS[_LETTERS.index(value[1])]
    found = _LIST.fullmatch(value)
    if found is None:
        raise ValueError("neither numbers nor a string")
    rows, columns, unit = (None if part is None else int(part) for part in found.groups()[:3])
    values = [number * (unit or 1) for number in take((rows or 0) * (1 if columns is None else columns))]
    if found[4]:
        return [value / _THOUSAND for value in values]
    return values if columns is None else [values[k * columns : (k + 1) * columns] for k in range(rows or 0)]
