"""Which bright spots of a top view are paint on a road (room: perception; host).

In: PaintCandidates. Out: a mask of the spots that look like paint.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.perception.paint_candidates import PaintCandidates, PaintConfig
from semloc_jax.perception.point_groups import PointGroups

_RING_INNER_M, _RING_OUTER_M = 0.2, 0.8
_FEWEST_RING_PX = 8
"""Spots with less road around them are no paint."""


@dataclass(frozen=True)
class SpotMeasures:
    """What tells paint from bumpers, wheels and walls, arrays [spots]; brightness relative to the road around each."""

    stroke_m: np.ndarray
    """Widest stroke of the spot [m]."""
    ring_share: np.ndarray
    """Share of the ring around the spot that is visible and free of other spots."""
    contrast: np.ndarray
    """Excess of the spot's brightness."""
    ring_low: np.ndarray
    """5th percentile of the ring: tyres and shadows under vehicles pull it down."""
    ring_high: np.ndarray
    """95th percentile of the ring."""
    ring_spread: np.ndarray
    """10th to 90th percentile of the ring as a share of the spot's excess."""
    side_difference: np.ndarray
    """Difference between both sides of the spot as a share of its excess: an edge between two surfaces."""
    ring_chroma: np.ndarray
    """Largest |a|, |b| of the ring: roads are grey."""
    red_green: np.ndarray
    """Lab a of the spot."""
    yellow_blue: np.ndarray
    """Lab b of the spot."""

    @property
    def is_paint_on_road(self) -> np.ndarray:
        """True if the ring is an even grey road and the spot is a white or yellow stroke on it, bool[spots]."""
        # Bright paint has a halo in the ring.
        even_road = (self.ring_low > 0.75) & (self.ring_high < 1.18 + 0.1 * self.contrast) & (self.ring_chroma < 14.0)
        clear = (self.contrast > 0.12) & (self.ring_spread < 0.6) & (self.side_difference < 0.3)
        white_or_yellow = (self.red_green > -12.0) & (self.red_green < 18.0) & (self.yellow_blue > -14.0)
        return (self.ring_share >= 0.5) & even_road & clear & white_or_yellow


@dataclass(frozen=True)
class _Spot:
    """One spot and the road around it."""

    number: int
    window: tuple[slice, slice]
    """Rows and columns that hold both."""
    spot_vu: np.ndarray
    """Pixels of the spot in the top view, int[n 2]."""
    ring_vu: np.ndarray
    """Pixels of visible road without other spots around it, int[n 2]."""
    stroke_m: float
    ring_share: float


def keep_paint(candidates: PaintCandidates, top: np.ndarray, config: PaintConfig) -> np.ndarray:
    """The spots that are paint on the road, bool[h w].

    Args:
        top: top view, uint8[h w 3] BGR.
    """
    road = candidates.visible & (candidates.label == 0)
    disks = config.disk(_RING_OUTER_M), config.disk(_RING_INNER_M)
    spots = [_spot(candidates.label, road, number, box, disks, config) for number, box in candidates.boxes.items()]
    spots = [spot for spot in spots if len(spot.ring_vu) >= _FEWEST_RING_PX and spot.stroke_m <= config.max_width_m]
    accepted = np.zeros(candidates.label.max() + 1, bool)
    if not spots:
        return accepted[candidates.label]
    is_paint = _measures(spots, candidates.grey, top).is_paint_on_road
    accepted[[spot.number for spot, good in zip(spots, is_paint, strict=True) if good]] = True
    doubtful = [spot for spot, good in zip(spots, is_paint, strict=True) if not good]
    accepted[[spot.number for spot in doubtful if _joins_two(candidates.label, spot, accepted)]] = True
    return accepted[candidates.label]


def _spot(
    label: np.ndarray,
    road: np.ndarray,
    number: int,
    box: tuple[slice, slice],
    disks: tuple[np.ndarray, np.ndarray],
    config: PaintConfig,
) -> _Spot:
    """One spot with its ring of road, bool[h w]."""
    margin = round(_RING_OUTER_M / 2 / config.metres_per_px) + 2
    window = tuple(slice(max(side.start - margin, 0), side.stop + margin) for side in box)
    mask = (label[window] == number).astype(np.uint8)
    outer, inner = (cv2.dilate(mask, disk) for disk in disks)
    full = outer > inner
    padded = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    first = [side.start for side in window]
    ring_vu = np.argwhere(full & road[window])
    return _Spot(
        number,
        window,
        np.argwhere(mask > 0) + first,
        ring_vu + first,
        2.0 * config.metres_per_px * float(cv2.distanceTransform(padded, cv2.DIST_L2, 3).max()),
        len(ring_vu) / max(int(np.count_nonzero(full)), 1),
    )


def _joins_two(label: np.ndarray, spot: _Spot, accepted: np.ndarray) -> bool:
    """True for a piece of a line between two good ones: where it crosses the edge of a shadow its ring is uneven."""
    near = label[spot.window]
    good = accepted[near]
    if not good.any():
        return False
    around = cv2.dilate((near == spot.number).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return len(np.unique(near[around & good])) >= 2


def _measures(spots: list[_Spot], grey: np.ndarray, top: np.ndarray) -> SpotMeasures:
    """Measures of at least one spot.

    Args:
        spots: with their rings.
        grey: brightness, float32[h w].
        top: top view, uint8[h w 3] BGR.
    """
    rings, insides = (PointGroups([len(getattr(spot, name)) for spot in spots]) for name in ("ring_vu", "spot_vu"))
    ring_vu, spot_vu = (np.concatenate([getattr(spot, name) for spot in spots]) for name in ("ring_vu", "spot_vu"))
    centre, gradient = _slope(rings, ring_vu, grey[tuple(ring_vu.T)])
    around, inside = (
        grey[tuple(vu.T)] - ((vu - centre[of.number]) * gradient[of.number]).sum(axis=1)
        for of, vu in ((rings, ring_vu), (insides, spot_vu))
    )
    low, lower, road, upper, high = rings.quantiles(around, 0.05, 0.1, 0.5, 0.9, 0.95)
    road = np.maximum(road, 1.0)
    excess = np.maximum(insides.quantiles(inside, 0.7)[0] - road, 1.0)
    tint, paint_tint = (of.mean(_chroma(top, vu)) for of, vu in ((rings, ring_vu), (insides, spot_vu)))
    return SpotMeasures(
        stroke_m=np.array([spot.stroke_m for spot in spots]),
        ring_share=np.array([spot.ring_share for spot in spots]),
        contrast=excess / road,
        ring_low=low / road,
        ring_high=high / road,
        ring_spread=(upper - lower) / excess,
        side_difference=_side_difference(insides, spot_vu, rings, ring_vu, around) / excess,
        ring_chroma=np.abs(tint).max(axis=1),
        red_green=paint_tint[:, 0],
        yellow_blue=paint_tint[:, 1],
    )


def _chroma(top: np.ndarray, vu: np.ndarray) -> np.ndarray:
    """Lab a and b of pixels, float64[n 2]."""
    return cv2.cvtColor(top[tuple(vu.T)][None], cv2.COLOR_BGR2LAB)[0, :, 1:] - 128.0


def _slope(rings: PointGroups, vu: np.ndarray, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres and linear trends of the road's brightness, float[rings 2]: head lamps and shadows fade across a spot."""
    centre, level = rings.mean(vu), rings.mean(grey.astype(np.float64))
    offset = vu - centre[rings.number]
    squares = rings.total(offset[:, :, None] * offset[:, None, :]) + np.eye(2)
    products = rings.total(offset * (grey - level[rings.number])[:, None])
    return centre, np.linalg.solve(squares, products[..., None])[..., 0]


def _side_difference(
    insides: PointGroups, spot_vu: np.ndarray, rings: PointGroups, ring_vu: np.ndarray, around: np.ndarray
) -> np.ndarray:
    """Difference of the median brightness of the rings on the two long sides of their spots, 0 where one is missing."""
    centre = insides.mean(spot_vu)
    offset = spot_vu - centre[insides.number]
    across = np.linalg.eigh(insides.total(offset[:, :, None] * offset[:, None, :]))[1][..., 0]
    side = ((ring_vu - centre[rings.number]) * across[rings.number]).sum(axis=1)
    left, right = rings.median(around, side < 0), rings.median(around, side > 0)
    both = np.isfinite(left) & np.isfinite(right)
    return np.where(both, np.abs(np.where(both, left, 0.0) - np.where(both, right, 0.0)), 0.0)
