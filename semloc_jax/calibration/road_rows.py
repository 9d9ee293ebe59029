"""What images show of lines of the road, one row for each place and each end (room: calibration; host).

In: matched lines. Out: RoadRows of the places on them and of their ends, with sigmas on the road.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.calibration.road_lines import LaidStreak, RoadLine
from semloc_jax.calibration.road_streaks import Streak
from semloc_jax.perception.ground_contact import SightErrors, ground_covariance

_MIDDLE = SightErrors(pixel_px=0.7, pitch_deg=0.1, height_m=0.02)
"""Of the middle of a line in a mask; the vehicle sways and the road is uneven by centimetres. Ours."""
_END = SightErrors(pixel_px=2.0, pitch_deg=0.1, height_m=0.02)
"""Of the end of a line in a mask, which networks shorten."""
WORTH = 2.0
"""A streak, or the spots of two pictures, count as so many at most: they err together, by the network, the sway of the
vehicle and the shape of the road."""


class RoadRows(NamedTuple):
    """Sights of landmarks of the road.

    Attributes:
        camera: int[n], of each sight.
        frame: int[n].
        landmark: int[n], the line, or the end.
        ray_cam: unit lines of sight.
        along: a point of the line and its unit direction in odom.
        sqrt_info: 1 / standard deviation, in heights of the camera.
        weight: how much of a sight it is.
    """

    camera: Int[np.ndarray, " n"]
    frame: Int[np.ndarray, " n"]
    landmark: Int[np.ndarray, " n"]
    ray_cam: Float[np.ndarray, "n 3"]
    along: Float[np.ndarray, "n 2 2"]
    sqrt_info: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]


class Eye(NamedTuple):
    """What a camera needs to know the road by."""

    height_m: float
    focal_px: float


def place_rows(
    lines: Sequence[RoadLine], streaks: Sequence[Streak], on_road: Sequence[LaidStreak], eyes: Sequence[Eye]
) -> RoadRows:
    """Every place of every streak on its line."""
    found = []
    for number, line in enumerate(lines):
        normal = np.array([-line.along[1, 1], line.along[1, 0]])
        for k in line.streaks:
            streak, eye = streaks[k], eyes[streaks[k].camera]
            weight = min(1.0, WORTH / len(streak.rays_cam))
            for ray, sight in zip(streak.rays_cam, on_road[k].sights, strict=True):
                info = _sqrt_info(sight, eye, _MIDDLE, normal)
                found.append((streak.camera, streak.frame, number, ray, line.along, info, weight))
    return _stacked(found)


def end_rows(
    lines: Sequence[RoadLine],
    streaks: Sequence[Streak],
    on_road: Sequence[LaidStreak],
    eyes: Sequence[Eye],
    gate_m: float,
) -> tuple[RoadRows, Float[np.ndarray, " e"]]:
    """Ends that at least two images show, and where they lie along their lines [m].

    Args:
        lines, streaks, on_road, eyes: as for `place_rows`.
        gate_m: how far apart sights of one end may lie.
    """
    found, places = [], []
    for line in lines:
        for group in _ends(line, streaks, on_road, gate_m):
            for k, end in group:
                streak = streaks[k]
                info = _sqrt_info(on_road[k].end_sights[end], eyes[streak.camera], _END, line.along[1])
                ray = streak.end_rays_cam[end]
                found.append((streak.camera, streak.frame, len(places), ray, line.along, info, 1.0))
            at = [float((on_road[k].ends[end] - line.along[0]) @ line.along[1]) for k, end in group]
            places.append(float(np.median(at)))
    return _stacked(found), np.array(places)


def _ends(
    line: RoadLine, streaks: Sequence[Streak], on_road: Sequence[LaidStreak], gate_m: float
) -> Iterator[list[tuple[int, int]]]:
    """Sights (streak, which end of it) of one end of a line, for each end that at least two images show."""
    for side in (-1.0, 1.0):
        seen = []
        for k in line.streaks:
            for end in (0, 1):
                outward = (on_road[k].ends[end] - on_road[k].middle) @ line.along[1]
                if side * outward > 0:  # False for an end that was not seen
                    seen.append((float((on_road[k].ends[end] - line.along[0]) @ line.along[1]), int(k), end))
        seen.sort()
        cuts = np.flatnonzero(np.diff([s_m for s_m, *_ in seen]) > gate_m) + 1
        for group in np.split(np.arange(len(seen)), cuts):
            members = [seen[i][1:] for i in group]
            if len({(streaks[k].frame, streaks[k].camera) for k, _ in members}) > 1:
                yield members


def _sqrt_info(sight: np.ndarray, eye: Eye, errors: SightErrors, direction: np.ndarray) -> float:
    """1 / standard deviation of a spot of the road along a direction, in heights of the camera."""
    C = ground_covariance(sight, eye.height_m, eye.focal_px, errors)
    return float(eye.height_m / np.sqrt(direction @ C @ direction))


def _stacked(rows: list[tuple]) -> RoadRows:
    columns = list(zip(*rows, strict=True)) or [()] * len(RoadRows._fields)
    shapes = ((-1,), (-1,), (-1,), (-1, 3), (-1, 2, 2), (-1,), (-1,))
    kinds = (int, int, int, float, float, float, float)
    return RoadRows(*(np.array(c, k).reshape(s) for c, k, s in zip(columns, kinds, shapes, strict=True)))
