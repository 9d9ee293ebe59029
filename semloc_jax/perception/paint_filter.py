"""Which bright spots of a top view are paint on a road (room: perception; host).

In: PaintCandidates. Out: a mask of the spots that look like paint.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.perception.paint_candidates import PaintCandidates, PaintConfig

_RING_INNER_M, _RING_OUTER_M = 0.2, 0.8


@dataclass(frozen=True)
class SpotMeasures:
    """What tells paint from bumpers, wheels and walls; brightness relative to the road around the spot."""

    stroke_m: float
    """Widest stroke of the spot [m]."""
    ring_share: float
    """Share of the ring around the spot that is visible and free of other spots."""
    contrast: float
    """Excess of the spot's brightness."""
    ring_low: float
    """5th percentile of the ring: tyres and shadows under vehicles pull it down."""
    ring_high: float
    """95th percentile of the ring."""
    ring_spread: float
    """10th to 90th percentile of the ring as a share of the spot's excess."""
    side_difference: float
    """Difference between both sides of the spot as a share of its excess: an edge between two surfaces."""
    ring_chroma: float
    """Largest |a|, |b| of the ring: roads are grey."""
    red_green: float
    """Lab a of the spot."""
    yellow_blue: float
    """Lab b of the spot."""

    @property
    def is_paint_on_road(self) -> bool:
        """True if the ring is an even grey road and the spot is a white or yellow stroke on it."""
        # Bright paint has a halo in the ring.
        even_road = self.ring_low > 0.75 and self.ring_high < 1.18 + 0.1 * self.contrast and self.ring_chroma < 14.0
        clear = self.contrast > 0.12 and self.ring_spread < 0.6 and self.side_difference < 0.3
        white_or_yellow = -12.0 < self.red_green < 18.0 and self.yellow_blue > -14.0
        return self.ring_share >= 0.5 and even_road and clear and white_or_yellow


def keep_paint(candidates: PaintCandidates, top: np.ndarray, config: PaintConfig) -> np.ndarray:
    """The spots that are paint on the road, bool[h w].

    Args:
        top: top view, uint8[h w 3] BGR.
    """
    chroma = cv2.cvtColor(top, cv2.COLOR_BGR2LAB)[..., 1:].astype(np.float32) - 128.0
    margin = round(_RING_OUTER_M / 2 / config.metres_per_px) + 2
    accepted, doubtful = set(), []
    for number, box in candidates.boxes.items():
        rows, columns = (slice(max(side.start - margin, 0), side.stop + margin) for side in box)
        spot = candidates.label[rows, columns] == number
        others = (candidates.label[rows, columns] > 0) & ~spot
        free = candidates.visible[rows, columns] & ~others
        measured = measure_spot(spot, free, candidates.grey[rows, columns], chroma[rows, columns], config)
        if measured is None or measured.stroke_m > config.max_width_m:
            continue
        if measured.is_paint_on_road:
            accepted.add(number)
        else:
            doubtful.append((number, rows, columns))
    accepted |= {piece[0] for piece in doubtful if _joins_two(candidates.label, piece, accepted)}
    return np.isin(candidates.label, sorted(accepted)) & (candidates.label > 0)


def _joins_two(label: np.ndarray, piece: tuple[int, slice, slice], accepted: set[int]) -> bool:
    """True for a piece of a line between two good ones: where it crosses the edge of a shadow its ring is uneven."""
    number, rows, columns = piece
    around = cv2.dilate((label[rows, columns] == number).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return len(accepted & set(np.unique(label[rows, columns][around]).tolist())) >= 2


def measure_spot(
    spot: np.ndarray, free: np.ndarray, grey: np.ndarray, chroma: np.ndarray, config: PaintConfig
) -> SpotMeasures | None:
    """Measures of one spot; None if no road is seen around it.

    Args:
        spot: the spot, bool[h w].
        free: visible pixels that belong to no other spot, bool[h w].
        grey: brightness, float32[h w].
        chroma: Lab a and b, float32[h w 2].
    """
    mask = spot.astype(np.uint8)
    wide = cv2.dilate(mask, config.disk(_RING_OUTER_M)) > 0
    full = wide & (cv2.dilate(mask, config.disk(_RING_INNER_M)) == 0)
    ring = full & free
    if ring.sum() < 8:
        return None
    level = grey - _slope(grey, ring)
    around, inside = level[ring], level[spot]
    low, road, high = np.percentile(around, [5, 50, 95])
    road = max(float(road), 1.0)
    excess = max(float(np.percentile(inside, 70)) - road, 1.0)
    padded = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    spread = np.subtract(*np.percentile(around, [90, 10]))
    tint, paint_tint = np.abs(chroma[ring].mean(axis=0)), chroma[spot].mean(axis=0)
    return SpotMeasures(
        stroke_m=2.0 * config.metres_per_px * float(cv2.distanceTransform(padded, cv2.DIST_L2, 3).max()),
        ring_share=float(ring.sum() / full.sum()),
        contrast=excess / road,
        ring_low=float(low) / road,
        ring_high=float(high) / road,
        ring_spread=float(spread) / excess,
        side_difference=_side_difference(spot, ring, level) / excess,
        ring_chroma=float(tint.max()),
        red_green=float(paint_tint[0]),
        yellow_blue=float(paint_tint[1]),
    )


def _slope(grey: np.ndarray, ring: np.ndarray) -> np.ndarray:
    """Linear trend of the road's brightness without its mean, [h w]: head lamps and shadows fade across a spot."""
    v, u = np.nonzero(ring)
    offset = np.stack([u - u.mean(), v - v.mean()], axis=-1)
    gradient = np.linalg.solve(offset.T @ offset + np.eye(2), offset.T @ (grey[ring] - grey[ring].mean()))
    rows, columns = np.arange(grey.shape[0]) - v.mean(), np.arange(grey.shape[1]) - u.mean()
    return gradient[1] * rows[:, None] + gradient[0] * columns[None, :]


def _side_difference(spot: np.ndarray, ring: np.ndarray, grey: np.ndarray) -> float:
    """Difference of the median brightness on the two long sides of a spot."""
    v, u = np.nonzero(spot)
    centre = np.array([u.mean(), v.mean()])
    offset = np.stack([u, v], axis=-1) - centre
    across = np.linalg.eigh(offset.T @ offset)[1][:, 0]
    ring_v, ring_u = np.nonzero(ring)
    side = (np.stack([ring_u, ring_v], axis=-1) - centre) @ across
    values = grey[ring]
    if not (side > 0).any() or not (side < 0).any():
        return 0.0
    return float(abs(np.median(values[side > 0]) - np.median(values[side < 0])))
