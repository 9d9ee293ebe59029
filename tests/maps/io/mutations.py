"""Broken copies of a file, made with a seed: bits, cuts, repeats, and numbers that no map has."""

import re
from collections.abc import Iterator

import numpy as np

_NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][+-]?\d+)?")
_ODD = (
    b"nan",
    b"inf",
    b"-1e308",
    b"1e308",
    b"1e-300",
    b"0",
    b"-1",
    b"99999999999999999999",
    b"",
    b"1e9",
    b"0x1",
    b"null",
)


def mutations(original: bytes, seed: int, count: int) -> Iterator[bytes]:
    """Yields `count` broken copies of a file."""
    rng = np.random.default_rng(seed)
    places = [match.span() for match in _NUMBER.finditer(original)]
    for index in range(count):
        broken = bytearray(original)
        # Every other copy stays well-formed text: only numbers change, so that the reader gets beyond the parser.
        first_way = 5 if index % 2 and places else 0
        for _ in range(int(rng.integers(1, 5))):
            way = int(rng.integers(first_way, 7)) if places else int(rng.integers(0, 5))
            at, size = int(rng.integers(0, len(broken) + 1)), int(rng.integers(1, 64))
            if way == 0 and broken:
                broken[min(at, len(broken) - 1)] ^= 1 << int(rng.integers(0, 8))
            elif way == 1:
                del broken[at : at + size]
            elif way == 2:
                broken[at:at] = broken[at : at + size] * int(rng.integers(1, 4))
            elif way == 3:
                broken[at:at] = rng.integers(0, 256, size, dtype=np.uint8).tobytes()
            elif way == 4:
                del broken[at if rng.random() < 0.1 else len(broken) :]
            else:
                start, end = places[int(rng.integers(0, len(places)))]
                if end <= len(broken):
                    word = _ODD[int(rng.integers(0, len(_ODD)))]
                    # The same length where it fits, so that later places stay where they are.
                    broken[start:end] = word.ljust(end - start)[: max(end - start, len(word))]
        yield bytes(broken)
