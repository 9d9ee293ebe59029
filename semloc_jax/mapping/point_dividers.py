"""Dividers of parking slots out of marking points (room: mapping; host).

In: places and directions of marking points. Out: the dividers that begin at them, with the direction of their row.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.mapping.slots import Divider, SlotConfig
from semloc_jax.perception.networks.marking_net import RIM_SHARE

_PAINT_M = 0.12
"""Width of painted lines: a marking point is the middle of the paint, an entrance is its outer edge."""
_SAME_WAY_DEG, _ROW_M = 30.0, 0.4
"""Points of one row point the same way but for the error of the network, and lie on one line so nearly."""
_UPRIGHT_DEG = 20.0
"""Dividers so near to a right angle to their row are at one."""
_BETWEEN_DEG = (25.0, 100.0)
"""At the end of a row a mouth has two legs, the divider and the entrance. Where a picture does not tell which is which
a network says the wrong one or something in between, so far from the direction of the row."""
_OPENS, _WITHIN_M = 0.3, 1.65
"""A mouth opens to the aisle: cosine between the way to it and the direction into its slot, that of 73 deg. Nearer to
the way it may be one of the slot that the vehicle drives into."""


def in_view(uv: Float[np.ndarray, "n 2"], side_px: Sequence[int]) -> Bool[np.ndarray, " n"]:
    """Which points of a top view are so far from its rim that they count; width and height."""
    side = np.asarray(side_px)
    return ((uv > RIM_SHARE * side) & (uv < (1.0 - RIM_SHARE) * side - 1)).all(axis=1)


def open_to(
    way: Float[np.ndarray, "m 2"], places: Float[np.ndarray, "n 2"], inward: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Which points open to the way of the vehicle: backs of slots do not, nor does the end of a row seen as a mouth.

    Args:
        way: places of the way [m].
        places: of the points [m].
        inward: unit directions into the slots.
    """
    away = places[:, None] - way
    nearest = np.linalg.norm(away, axis=2).argmin(axis=1)
    away = away[np.arange(len(places)), nearest]
    away_m = np.linalg.norm(away, axis=1)
    return (away_m < _WITHIN_M) | ((away * inward).sum(axis=1) >= _OPENS * away_m)


def by_their_rows(
    places: Float[np.ndarray, "n 2"], inward: Float[np.ndarray, "n 2"], config: SlotConfig
) -> Float[np.ndarray, "n 2"]:
    """Directions into the slots, those along or between the legs of an L mended by the neighbour that its slot shares.

    A neighbour says it where the point lies on its entrance, or where both are such ends, turned to each other.
    """
    mended = inward.copy()
    least, most = np.cos(np.deg2rad(_BETWEEN_DEG[::-1]))
    for k, (place, own) in enumerate(zip(places, inward, strict=True)):
        step = places - place
        away_m = np.linalg.norm(step, axis=1)
        is_near = (away_m >= config.entrance_m[0]) & (away_m <= config.parallel_m[1]) & (step @ own > 0.0)
        turned = inward @ own
        on_line = np.abs((step * inward).sum(axis=1)) < _ROW_M
        rows = np.flatnonzero(is_near & on_line & (turned > least) & (turned < most))
        if len(rows):
            mended[k] = inward[rows[away_m[rows].argmin()]]
            continue
        for j in np.flatnonzero(is_near & (np.abs(turned) < np.sin(np.deg2rad(_SAME_WAY_DEG)))):
            across = np.array([-step[j, 1], step[j, 0]]) / away_m[j]
            both = own + inward[j]
            across = across if across @ both > 0.0 else -across
            if across @ both > np.cos(np.deg2rad(_UPRIGHT_DEG)) * np.linalg.norm(both) and step[j] @ inward[j] < 0.0:
                mended[k] = across
                break
    return mended


def painted_dividers(
    places: Float[np.ndarray, "n 2"], inward: Float[np.ndarray, "n 2"], z_m: float, config: SlotConfig
) -> list[Divider]:
    """As `dividers_of`, from the outer edge of the paint on."""
    return [replace(d, mouth=d.mouth - 0.5 * _PAINT_M * d.inward) for d in dividers_of(places, inward, z_m, config)]


def dividers_of(
    places: Float[np.ndarray, "n 2"], inward: Float[np.ndarray, "n 2"], z_m: float, config: SlotConfig
) -> list[Divider]:
    """The dividers that begin at marking points, with the direction of their row.

    A network tells where a divider begins, not how long it is: those of a row whose points are all as far from each
    other as those of slots along the aisle are taken for short ones.

    Args:
        places: of the points [m].
        inward: unit directions into the slots.
        z_m: height of the road.
        config: what makes a slot.
    """
    rows = [_row_of(k, places, inward, config) for k in range(len(places))]
    dividers = []
    for k, (place, row) in enumerate(zip(places, rows, strict=True)):
        is_along = len(row) > 1 and _least_gap_m(places[row]) >= config.parallel_m[0]
        length_m = float(np.mean(config.parallel_divider_m if is_along else config.depth_m))
        dividers.append(Divider(f"point_{k}", place, _direction(places[row], inward[row]), length_m, is_along, z_m))
    return dividers


def _least_gap_m(places: np.ndarray) -> float:
    away_m = np.linalg.norm(places[:, None] - places, axis=2)
    return float(away_m[away_m > 0.0].min(initial=np.inf))


def _row_of(k: int, places: np.ndarray, inward: np.ndarray, config: SlotConfig) -> Sequence[int]:
    """The points of the row of one: they point the same way and lie across it."""
    same = inward @ inward[k] > np.cos(np.deg2rad(_SAME_WAY_DEG))
    mean = inward[same].mean(axis=0)
    mean /= np.linalg.norm(mean)
    off_m = np.abs((places - places[k]) @ mean)
    away_m = np.linalg.norm(places - places[k], axis=1)
    sharpest = np.cos(np.deg2rad(config.least_angle_deg))
    return np.flatnonzero(same & (off_m < _ROW_M + sharpest * away_m)).tolist()


def _direction(places: np.ndarray, inward: np.ndarray) -> Float[np.ndarray, " 2"]:
    """Direction of the dividers of a row: across it where they are nearly so, else the mean of what is said."""
    mean = inward.mean(axis=0)
    mean = mean / np.linalg.norm(mean)
    if len(places) < 2:
        return mean
    row = np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2][0]
    across = np.array([-row[1], row[0]])
    across = across if across @ mean > 0 else -across
    return across if across @ mean > np.cos(np.deg2rad(_UPRIGHT_DEG)) else mean
