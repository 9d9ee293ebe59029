"""How slots are painted in several countries: lines and marking points of rows of slots (room: simulation; host).

In: a random generator, the size of the view. Out: Layout: quadrilaterals of paint, MarkingPoint list. Places are metres
from the upper left corner of the picture, u to the right and v down.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_STYLES = ("box", "open", "bars", "double", "corners")
_STYLE_SHARES = (0.36, 0.14, 0.34, 0.08, 0.08)
"""Closed boxes (most of Asia), dividers alone (North America), T bars (Europe), hairpins, marks at corners only."""
_KINDS = ("perpendicular", "parallel", "angled")
_KIND_SHARES = (0.54, 0.3, 0.16)
_PARALLEL_BACK = 0.7
"""Slots along the aisle mostly end at a line beside a wall or a curb."""
_ENDS_SHARE = 0.45
"""Rows that end near the middle of the view, each way: only what is around an L tells the divider from the entrance."""


class MarkingPoint(NamedTuple):
    """Where the mouth of a divider is.

    Args:
        uv_m: its place.
        yaw_rad: direction into the slot, from u towards v.
        is_corner: L, a slot on one side only; else T.
    """

    uv_m: Float[np.ndarray, " 2"]
    yaw_rad: float
    is_corner: bool


class DividerBack(NamedTuple):
    """Far end of a divider: it looks like a mouth where nothing tells which end is which.

    Args:
        uv_m: its place.
        mouth_m: the mouth of the divider where its paint differs from that of the back; None where both ends are alike.
    """

    uv_m: Float[np.ndarray, " 2"]
    mouth_m: Float[np.ndarray, " 2"] | None


@dataclass
class Layout:
    """What is painted.

    Attributes:
        quads: `float64[4 2]` each, painted areas.
        points: marking points.
        backs: far ends of dividers.
        slots: `float64[4 2]` each, corners of slots, the entrance first.
        along: unit vector along the aisle.
    """

    quads: list[Float[np.ndarray, "4 2"]] = field(default_factory=list)
    points: list[MarkingPoint] = field(default_factory=list)
    backs: list[DividerBack] = field(default_factory=list)
    slots: list[Float[np.ndarray, "4 2"]] = field(default_factory=list)
    along: Float[np.ndarray, " 2"] = field(default_factory=lambda: np.array([1.0, 0.0]))

    def line(self, start: np.ndarray, end: np.ndarray, width_m: float) -> None:
        """Paint a straight line."""
        step = end - start
        aside = 0.5 * width_m * np.array([-step[1], step[0]]) / max(float(np.linalg.norm(step)), 1e-9)
        self.quads.append(np.array([start + aside, end + aside, end - aside, start - aside]))


@dataclass(frozen=True)
class _Style:
    name: str
    width_m: float
    pitch_m: float
    depth_m: float
    skew_rad: float
    bar_m: float
    gap_m: float
    has_back: bool
    is_dashed: bool

    @property
    def is_alike(self) -> bool:
        """Whether both ends of a divider look the same: a line across both, or across none."""
        return (self.name, self.has_back) in (("box", True), ("open", False))


def random_layout(rng: np.random.Generator, size_m: float) -> Layout:
    """One row of slots, or two across an aisle, at any angle.

    Args:
        rng: all that is random.
        size_m: side of the view.
    """
    layout, angle = Layout(), rng.uniform(-np.pi, np.pi)
    layout.along = np.array([np.cos(angle), np.sin(angle)])
    inward = np.array([-layout.along[1], layout.along[0]])
    middle = size_m * rng.uniform(0.25, 0.75, 2)
    style = _random_style(rng)
    _row(layout, style, middle, layout.along, inward, rng, size_m)
    if rng.random() < 0.7:
        aisle_m = rng.uniform(3.0, 6.5)
        other = style if rng.random() < 0.7 else _random_style(rng)
        start = middle - aisle_m * inward + rng.uniform(-3.0, 3.0) * layout.along
        _row(layout, other, start, -layout.along, -inward, rng, size_m)
    return layout


def _random_style(rng: np.random.Generator) -> _Style:
    kind = rng.choice(_KINDS, p=_KIND_SHARES)
    name = str(rng.choice(_STYLES, p=_STYLE_SHARES))
    is_parallel = kind == "parallel"
    depth_m = rng.uniform(1.9, 2.6) if is_parallel else rng.uniform(4.4, 5.8)
    skew = np.deg2rad(rng.uniform(25.0, 50.0)) * rng.choice([-1.0, 1.0]) if kind == "angled" else 0.0
    across_m = rng.uniform(4.8, 6.8) if is_parallel else rng.uniform(2.15, 3.0)
    return _Style(
        name,
        float(rng.uniform(0.07, 0.2)),
        float(across_m / np.cos(skew)),
        float(depth_m),
        float(skew + rng.normal(0.0, 0.01)),
        float(rng.uniform(0.35, 1.6)),
        float(rng.uniform(0.22, 0.5)),
        bool(rng.random() < (_PARALLEL_BACK if is_parallel else 0.5)),
        bool(rng.random() < 0.12),
    )


def _row(
    layout: Layout,
    style: _Style,
    start: np.ndarray,
    along: np.ndarray,
    inward: np.ndarray,
    rng: np.random.Generator,
    size_m: float,
) -> None:
    """The dividers of a row, with the entrance to it; a row may end within the view."""
    num = int(np.ceil(2.0 * size_m / style.pitch_m)) + 1
    first, last = -num, num
    if rng.random() < _ENDS_SHARE:
        first = -int(rng.integers(0, 2))
    if rng.random() < _ENDS_SHARE:
        last = max(first, -2) + int(rng.integers(1, 5))
    c, s = np.cos(style.skew_rad), np.sin(style.skew_rad)
    into = c * inward + s * along
    length_m = style.depth_m / c
    mouths = [start + k * style.pitch_m * along for k in range(first, last + 1)]
    layout.slots += [np.array([a, b, b + length_m * into, a + length_m * into]) for a, b in pairwise(mouths)]
    layout.backs += [DividerBack(mouth + length_m * into, None if style.is_alike else mouth) for mouth in mouths]
    yaw = float(np.arctan2(into[1], into[0]))
    for k, mouth in enumerate(mouths):
        is_end = k in (0, len(mouths) - 1)
        side = 0.0 if not is_end else 1.0 if k == 0 else -1.0
        layout.points.append(MarkingPoint(mouth, yaw, is_end and style.name != "open"))
        _divider(layout, style, mouth, into, length_m, along, side)
    if style.name == "box":
        ends = 0.5 * style.width_m * along
        _entrance(layout, mouths[0] - ends, mouths[-1] + ends, style)
    if style.has_back and style.name in ("box", "bars", "open"):
        layout.line(mouths[0] + length_m * into, mouths[-1] + length_m * into, style.width_m)


def _divider(
    layout: Layout,
    style: _Style,
    mouth: np.ndarray,
    into: np.ndarray,
    length_m: float,
    along: np.ndarray,
    side: float,
) -> None:
    """One divider and the bar across its mouth; `side` is where the only slot of an end is along the row."""
    if style.name == "double":
        for shift in (-0.5, 0.5):
            layout.line(
                mouth + shift * style.gap_m * along,
                mouth + shift * style.gap_m * along + length_m * into,
                style.width_m,
            )
        ends = 0.5 * (style.gap_m + style.width_m) * along
        layout.line(mouth - ends, mouth + ends, style.width_m)
        return
    own_m = min(0.6 * style.bar_m, 1.0) if style.name == "corners" else length_m
    layout.line(mouth, mouth + own_m * into, style.width_m)
    if style.name in ("bars", "corners"):
        half = 0.5 * style.bar_m * along
        low, high = (0.0 if side > 0 else 1.0), (0.0 if side < 0 else 1.0)
        rim = 0.5 * style.width_m * along
        layout.line(mouth - low * half - rim, mouth + high * half + rim, style.width_m)


def _entrance(layout: Layout, start: np.ndarray, end: np.ndarray, style: _Style) -> None:
    """The line at the aisle, whole or dashed."""
    if not style.is_dashed:
        layout.line(start, end, style.width_m)
        return
    length_m = float(np.linalg.norm(end - start))
    step = (end - start) / length_m
    for at in np.arange(0.0, length_m, 2.0 * style.bar_m):
        layout.line(start + at * step, start + min(at + style.bar_m, length_m) * step, style.width_m)
