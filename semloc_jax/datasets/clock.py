"""Times of recordings in seconds, whatever unit they were written in (room: datasets; host).

In: numbers and, where there is one, the name of their column. Out: float64 seconds and the unit that was taken.
"""

import re

import numpy as np
from jaxtyping import Float

from semloc_jax.errors import SemlocError

TIME_NAMES = ("t", "time", "timestamp", "t_s", "time_s", "t_ms", "t_us", "t_ns", "timestamp_ms", "timestamp_us")
TIME_NAMES += ("timestamp_ns", "time_ns", "time_us", "time_ms", "stamp", "#timestamp [ns]", "timestamp [ns]")
"""What a column of times may be called."""
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_EPOCH_S = (3.0e8, 5.0e9)
"""Times since 1970 lie in here (1979 ... 2128): receivers and cameras are not older, clocks not further off."""
_STEP_S = (2e-4, 2.5)
"""Sampling intervals of recordings lie in this range: an interval of 5 means 5 ms; our choice."""
_COLUMN = re.compile(r"(?:^|[_\[( .])(s|sec|secs|seconds|ms|msec|us|usec|ns|nsec|nanoseconds)\]?\)?$", re.IGNORECASE)
_SPELLED = {"sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "usec": "us", "nsec": "ns", "nanoseconds": "ns"}


def seconds(times: np.ndarray, where: str, column: str = "") -> tuple[Float[np.ndarray, " n"], str]:
    """Times in seconds and the unit they were in: s, ms, us or ns.

    The unit is that of the column's name (`t_ns`, `time [ms]`), else the one in which the times are those of a clock,
    else the largest in which their median step is one of a recording.

    Args:
        times: numbers, integers stay exact up to the last digit that seconds in float64 hold (0.2 us).
        where: what they belong to, for messages.
        column: name of their column.

    Raises:
        SemlocError: a time is not finite, or no unit makes a recording of them.
    """
    values = np.asarray(times)
    if not np.isfinite(values.astype(np.float64)).all():
        raise SemlocError(f"{where}: a time is not a finite number; expected one for each row; repair or drop the row")
    named = unit_of_column(column)
    unit = named or _unit_of_values(values.astype(np.float64), where)
    return _scaled(values, unit), unit


def unit_of_column(column: str) -> str | None:
    """The unit that a column's name ends in; None where it names none."""
    found = _COLUMN.search(column.strip())
    return _SPELLED.get(found[1].lower(), found[1].lower()) if found else None


def _unit_of_values(values: np.ndarray, where: str) -> str:
    if not len(values):
        return "s"
    first, last = float(values.min()), float(values.max())
    of_clock = [unit for unit, scale in UNITS.items() if _EPOCH_S[0] <= first * scale and last * scale <= _EPOCH_S[1]]
    steps = np.diff(np.unique(values))
    step = float(np.median(steps)) if len(steps) else 0.0
    of_step = [unit for unit, scale in UNITS.items() if _STEP_S[0] <= step * scale <= _STEP_S[1]]
    both = [unit for unit in of_clock if unit in of_step]
    if not (both or of_clock or of_step) and len(steps):
        raise SemlocError(
            f"{where}: times {first:.6g} ... {last:.6g} with steps of {step:.3g}; expected s, ms, us or ns of a "
            "recording; name the unit in the column, e.g. t_ns"
        )
    return (both or of_clock or of_step or ["s"])[0]


def _scaled(values: np.ndarray, unit: str) -> np.ndarray:
    """Seconds; whole numbers are split before they are divided, so that no digit is lost to the large part."""
    if np.issubdtype(values.dtype, np.integer):
        per_second = round(1.0 / UNITS[unit])
        return (values // per_second).astype(np.float64) + (values % per_second) / per_second
    return values.astype(np.float64) * UNITS[unit]
