"""Do the streams of a recording belong together: rates, gaps, common time (room: datasets; host).

In: Drive. Out: OverlapReport, to be read before work starts.
"""

from dataclasses import dataclass

import numpy as np

from semloc_jax.datasets.base import Drive

_MIN_COVERED = 0.9
"""A sensor that covers less than this share of the frames is reported; our choice."""
_LONG_GAP = 10.0
"""Gaps longer than this many periods are reported; our choice."""
_MIN_GAP_S = 1.0


@dataclass(frozen=True)
class StreamSpan:
    """When a stream says something.

    Args:
        name: of the stream.
        count: number of samples.
        start_s, end_s: first and last time [s].
        rate_hz: one over the median step; 0 for a single sample.
        longest_gap_s: longest step [s].
        covered: share of the frames that lie within the stream.
    """

    name: str
    count: int
    start_s: float
    end_s: float
    rate_hz: float
    longest_gap_s: float
    covered: float

    def __str__(self) -> str:
        return f"{self.name}: {self.count} at {self.rate_hz:.3g} Hz, {self.start_s:.3f} ... {self.end_s:.3f} s" + (
            "" if self.name == "frames" else f", covers {self.covered:.0%} of the frames"
        )


@dataclass(frozen=True)
class OverlapReport:
    """Streams and one sentence for each thing that looks wrong."""

    spans: tuple[StreamSpan, ...]
    problems: tuple[str, ...]

    def to_text(self) -> str:
        """One line for each stream."""
        return "\n".join(map(str, self.spans))

    def apart(self, name: str) -> bool:
        """Whether a stream has no time in common with the frames."""
        return any(span.name == name and span.covered == 0.0 for span in self.spans)


def overlap_report(drive: Drive) -> OverlapReport:
    """Spans of the frames and of every sensor of a drive, and what looks wrong with them."""
    frames_s = np.array([frame.time_s for frame in drive.frames])
    sensors = {"fixes": drive.gnss, "odometry": drive.odometry, "imu": drive.imu, "truth": drive.truth}
    spans = [_span("frames", frames_s, frames_s)]
    spans += [_span(name, sensor.time_s, frames_s) for name, sensor in sensors.items() if sensor is not None]
    return OverlapReport(tuple(spans), tuple(_problems(spans)))


def _span(name: str, time_s: np.ndarray, frames_s: np.ndarray) -> StreamSpan:
    steps = np.diff(np.sort(time_s))
    steps = steps[steps > 0]
    period = float(np.median(steps)) if len(steps) else 0.0
    start, end = float(time_s.min()), float(time_s.max())
    # A frame half a period outside of a stream is still served by its first or last sample.
    inside = (frames_s >= start - period) & (frames_s <= end + period)
    gap = float(steps.max()) if len(steps) else 0.0
    return StreamSpan(name, len(time_s), start, end, 1.0 / period if period else 0.0, gap, float(inside.mean()))


def _problems(spans: list[StreamSpan]) -> list[str]:
    frames, found = spans[0], []
    for span in spans[1:]:
        where = f"{span.name} {span.start_s:.3f} ... {span.end_s:.3f} s"
        theirs = f"frames {frames.start_s:.3f} ... {frames.end_s:.3f} s"
        if span.covered == 0.0:
            away_s = max(span.start_s - frames.end_s, frames.start_s - span.end_s)
            found.append(
                f"{where} and {theirs} have no time in common ({away_s:.6g} s apart): other clocks, other units, or "
                "another drive"
            )
        elif span.covered < _MIN_COVERED:
            found.append(f"{where} cover {span.covered:.0%} of the {theirs}")
    for span in spans:
        if span.rate_hz and span.longest_gap_s > max(_LONG_GAP / span.rate_hz, _MIN_GAP_S):
            found.append(f"{span.name}: a gap of {span.longest_gap_s:.1f} s in a stream of {span.rate_hz:.3g} Hz")
    return found
