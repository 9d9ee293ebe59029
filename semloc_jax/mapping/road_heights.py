"""Height of the road around a vehicle, from where it drives before and after (room: mapping; host).

In: poses of a way, the profile of the road beside it. Out: RoadHeights, in the base frame of one pose.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from semloc_jax.mapping.road_profile import RoadProfile

_SWAY_M = 8.0
_NUM_KNOTS = 257
"""Places along the way at which heights are kept."""


@dataclass(frozen=True)
class RoadHeights:
    """Height of the road above the plane of the vehicle, from where it drives before and after.

    Attributes:
        ahead_m: `float64[k]` where wheels stand, along the base frame, ascending [m].
        left_m: `float64[k]` the same across it [m].
        height_m: `float64[k]` [m].
        bank: `float64[k]` slope across the way [m/m].
        beside_m: `float64[k m]` what the road is higher than that beside the way; None where it is as flat.
        beside_left_m: `float64[m]` at these distances to the left of the way, evenly apart [m].
    """

    ahead_m: Float[np.ndarray, " k"]
    left_m: Float[np.ndarray, " k"]
    height_m: Float[np.ndarray, " k"]
    bank: Float[np.ndarray, " k"]
    beside_m: Float[np.ndarray, "k m"] | None = None
    beside_left_m: Float[np.ndarray, " m"] | None = None

    @classmethod
    def of(
        cls, Ts_map_base: Float[np.ndarray, "n 4 4"], index: int, reach_m: float, profile: RoadProfile | None = None
    ) -> "RoadHeights":
        """The road around one pose of a drive.

        Args:
            Ts_map_base: every pose of the drive.
            index: which one.
            reach_m: poses farther along the way do not count.
            profile: of the road beside these poses; None where it is as flat as the lane.
        """
        T = Ts_map_base[index]
        away_m = np.linalg.norm(Ts_map_base[:, :2, 3] - T[:2, 3], axis=1)
        first, last = index, index
        while first > 0 and away_m[first - 1] < reach_m and index - first < len(away_m):
            first -= 1
        while last < len(away_m) - 1 and away_m[last + 1] < reach_m:
            last += 1
        near = np.linalg.inv(T) @ Ts_map_base[first : last + 1]
        forward = near[:, 0, 0] > 0.5
        rows, near = np.arange(first, last + 1)[forward], near[forward]
        order = np.argsort(near[:, 0, 3], kind="stable")
        rows, near = rows[order], near[order]
        keep = np.append(True, np.diff(near[:, 0, 3]) > 0.05)
        rows, near = rows[keep], near[keep]
        # Past the last pose the road goes on as it lies there.
        slope = -near[[0, -1], 2, 0] / np.maximum(near[[0, -1], 0, 0], 0.5) * [1.0, -1.0]
        ends = near[[0, -1], 0, 3] + [-reach_m, reach_m]
        heights = np.concatenate(
            [[near[0, 2, 3] + slope[0] * reach_m], near[:, 2, 3], [near[-1, 2, 3] + slope[1] * reach_m]]
        )
        bank = _averaged(near[:, 2, 1] / np.maximum(near[:, 1, 1], 0.5), near[:, 0, 3])
        return cls(
            np.concatenate([ends[:1], near[:, 0, 3], ends[1:]]),
            np.concatenate([near[:1, 1, 3], near[:, 1, 3], near[-1:, 1, 3]]),
            heights,
            np.concatenate([bank[:1], bank, bank[-1:]]),
            None if profile is None else profile.height_m[[rows[0], *rows, rows[-1]]],
            None if profile is None else profile.left_m,
        )

    def at(self, xy_base: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Height of the road at places [m]."""
        start, step, values, slopes = self._table
        at = np.clip((xy_base[:, 0] - start) / step, 0, len(values[0]) - 1.001)
        row = at.astype(np.int32)
        share = at - row
        height_m, bank, left_m = (value[row] + share * slope[row] for value, slope in zip(values, slopes, strict=True))
        beside_m = xy_base[:, 1] - left_m
        if self.beside_m is None:
            return height_m + bank * beside_m
        return height_m + bank * beside_m + RoadProfile(self.beside_left_m, self._beside).at(row, beside_m)

    @cached_property
    def _beside(self) -> Float[np.ndarray, "257 m"]:
        """Heights beside the way every step along it."""
        knots = np.linspace(self.ahead_m[0], self.ahead_m[-1], _NUM_KNOTS)
        return np.stack(
            [np.interp(knots, self.ahead_m, column) for column in self.beside_m.T], axis=1, dtype=np.float32
        )

    @cached_property
    def _table(self) -> tuple[np.float32, np.float32, np.ndarray, np.ndarray]:
        """First place and step along the way [m]; height, bank and side every step, and by how much they grow."""
        knots = np.linspace(self.ahead_m[0], self.ahead_m[-1], _NUM_KNOTS)
        columns = [np.interp(knots, self.ahead_m, values) for values in (self.height_m, self.bank, self.left_m)]
        return np.float32(knots[0]), np.float32(knots[1] - knots[0]), *_with_growth(np.stack(columns))


def _with_growth(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return rows.astype(np.float32), np.diff(rows, axis=1, append=rows[:, -1:]).astype(np.float32)


def _averaged(values: np.ndarray, at_m: np.ndarray) -> np.ndarray:
    """Values averaged over the way around each: a vehicle sways on its springs, the road below does not."""
    near = np.exp(-0.5 * ((at_m[:, None] - at_m) / _SWAY_M) ** 2)
    return near @ values / near.sum(axis=1)
