"""The report of few landmarks: what `semloc bench --landmarks` measures, writes and draws (room: reports; host).

In: LandmarkPlan. Out: tables as text, a JSON file, a picture.
"""

import json
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from semloc_jax.bench.landmarks import Driven, DrivenFrame, LandmarkPlan, drive_all
from semloc_jax.storage import write_text
from semloc_jax.viz.error_curves import landmark_figure
from semloc_jax.viz.style import save

_IN_VIEW = (1, 3, 5, 8, 12, 18, 100)
"""Borders of the groups of frames with so many signs and posts in view."""


class LandmarkRow(NamedTuple):
    """Errors of the frames whose bounds are known: root mean squares over both directions in the plane [m]."""

    group: str
    num_frames: int
    in_view: float
    """Signs and posts, on average."""
    window_m: float
    """The window, with motion."""
    window_bound_m: float
    alone_m: float
    """Each frame alone."""
    alone_bound_m: float
    nees: float
    """Mean square error of the window over the stated variance; 1 is right."""

    @property
    def window_ratio(self) -> float:
        """Error of the window over its bound."""
        return self.window_m / self.window_bound_m

    @property
    def alone_ratio(self) -> float:
        """Error of single frames over their bound."""
        return self.alone_m / self.alone_bound_m


def report_landmarks(
    plan: LandmarkPlan, data: Path | None = None, plot: Path | None = None, say: Callable[[str], None] = print
) -> str:
    """Drive, write, and return the tables.

    Args:
        plan: What is driven.
        data: JSON file; None for none.
        plot: Picture; None for none.
        say: Called with a line on each road.
    """
    driven = drive_all(plan, say)
    by_road, by_number = roads(driven), numbers_in_view(driven)
    if data is not None:
        rows = {"by_road": [row._asdict() for row in by_road], "by_number": [row._asdict() for row in by_number]}
        write_text(data, json.dumps({"command": ["semloc", *sys.argv[1:]], **rows}, indent=1) + "\n")
    if plot is not None:
        save(landmark_figure([row._asdict() for row in by_number], [row._asdict() for row in by_road[:-1]]), plot)
    late = sum(drive.num_before_start for drive in driven)
    lines = [
        f"{plan.world.num_signs} signs, {plan.world.num_lamps} posts and lanes; {plan.world.noise_px:g} px, "
        f"{100 * plan.world.map_sigma_m:g} cm on the map; {late} frames before a start",
        "",
        *_table("road", by_road),
        "",
        *_table("signs and posts in view", by_number),
    ]
    return "\n".join(lines)


def roads(driven: Sequence[Driven]) -> list[LandmarkRow]:
    """A row for each length of road, and one for all."""
    lengths = dict.fromkeys(drive.road_m for drive in driven)
    groups = {f"{road_m:.0f} m": [drive for drive in driven if drive.road_m == road_m] for road_m in lengths}
    groups["all"] = list(driven)
    return [_row(name, [frame for drive in own for frame in drive.frames]) for name, own in groups.items()]


def numbers_in_view(driven: Sequence[Driven]) -> list[LandmarkRow]:
    """A row for each number of signs and posts in view, of all roads."""
    frames = [frame for drive in driven for frame in drive.frames]
    found = []
    for low, high in pairwise(_IN_VIEW):
        own = [frame for frame in frames if low <= frame.num_in_view < high]
        if any(frame.bounds for frame in own):
            found.append(_row(f"{low} .. {high - 1}" if high < _IN_VIEW[-1] else f"{low} or more", own))
    return found


def _row(group: str, frames: Sequence[DrivenFrame]) -> LandmarkRow:
    frames = [frame for frame in frames if frame.bounds is not None]
    bounds = [frame.bounds for frame in frames]
    squares = [f.window_error_m @ np.linalg.solve(f.window_covariance, f.window_error_m) for f in frames]
    return LandmarkRow(
        group,
        len(frames),
        float(np.mean([frame.num_in_view for frame in frames])),
        _rms([frame.window_error_m for frame in frames]),
        float(np.sqrt(np.mean([np.trace(bound.window) for bound in bounds]))),
        _rms([frame.alone_error_m for frame in frames]),
        float(np.sqrt(np.mean([np.trace(bound.alone) for bound in bounds]))),
        float(np.mean(squares)) / 2.0,
    )


def _rms(errors_m: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(errors_m), axis=1))))


def _table(name: str, rows: Sequence[LandmarkRow]) -> list[str]:
    head = f"| {name} | frames | in view | window [m] | bound | ratio | NEES | frame alone [m] | bound | ratio |"
    found = [head, "|---" * 10 + "|"]
    for row in rows:
        window = f"{row.window_m:.3f} | {row.window_bound_m:.3f} | {row.window_ratio:.2f} | {row.nees:.2f}"
        alone = f"{row.alone_m:.3f} | {row.alone_bound_m:.3f} | {row.alone_ratio:.2f}"
        found.append(f"| {row.group} | {row.num_frames} | {row.in_view:.1f} | {window} | {alone} |")
    return found
