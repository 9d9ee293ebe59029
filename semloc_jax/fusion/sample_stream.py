"""Samples of one sensor in time order, however they arrive (room: fusion; host).

In: time-stamped rows. Out: values at any time, and for how long nothing was measured.
"""

import bisect

import numpy as np

from semloc_jax.errors import SemlocError


class SampleStream:
    """Buffer of one sensor: rows of numbers by time."""

    def __init__(self, num_columns: int) -> None:
        """An empty buffer."""
        self.times: list[float] = []
        self.rows: list[np.ndarray] = []
        self.num_columns = num_columns

    def add(self, time_s: float, row: np.ndarray, what: str) -> None:
        """Take a sample; one of the same time is replaced.

        Raises:
            SemlocError: it is not finite; `what` names the sensor.
        """
        if not (np.isfinite(time_s) and np.isfinite(row).all()):
            raise SemlocError(f"{what} at {time_s} s: {row} is not finite; leave out samples that are not valid")
        place = bisect.bisect_left(self.times, time_s)
        if place < len(self.times) and self.times[place] == time_s:
            self.rows[place] = row
            return
        self.times.insert(place, float(time_s))
        self.rows.insert(place, row)

    def between(self, from_s: float, to_s: float) -> list[float]:
        """Times of the samples inside an interval, its ends left out."""
        return self.times[bisect.bisect_right(self.times, from_s) : bisect.bisect_left(self.times, to_s)]

    def forget(self, before_s: float) -> None:
        """Drop samples before a time, but for the last one."""
        keep_from = max(bisect.bisect_left(self.times, before_s) - 1, 0)
        del self.times[:keep_from], self.rows[:keep_from]

    def at(self, time_s: np.ndarray, max_gap_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Values at increasing times and for how long they have not been measured (0: measured; inf: never were).

        Inside a gap the last value holds: the sample after the gap is not known to a vehicle that drives in it.
        """
        first = max(bisect.bisect_right(self.times, time_s[0]) - 1, 0)
        last = bisect.bisect_right(self.times, time_s[-1]) + 1
        if not self.times[first:last]:
            return np.zeros((len(time_s), self.num_columns)), np.full(len(time_s), np.inf)
        times, rows = np.array(self.times[first:last]), np.array(self.rows[first:last])
        before = np.searchsorted(times, time_s, side="right") - 1
        after = np.minimum(before + 1, len(times) - 1)
        before = np.maximum(before, 0)
        gap_s, age_s = times[after] - times[before], time_s - times[before]
        joined = (age_s >= 0.0) & (gap_s > 0.0) & (gap_s <= max_gap_s)
        share = np.where(joined, age_s / np.where(joined, gap_s, 1.0), 0.0)[:, None]
        unmeasured_s = np.where(age_s < -max_gap_s, np.inf, np.where(joined | (age_s <= max_gap_s), 0.0, age_s))
        return (1.0 - share) * rows[before] + share * rows[after], unmeasured_s
