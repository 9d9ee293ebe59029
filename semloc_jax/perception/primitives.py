"""What a mask shows as few explicit shapes: lanes, signs, lamp posts (room: perception; host).

In: class ids of one camera, their class table. Out: Primitives: curves, outlines and lines in pixels, sub-pixel with
covariance. The image side of a compact map (Xiao 2018; MLVHM 2020).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.perception.class_table import ClassTable
from semloc_jax.perception.row_curves import RowCurve, RowCurveConfig, row_curve
from semloc_jax.perception.sign_outlines import OutlineConfig, SignOutline, sign_outline
from semloc_jax.structs import ElementClass

_RIM_PX = 2
HIDDEN_STEP_PX = 8


@dataclass(frozen=True)
class PrimitiveConfig:
    """What is taken for a shape. All values are ours."""

    curves: RowCurveConfig = field(default_factory=RowCurveConfig)
    outlines: OutlineConfig = field(default_factory=OutlineConfig)
    lane_px: int = 24
    """Pixels of a lane marking."""
    lamp_rows: int = 28
    """Height of a lamp post."""
    slender: float = 3.0
    """A lamp post is so many times higher than wide."""
    sag: float = 0.02
    """Most that its axis is bent, as a share of its height."""
    end_px: float = 1.5
    """Standard deviation of an end of a post along it."""


class LampLine(NamedTuple):
    """The axis of a post: from its lower to its upper end."""

    axis: RowCurve
    has_end: tuple[bool, bool]
    """Whether the lower and the upper end are its own: not cut by the image or by something before it."""
    end_sigma_px: float

    @property
    def rows(self) -> Float[np.ndarray, "2"]:
        """Rows of the lower and the upper end [px]: half a pixel beyond the last ones."""
        return np.array([self.axis.last + 0.5, self.axis.first - 0.5])


class Primitives(NamedTuple):
    """What one mask shows."""

    lanes: tuple[RowCurve, ...] = ()
    signs: tuple[SignOutline, ...] = ()
    lamps: tuple[LampLine, ...] = ()
    hidden: Bool[np.ndarray, "a b"] = np.zeros((0, 0), bool)
    """Where something moving, the vehicle itself or nothing known is: every eighth pixel of every eighth row."""

    def is_hidden(self, uv: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Whether something stands before places of the image."""
        if not self.hidden.size:
            return np.zeros(len(uv), bool)
        cell = np.clip(np.nan_to_num(uv) // HIDDEN_STEP_PX, 0, np.array(self.hidden.shape[::-1]) - 1).astype(int)
        return self.hidden[cell[:, 1], cell[:, 0]]


def primitives_of(
    mask: UInt8[np.ndarray, "h w"], table: ClassTable, config: PrimitiveConfig | None = None
) -> Primitives:
    """The shapes of one mask.

    Args:
        mask: Class ids.
        table: What they mean.
        config: None for the defaults.
    """
    config = config or PrimitiveConfig()
    hidden = np.isin(mask, table.unusable_ids)
    shown = {label: _shown(mask, table, label) for label in (_LANE, _SIGN, _LAMP)}
    lanes = [_lane(*part, config) for part in _parts(shown[_LANE], hidden, config.lane_px)]
    signs = [_sign(*part, config) for part in _parts(shown[_SIGN], hidden, config.outlines.min_px)]
    # A sign on a post cuts it in two.
    before = hidden | shown[_SIGN]
    lamps = [_lamp(*part, config) for part in _parts(shown[_LAMP], before, config.lamp_rows)]
    kept = (tuple(x for x in found if x is not None) for found in (lanes, signs, lamps))
    return Primitives(*kept, hidden[::HIDDEN_STEP_PX, ::HIDDEN_STEP_PX])


_LANE, _SIGN, _LAMP = ElementClass.LANE_MARKING, ElementClass.SIGN, ElementClass.POLE


def _shown(mask: np.ndarray, table: ClassTable, label: ElementClass) -> Bool[np.ndarray, "h w"]:
    channel = table.channel_of(label)
    if channel < 0:
        return np.zeros(mask.shape, bool)
    return np.isin(mask, table.channels[channel].mask_ids)


def _parts(
    shown: Bool[np.ndarray, "h w"], hidden: Bool[np.ndarray, "h w"], min_px: int
) -> list[tuple[np.ndarray, tuple[int, int], np.ndarray]]:
    """Every patch: its pixels in its box, the corner of the box, and where its border may be something else's."""
    if not shown.any():
        return []
    side = 2 * _RIM_PX + 1
    beside = cv2.dilate(hidden.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    beside[[0, -1], :] = beside[:, [0, -1]] = True
    num, labels, stats, _ = cv2.connectedComponentsWithStats(shown.astype(np.uint8), connectivity=8)
    found = []
    for index in range(1, num):
        x, y, width, height, area = (int(value) for value in stats[index])
        if area >= min_px:
            box = slice(y, y + height), slice(x, x + width)
            found.append((labels[box] == index, (x, y), beside[box]))
    return found


def _lane(patch, corner, beside, config: PrimitiveConfig) -> RowCurve | None:
    return row_curve(patch, corner, beside, config.curves)


def _sign(patch, corner, beside, config: PrimitiveConfig) -> SignOutline | None:
    if (patch & beside).any():  # cut: its border is not its own
        return None
    return sign_outline(patch, corner, config.outlines)


def _lamp(patch, corner, beside, config: PrimitiveConfig) -> LampLine | None:
    axis = row_curve(patch, corner, beside, config.curves, max_degree=2)
    if axis is None or axis.last - axis.first + 1 < config.lamp_rows:
        return None
    high_px = axis.last - axis.first + 1.0
    middle = np.array([0.5 * (axis.first + axis.last)])
    sag_px = abs(float(axis.bend(middle)[0])) * high_px**2 / 8.0 if len(axis.coefficients) > 2 else 0.0
    # A lens bends a post by little; an arm bends it by much.
    if high_px < config.slender * axis.width.mean() or sag_px > config.sag * high_px:
        return None
    # An end is that of the axis only where the patch ends there, too: an arm or a sign goes on.
    is_low = axis.last - corner[1] >= patch.shape[0] - 1 - _RIM_PX and not beside[-1][patch[-1]].any()
    is_high = axis.first - corner[1] <= _RIM_PX and not beside[0][patch[0]].any()
    return LampLine(axis, (bool(is_low), bool(is_high)), config.end_px)
