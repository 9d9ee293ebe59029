"""Curbs that cross each other are of something that stands on the road (room: mapping; host).

In: curbs that were drawn. Out: those that no other one crosses.
What stands a hand high is seen over the road behind it, from each place over another part of it: a wheel stop of a
garage comes out as a star of lines that cross. Curbs of a street meet at corners, end to end.
"""

from collections.abc import Sequence

import numpy as np
import shapely

from semloc_jax.maps import MapElement

_END_M = 0.3
"""Lines that cross nearer than this to the end of one of them meet there; ours."""
_LEAST_SHARE = 0.5
"""A line that is crossed by one of less than this share of its own length stays; ours."""
_AROUND_M, _LEAST_SINE = 1.0, 0.4
"""The direction of a line is taken over this much to both sides. Lines at a sharper angle are one border that was drawn
twice, now here, now there; ours."""


def uncrossed(curbs: Sequence[MapElement]) -> list[MapElement]:
    """The curbs that no other one of about their own length, or longer, crosses.

    Args:
        curbs: polylines on the road [m].
    """
    lines = [shapely.LineString(curb.points[:, :2]) for curb in curbs]
    first, second = shapely.STRtree(lines).query(lines, predicate="crosses") if lines else np.zeros((2, 0), int)
    pairs = zip(first.tolist(), second.tolist(), strict=True)
    crossed = {a for a, b in pairs if _is_crossed(lines[a], lines[b])}
    return [curb for k, curb in enumerate(curbs) if k not in crossed]


def _is_crossed(a: shapely.LineString, b: shapely.LineString) -> bool:
    """Whether a line is crossed by one that is not much shorter, at an angle, away from the ends of both."""
    if b.length < _LEAST_SHARE * a.length:
        return False
    for point in shapely.get_parts(a.intersection(b)):
        place = point.centroid
        at_m = [line.project(place) for line in (a, b)]
        if any(not _END_M <= m <= line.length - _END_M for line, m in zip((a, b), at_m, strict=True)):
            continue
        along_a, along_b = (_direction(line, m) for line, m in zip((a, b), at_m, strict=True))
        if abs(along_a[0] * along_b[1] - along_a[1] * along_b[0]) > _LEAST_SINE:
            return True
    return False


def _direction(line: shapely.LineString, at_m: float) -> np.ndarray:
    low, high = (
        np.asarray(line.interpolate(np.clip(at_m + step, 0.0, line.length)).coords[0])
        for step in (-_AROUND_M, _AROUND_M)
    )
    return (high - low) / max(float(np.linalg.norm(high - low)), 1e-9)
