"""The outline of a sign in a mask as a triangle, a rectangle or a circle (room: perception; host).

In: one patch of a mask. Out: SignOutline: sub-pixel corners with covariance, or centre and radius.
Each side is a line through the pixels of its border, and corners are where two sides meet.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

_FINE = 5
"""A border is followed on pixels so many times as fine."""
_INSIDE_PX = 0.5 / _FINE
SignShape = Literal["triangle", "rectangle", "circle", "patch"]


@dataclass(frozen=True)
class OutlineConfig:
    """When a patch has a shape. All values are ours."""

    min_px: int = 20
    shape_px: int = 90
    """A smaller patch shows its place but no shape."""
    min_overlap: float = 0.88
    """Of patch and shape (intersection over union)."""
    clearly: float = 0.02
    """By so much the overlap of the best shape is better than that of any other."""
    border_px: float = 0.5
    """Standard deviation of a border in a mask."""
    together_px: float = 8.0
    """Errors of a border over such a way are alike."""
    corner_share: float = 0.12
    """Share of a side next to a corner that is left out: masks round corners off."""


class SignOutline(NamedTuple):
    """A sign in one image."""

    shape: SignShape
    """patch: its place is known, its shape is not."""
    corners: Float[np.ndarray, "k 2"]
    """In the order of the outline [px]; none for circles and patches."""
    covariance: Float[np.ndarray, "k 2 2"]
    centre: Float[np.ndarray, "2"]
    centre_sigma_px: float
    radius_px: float
    """Longer half axis of a circle, half the root of the area of a patch."""
    area_px: float


def sign_outline(
    patch: Bool[np.ndarray, "h w"], corner: tuple[int, int], config: OutlineConfig | None = None
) -> SignOutline | None:
    """The outline of a patch; None where it is too small.

    Args:
        patch: Pixels of one sign, cut out of the mask.
        corner: Column and row of its first pixel in the mask.
        config: None for the defaults.
    """
    config = config or OutlineConfig()
    area = float(patch.sum())
    if area < config.min_px:
        return None
    origin = np.array(corner, np.float64)
    rows, columns = np.nonzero(patch)
    centre = np.array([columns.mean(), rows.mean()]) + origin
    around = _border(patch)
    sigma = config.border_px * np.sqrt(config.together_px * _FINE / max(len(around), 1)) + 0.2
    plain = SignOutline("patch", np.zeros((0, 2)), np.zeros((0, 2, 2)), centre, float(sigma), 0.5 * np.sqrt(area), area)
    if area < config.shape_px:
        return plain
    shapes = {"triangle": _polygon(around, 3, config), "rectangle": _polygon(around, 4, config)}
    overlap = {name: _overlap(patch, found[0]) for name, found in shapes.items() if found is not None}
    ellipse = cv2.fitEllipse(around.astype(np.float32)) if len(around) >= 5 else None
    if ellipse is not None:
        overlap["circle"] = _overlap(patch, _ring(ellipse))
    ranked = sorted(overlap.items(), key=lambda item: -item[1])
    if not ranked or ranked[0][1] < config.min_overlap:
        return plain
    if len(ranked) > 1 and ranked[0][1] - ranked[1][1] < config.clearly:
        return plain
    name = ranked[0][0]
    if name == "circle":
        (x, y), axes, _ = ellipse
        return plain._replace(shape="circle", centre=np.array([x, y]) + origin, radius_px=0.5 * max(axes) + _INSIDE_PX)
    corners, covariance = shapes[name]
    return plain._replace(shape=name, corners=corners + origin, covariance=covariance)


def _border(patch: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "n 2"]:
    """The border of a patch in order, `_INSIDE_PX` inside of where its outermost pixels end."""
    fine = np.kron(np.pad(patch, 1), np.ones((_FINE, _FINE), bool)).astype(np.uint8)
    contours, _ = cv2.findContours(fine, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    longest = max(contours, key=len)[:, 0].astype(np.float64)
    return (longest - _FINE // 2) / _FINE - 1.0


def _polygon(border: Float[np.ndarray, "n 2"], num: int, config: OutlineConfig) -> tuple[np.ndarray, np.ndarray] | None:
    """Corners of the polygon of so many sides along a border, and their covariances."""
    start = _first_corners(border, num)
    if start is None:
        return None
    sides = []
    for k in range(num):
        a, b = start[k], start[(k + 1) % num]
        line = _side(border, a, b, config)
        if line is None:
            return None
        sides.append(line)
    corners, covariance = [], []
    for k in range(num):
        met = _met(sides[k - 1], sides[k])
        if met is None or np.linalg.norm(met[0] - start[k]) > 0.3 * np.linalg.norm(start[k] - start[k - 1]) + 2.0:
            return None
        corners.append(met[0])
        covariance.append(met[1])
    return np.array(corners), np.array(covariance)


def _first_corners(uv: np.ndarray, num: int) -> np.ndarray | None:
    """The smallest triangle, or the four farthest corners of the hull."""
    points = uv.astype(np.float32)
    if num == 3:
        _, found = cv2.minEnclosingTriangle(points)
        return None if found is None else found.reshape(-1, 2).astype(np.float64)
    hull = cv2.convexHull(points)
    for share in (0.02, 0.04, 0.06, 0.08, 0.1, 0.13):
        found = cv2.approxPolyDP(hull, share * cv2.arcLength(hull, True), True)
        if len(found) == num:
            return found.reshape(-1, 2).astype(np.float64)
    return None


class _Side(NamedTuple):
    """A line n . x = d through the border, with the covariance of (angle, d) at its middle."""

    middle: np.ndarray
    normal: np.ndarray
    variance_across: float
    variance_angle: float


def _side(uv: np.ndarray, a: np.ndarray, b: np.ndarray, config: OutlineConfig) -> _Side | None:
    length = float(np.linalg.norm(b - a))
    if length < 3.0:
        return None
    along = (b - a) / length
    off = uv - a
    at, across = off @ along, off @ np.array([-along[1], along[0]])
    own = (at > config.corner_share * length) & (at < (1 - config.corner_share) * length)
    own &= np.abs(across) < 0.12 * length + 1.5
    if own.sum() < 6:
        return None
    points = uv[own]
    middle = points.mean(axis=0)
    spread, axes = np.linalg.eigh((points - middle).T @ (points - middle) / len(points))
    outward = axes[:, 0] * np.sign(axes[:, 0] @ (middle - uv.mean(axis=0)))
    alike = config.together_px / max(length, config.together_px)
    variance = max(float(spread[0]), config.border_px**2) * alike
    return _Side(middle + _INSIDE_PX * outward, outward, variance, variance / max(float(spread[1]), 1e-9))


def _met(first: _Side, second: _Side) -> tuple[np.ndarray, np.ndarray] | None:
    """Where two sides meet, with covariance."""
    N = np.stack([first.normal, second.normal])
    if abs(np.linalg.det(N)) < 0.2:
        return None
    place = np.linalg.solve(N, [first.normal @ first.middle, second.normal @ second.middle])
    spread = [
        side.variance_across + side.variance_angle * float(np.sum((place - side.middle) ** 2))
        for side in (first, second)
    ]
    inverse = np.linalg.inv(N)
    return place, inverse @ np.diag(spread) @ inverse.T


def _ring(ellipse: tuple) -> np.ndarray:
    (x, y), (a, b), angle_deg = ellipse
    t = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    p = np.stack([0.5 * a * np.cos(t), 0.5 * b * np.sin(t)])
    return (np.array([[c, -s], [s, c]]) @ p).T + [x, y]


def _overlap(patch: np.ndarray, outline: np.ndarray) -> float:
    """Intersection over union of a patch and the inside of a convex outline, by the centres of pixels."""
    pad = 4
    own = np.pad(patch, pad)
    v, u = np.indices(own.shape)
    inside = np.ones(own.shape, bool)
    turn = np.sign(_twice_area(outline))
    for a, b in zip(outline + pad, np.roll(outline, -1, axis=0) + pad, strict=True):
        inside &= turn * ((b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0])) >= 0.0
    return float((own & inside).sum() / max((own | inside).sum(), 1))


def _twice_area(outline: np.ndarray) -> float:
    following = np.roll(outline, -1, axis=0)
    return float(np.sum(outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]))
