"""What JSON keeps, and bytes, as tokens of a byte and whole numbers apart: few bytes (room: maps; host).

In: a value. Out: bytes, and the same back. Layout: size of the tokens as a varint, tokens, varints.
A token says what stands there: a word that most differences hold, a list, numbers; counts and numbers stand behind all
tokens, where like is beside like. Numbers are told in their largest common unit, those with a point as whole decimals.
"""

import json
import math
from typing import Any

import numpy as np

from semloc_jax.maps.io.varints import pack_integers, unpack_integers
from semloc_jax.maps.versions.records import json_bytes

WORDS = (
    *("class", "style", "shape", "closed", "width", "radius", "radius_top", "height", "normal", "true_ends"),
    *("+points", "points", "keys", "+keys", "mm", "all", "crowd", "sigma_across_m", "sigma_along_m"),
    *("existence_logit", "num_seen", "num_missed", "provenance", "a.sigma_across_m", "a.sigma_along_m"),
    *("a.existence_logit", "a.num_seen", "a.num_missed", "+a.num_seen", "+a.num_missed", "a.provenance"),
    *("~points", "map_version", "num_drives", "a.sigma_place_m", "a.sigma_turn_rad", "canonical"),
)
"""What is told by one byte; a file keeps its meaning only while this list stays as it is, or grows at its end."""
_NONE, _FALSE, _TRUE, _TEXT, _BYTES, _LIST, _MAP, _WHOLE, _DECIMAL, _JSON, _RUN, _DECIMALS, _TABLE = range(13)
_FIRST_WORD, _LAST_BYTE = 16, 128
_MOST, _MOST_DECIMALS, _DEEPEST = 2**62, 6, 60


def terse_bytes(value: Any) -> bytes:
    """The bytes of a value; the same bytes for the same value."""
    tokens, numbers = bytearray(), list[int]()
    _tell(value, tokens, numbers)
    return pack_integers(np.array([len(tokens)])) + tokens + pack_integers(np.array(numbers, dtype=np.int64))


def from_terse(content: bytes) -> Any:
    """The value of these bytes.

    Raises:
        ValueError: cut short, or no such tokens.
    """
    at = next((k + 1 for k, byte in enumerate(content[:10]) if byte < _LAST_BYTE), 0)
    size = int(unpack_integers(content[:at], 1)[0])
    if not 0 < size <= len(content) - at:
        raise ValueError("tokens of another length")
    told = _Told(content[at : at + size], content[at + size :])
    value = told.value(0)
    if not told.is_read:
        raise ValueError("more than the first value names")
    return value


def _tell(value: Any, tokens: bytearray, numbers: list[int]) -> None:
    if value is None or isinstance(value, bool):
        tokens.append(_NONE if value is None else _TRUE if value else _FALSE)
    elif isinstance(value, str) and value in WORDS:
        tokens.append(_FIRST_WORD + WORDS.index(value))
    elif isinstance(value, str | bytes):
        content = value if isinstance(value, bytes) else value.encode("utf-8", "surrogatepass")
        tokens.append(_BYTES if isinstance(value, bytes) else _TEXT)
        numbers.append(len(content))
        tokens += content
    elif isinstance(value, dict):
        tokens.append(_MAP)
        numbers.append(len(value))
        for key, item in value.items():
            _tell(str(key), tokens, numbers)
            _tell(item, tokens, numbers)
    elif isinstance(value, list | tuple):
        _tell_list(value, tokens, numbers)
    elif type(value) is int and abs(value) < _MOST:
        tokens.append(_WHOLE)
        numbers.append(value)
    elif (found := _decimals([value])) is not None:
        tokens.append(_DECIMAL)
        numbers += [found[0], *found[1]]
    else:
        content = json_bytes(value)
        tokens.append(_JSON)
        numbers.append(len(content))
        tokens += content


def _tell_list(value: list | tuple, tokens: bytearray, numbers: list[int]) -> None:
    if _is_whole(value):
        tokens.append(_RUN)
        _put(value, [len(value)], numbers)
    elif value and (found := _decimals(value)) is not None:
        tokens.append(_DECIMALS)
        _put(found[1], [len(value), found[0]], numbers)
    elif (
        len(value) > 1
        and all(isinstance(row, list | tuple) and len(row) == len(value[0]) for row in value)
        and all(map(_is_whole, value))
    ):
        tokens.append(_TABLE)
        _put([number for row in value for number in row], [len(value), len(value[0])], numbers)
    else:
        tokens.append(_LIST)
        numbers.append(len(value))
        for item in value:
            _tell(item, tokens, numbers)


def _is_whole(values: list | tuple) -> bool:
    return bool(values) and all(type(v) is int and abs(v) < _MOST for v in values)


def _decimals(values: list | tuple) -> tuple[int, list[int]] | None:
    """How many decimals say numbers with a point to the bit, and these; None where too few do."""
    if not all(type(v) is float and abs(v) < _MOST / 10**_MOST_DECIMALS for v in values):
        return None
    for num in range(_MOST_DECIMALS + 1):
        whole = [round(v * 10**num) for v in values]
        if all(repr(w / 10**num) == repr(v) for w, v in zip(whole, values, strict=True)):
            return num, whole
    return None


def _put(values: list | tuple, counts: list[int], numbers: list[int]) -> None:
    unit = max(math.gcd(*values), 1)
    numbers += [*counts, unit, *(v // unit for v in values)]


class _Told:
    """Tokens and numbers, read from their beginning."""

    def __init__(self, tokens: bytes, tail: bytes):
        self._tokens, self._at = tokens, 0
        self._numbers, self._taken = unpack_integers(tail, sum(byte < _LAST_BYTE for byte in tail)).tolist(), 0

    @property
    def is_read(self) -> bool:
        """Whether nothing is left."""
        return self._at == len(self._tokens) and self._taken == len(self._numbers)

    def value(self, depth: int) -> Any:
        """The next value.

        Raises:
            ValueError: none.
        """
        token = self._content(1)[0]
        if token >= _FIRST_WORD:
            return WORDS[self._at_most(token - _FIRST_WORD, len(WORDS) - 1)]
        if depth > _DEEPEST:
            raise ValueError("lists within lists without end")
        if token in (_NONE, _FALSE, _TRUE):
            return (None, False, True)[token]
        if token in (_TEXT, _BYTES, _JSON):
            content = self._content(self._number())
            return content if token == _BYTES else self._text(content) if token == _TEXT else _json(content)
        if token in (_LIST, _MAP):
            num = self._at_most(self._number(), len(self._tokens) - self._at)
            items = [self.value(depth + 1) for _ in range(num * (2 if token == _MAP else 1))]
            return items if token == _LIST else _mapping(items[::2], items[1::2])
        if token == _WHOLE:
            return self._number()
        if token == _DECIMAL:
            tenth = 10 ** self._at_most(self._number(), _MOST_DECIMALS)
            return self._number() / tenth
        return self._run(token)

    def _run(self, token: int) -> list:
        """Numbers of one kind."""
        num = self._number()
        if token == _DECIMALS:
            tenth = 10 ** self._at_most(self._number(), _MOST_DECIMALS)
            return [number / tenth for number in self._multiples(num)]
        if token == _TABLE:
            columns = self._at_most(self._number(), len(self._numbers))
            flat = self._multiples(num * columns)
            return [flat[k * columns : (k + 1) * columns] for k in range(num)]
        if token != _RUN:
            raise ValueError("no token of this form")
        return self._multiples(num)

    def _multiples(self, num: int) -> list[int]:
        unit = self._number()
        if not 0 < num <= len(self._numbers) - self._taken:
            raise ValueError("fewer numbers than the tokens name")
        self._taken += num
        return [unit * number for number in self._numbers[self._taken - num : self._taken]]

    def _number(self) -> int:
        if self._taken == len(self._numbers):
            raise ValueError("fewer numbers than the tokens name")
        self._taken += 1
        return self._numbers[self._taken - 1]

    def _content(self, num: int) -> bytes:
        if not 0 <= num <= len(self._tokens) - self._at:
            raise ValueError("fewer tokens than they name")
        self._at += num
        return self._tokens[self._at - num : self._at]

    @staticmethod
    def _text(content: bytes) -> str:
        return content.decode("utf-8", "surrogatepass")

    @staticmethod
    def _at_most(number: int, most: int) -> int:
        if not 0 <= number <= most:
            raise ValueError("a number that no such file holds")
        return number


def _mapping(keys: list, values: list) -> dict[str, Any]:
    if not all(isinstance(key, str) for key in keys):
        raise ValueError("a member without a name")
    return dict(zip(keys, values, strict=True))


def _json(content: bytes) -> Any:
    def refused(constant: str) -> None:
        raise ValueError(f"{constant} is no number")

    return json.loads(content, parse_constant=refused)
