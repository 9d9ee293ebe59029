"""The plan of a garage or a lot: islands of slots, aisles around them, outer rows (room: simulation; host).

In: a random generator. Out: ParkingPlan. The map frame has its origin at the crossing of the lowest and the leftmost
aisle; aisles run along x and y.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from semloc_jax.simulation.slot_rows import LETTERS, SlotRow

ENTRY_M = 14.0
"""The way in: so far the lowest aisle reaches beyond the leftmost one."""
_ROUND_M = 1.0
"""Islands end so far before the edge of a crossing aisle: room to turn."""
_SKEW = np.pi / 3


@dataclass(frozen=True)
class ParkingPlan:
    """Where aisles and rows are.

    Args:
        aisle_m: width of the aisles.
        x_m: middles of the aisles along y, from the left.
        y_m: middles of the aisles along x, from below.
        rows: all rows of slots.
        backs: middle lines of islands, where two rows meet: begin, end and y.
        low_xy: corner of the floor.
        high_xy: its other corner.
    """

    aisle_m: float
    x_m: tuple[float, ...]
    y_m: tuple[float, ...]
    rows: tuple[SlotRow, ...]
    backs: tuple[tuple[float, float, float], ...]
    low_xy: tuple[float, float]
    high_xy: tuple[float, float]

    def blocks(self) -> list[tuple[float, float]]:
        """Where the islands between two aisles along y begin and end."""
        reach = 0.5 * self.aisle_m + _ROUND_M
        return [(a + reach, b - reach) for a, b in zip(self.x_m[:-1], self.x_m[1:], strict=True)]

    def row(self, name: str) -> SlotRow:
        """The row of a name."""
        return next(row for row in self.rows if row.name == name)


def plan_parking(rng: np.random.Generator, num_aisles: tuple[int, int], num_blocks: tuple[int, int]) -> ParkingPlan:
    """A seeded plan.

    Args:
        rng: everything follows from it.
        num_aisles: least and most aisles along x.
        num_blocks: least and most islands side by side.
    """
    aisle_m, pitch_m, depth_m = rng.uniform(6.0, 6.6), rng.uniform(2.4, 2.65), rng.uniform(5.0, 5.4)
    counts = rng.integers(8, 14, int(rng.integers(num_blocks[0], num_blocks[1] + 1)))
    num_y = int(rng.integers(num_aisles[0], num_aisles[1] + 1))
    x_m, y_m = [0.0], [(aisle_m + 2.0 * depth_m) * k for k in range(num_y)]
    for count in counts.tolist():
        x_m.append(x_m[-1] + aisle_m + 2.0 * _ROUND_M + count * pitch_m)
    rows: list[SlotRow] = []
    backs = []
    reach = 0.5 * aisle_m
    for block, count in enumerate(counts.tolist()):
        begin = x_m[block] + reach + _ROUND_M
        for k in range(num_y - 1):
            for corner_y, side in ((y_m[k] + reach, 1.0), (y_m[k + 1] - reach, -1.0)):
                # One slot fewer here and there: no two rows are the same.
                left = int(rng.integers(0, 2))
                corner = (begin + left * pitch_m, corner_y)
                rows.append(_row(rows, "perp", corner, 0.0, side, count - left, pitch_m, depth_m))
            backs.append((begin, begin + count * pitch_m, y_m[k] + reach + depth_m))
    outer = rng.permutation(["par", "ang", "perp", "par"] if num_y > 2 else ["ang", "par", "perp", "par"]).tolist()
    for block, count in enumerate(counts.tolist()):
        span = (x_m[block] + reach + _ROUND_M, count * pitch_m)
        for kind, corner_y, side in ((outer[0], y_m[0] - reach, -1.0), (outer[1], y_m[-1] + reach, 1.0)):
            rows += _outer(rows, kind, (span[0], corner_y), 0.0, side, span[1], pitch_m, depth_m)
    tall_m = y_m[-1] - y_m[0] - aisle_m
    for kind, corner_x, side in ((outer[2], x_m[0] - reach, 1.0), (outer[3], x_m[-1] + reach, -1.0)):
        rows += _outer(rows, kind, (corner_x, y_m[0] + reach), 0.5 * np.pi, side, tall_m, pitch_m, depth_m)
    places = np.vstack([row.outline(slot) for row in rows for slot in range(row.count)])
    low, high = places.min(axis=0) - 1.6, places.max(axis=0) + 1.6
    low[0] = min(low[0], x_m[0] - ENTRY_M)
    return ParkingPlan(aisle_m, tuple(x_m), tuple(y_m), tuple(rows), tuple(backs), _pair(low), _pair(high))


def _outer(
    rows: list[SlotRow],
    kind: str,
    corner: tuple[float, float],
    along_rad: float,
    side: float,
    length_m: float,
    pitch_m: float,
    depth_m: float,
) -> list[SlotRow]:
    """A row at the outer wall, as long as fits."""
    front_m, deep_m = {
        "perp": (pitch_m, depth_m),
        "par": (6.1, 2.35),
        "ang": (pitch_m / np.sin(_SKEW), depth_m * np.sin(_SKEW)),
    }[kind]
    lean_m = deep_m / np.tan(_SKEW) if kind == "ang" else 0.0
    count = int((length_m - lean_m) / front_m)
    return [_row(rows, kind, corner, along_rad, side, count, front_m, deep_m)] if count > 1 else []


def _row(
    rows: list[SlotRow],
    kind: str,
    corner: tuple[float, float],
    along_rad: float,
    side: float,
    count: int,
    pitch_m: float,
    depth_m: float,
) -> SlotRow:
    number = len(rows)
    name = LETTERS[number % len(LETTERS)] * (1 + number // len(LETTERS))
    return SlotRow(name, kind, _pair(np.array(corner)), along_rad, side, count, float(pitch_m), float(depth_m))


def _pair(xy: Float[np.ndarray, "2"]) -> tuple[float, float]:
    return float(xy[0]), float(xy[1])
