"""What was drawn twice is once: no two things of one class lie over each other (room: mapping; host).

In: elements that stay, laid along a way that stands, with their beliefs. Out: the same without twins.
A line is followed twice where worn paint opens it, a piece of it askew across it; what a way that drifted drew at two
places lies over itself once the way is right. Paint hides paint and a post fills its place, so one of both is all.
"""

from collections.abc import Sequence

import numpy as np
import shapely

from semloc_jax.maps import Belief, MapElement

_SHARE = 0.5
"""Of the smaller one that lies in the larger one from which both are one; ours."""
_REST_M = 1.0
"""A line that goes on farther beyond the larger one is no twin of it; ours."""
_LEAST_WIDTH_M = 0.1
"""Of a line or a post: by so much two lines of one piece of paint may be off each other; ours."""
Known = tuple[MapElement, Belief]


def without_twins(known: Sequence[Known]) -> list[Known]:
    """The elements without those that lie for the most part in a larger one of their class; the order stays.

    Args:
        known: elements with their beliefs. Of two as large the one seen more often stays.
    """
    shapes = [_footprint(element) for element, _ in known]
    labels = np.array([int(element.label) for element, _ in known])
    order = sorted(range(len(known)), key=lambda k: (-round(shapes[k].area, 3), -known[k][1].num_seen, k))
    rank = np.empty(len(known), int)
    rank[order] = np.arange(len(known))
    near = shapely.STRtree(shapes).query(shapes, predicate="intersects") if shapes else np.zeros((2, 0), int)
    larger: dict[int, list[int]] = {}
    for a, b in near.T.tolist():
        if labels[a] == labels[b] and rank[b] < rank[a] and _may_be_one(known[a][0], known[b][0]):
            larger.setdefault(a, []).append(b)
    stays = np.ones(len(known), bool)
    for k in order:
        over = [shapes[k].intersection(shapes[other]).area for other in larger.get(k, []) if stays[other]]
        most_rest = (1.0 - _SHARE) * shapes[k].area
        if not known[k][0].closed:
            most_rest = min(most_rest, _REST_M * max(known[k][0].width_m, _LEAST_WIDTH_M))
        stays[k] = shapes[k].area - max(over, default=0.0) >= most_rest
    return [item for item, stay in zip(known, stays, strict=True) if stay]


def _may_be_one(one: MapElement, other: MapElement) -> bool:
    """Boards and lamps hang above each other on one post: their heights must meet."""
    low, high = (np.array([end(e.points[:, 2]) for e in (one, other)]) for end in (np.min, np.max))
    return one.normal is None or bool(low.max() < high.min())


def _footprint(element: MapElement) -> shapely.Geometry:
    """What an element fills, seen from above [m]."""
    xy = element.points[:, :2]
    if element.closed and element.normal is None and len(xy) >= 3:
        return shapely.make_valid(shapely.Polygon(xy))
    width_m = max(element.width_m or 2.0 * (element.radius_m or 0.0), _LEAST_WIDTH_M)
    if np.ptp(xy, axis=0).max() < 0.5 * _LEAST_WIDTH_M:  # a post
        return shapely.Point(xy.mean(axis=0)).buffer(0.5 * width_m)
    return shapely.LineString(xy).buffer(0.5 * width_m, cap_style="flat")
