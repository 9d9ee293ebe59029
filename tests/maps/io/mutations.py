"""Broken copies of a file, drawn by hypothesis: bits, cuts, repeats, and numbers that no file should have.

SEMLOC_FUZZ is the number of broken copies of each file; by default a few, always the same ones. What goes wrong is
shrunk to the fewest edits and printed with them.
"""

import os
import re
import resource
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from semloc_jax.errors import SemlocError

LONGEST_S = 10.0
MOST_GROWTH_KIB = 1 << 20
QUICK = int(os.environ.get("SEMLOC_FUZZ", "12"))
THOROUGH = 500
COUNTS = [QUICK, pytest.param(THOROUGH, marks=pytest.mark.slow)]
"""For `parametrize`: the slow ones are more than 10,000 over all files that are broken."""

_NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][+-]?\d+)?")
_ODD = [b"nan", b"inf", b"-1e308", b"1e308", b"1e-300", b"0", b"-1", b"9" * 20, b"", b"1e9", b"0x1", b"null"]
_FINE = 1 << 20
_PLACE, _SIZE = st.integers(0, _FINE - 1), st.integers(1, 63)
# Every other copy stays well-formed text: only numbers change, so that the reader gets beyond the parser.
_NUMBERS = st.lists(st.tuples(st.just("number"), _PLACE, st.sampled_from(_ODD)), min_size=1, max_size=4)
_ANYTHING = st.lists(
    st.one_of(
        st.tuples(st.just("bit"), _PLACE, st.integers(0, 7)),
        st.tuples(st.just("cut"), _PLACE, _SIZE),
        st.tuples(st.just("again"), _PLACE, st.tuples(_SIZE, st.integers(1, 3))),
        st.tuples(st.just("noise"), _PLACE, st.binary(min_size=1, max_size=63)),
        st.tuples(st.just("end"), _PLACE, st.none()),
        st.tuples(st.just("number"), _PLACE, st.sampled_from(_ODD)),
    ),
    min_size=1,
    max_size=4,
)


def break_often(original: bytes, count: int, use: Callable[[bytes], None]) -> int:
    """Calls `use` with `count` broken copies of a file and returns how many it refused.

    It must end, or refuse in one line, within 10 s of processor time and 1 GiB of new memory.
    """
    places = [match.span() for match in _NUMBER.finditer(original)]
    num_refused = 0

    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        derandomize="SEMLOC_FUZZ" not in os.environ,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.one_of(_NUMBERS, _ANYTHING) if places else _ANYTHING)
    def attempt(edits):
        nonlocal num_refused
        content = _edited(original, edits, places)
        with stops_hangs(), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a sum that overflows is no failure
            try:
                use(content)
            except SemlocError as error:
                assert "\n" not in str(error) and len(str(error)) < 2000, error
                num_refused += 1

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    attempt()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST_GROWTH_KIB
    return num_refused


def _edited(original: bytes, edits: list[tuple], places: list[tuple[int, int]]) -> bytes:
    broken = bytearray(original)
    for way, place, what in edits:
        at = place * (len(broken) + 1) // _FINE
        if way == "bit" and broken:
            broken[min(at, len(broken) - 1)] ^= 1 << what
        elif way == "cut":
            del broken[at : at + what]
        elif way == "again":
            broken[at:at] = broken[at : at + what[0]] * what[1]
        elif way == "noise":
            broken[at:at] = what
        elif way == "end":
            del broken[at:]
        elif way == "number" and places:
            start, end = places[place * len(places) // _FINE]
            if end <= len(broken):
                # The same length where it fits, so that later places stay where they are.
                broken[start:end] = what.ljust(end - start)[: max(end - start, len(what))]
    return bytes(broken)


@contextmanager
def stops_hangs() -> Iterator[None]:
    """Ends what takes longer than 10 s of processor time, so that a hang is a failure and not a hang."""

    def give_up(*_: object) -> None:
        raise AssertionError(f"took longer than {LONGEST_S} s")

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
