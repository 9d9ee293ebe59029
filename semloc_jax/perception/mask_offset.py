"""The sub-pixel offset between masks and their images (room: perception; host).

In: images and masks of several frames. Out: MaskOffset, which Camera.shifted takes.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.perception.class_table import ClassTable
from semloc_jax.perception.distance import signed_distance
from semloc_jax.structs import ElementClass

_PAINT = {
    ElementClass.LANE_MARKING,
    ElementClass.STOP_LINE,
    ElementClass.CROSSWALK,
    ElementClass.ROAD_MARK,
    ElementClass.SLOT_LINE,
}
_SHARP = _PAINT | {ElementClass.POLE, ElementClass.SIGN, ElementClass.TRAFFIC_LIGHT, ElementClass.PILLAR}
"""Classes whose outline is an edge of the image; that of a curb or guardrail often is not."""
_BLUR_PX = 1.5
_REACH_PX = 5.0
_STEP_PX = 0.25
_AROUND_PX = 16
"""So far around paint a mask is looked at: farther than the filters of a distance at its border reach."""
_POINTS_PER_LAYER = 1500
_MIN_POINTS = 200
_TILE_PX = 48
_NUM_GROUPS = 4
_MOST_DISAGREEMENT_PX = 0.5
"""Groups of frames of one network differ by up to 0.46 px, those with chance edges beside thin paint by 2."""
_MIN_GROUP_POINTS = 20
_MIN_CONTRAST = 2.0
"""Least gradient of an image edge that counts [grey levels / px]."""


class MaskOffset(NamedTuple):
    """What is at uv in the image is at uv + (du_px, dv_px) in the mask; `camera.shifted(*offset[:2])` sees the mask."""

    du_px: float
    dv_px: float
    sigma_du_px: float
    """Standard error, points of one place counted once [px]."""
    sigma_dv_px: float
    num_points: int
    """Boundary points that found their edge in the image."""
    disagreement_px: float
    """Farthest that one of some groups of frames, each on its own, is from the whole [px]; infinite where one group
    says nothing."""

    @property
    def is_agreed(self) -> bool:
        """True if all groups of frames say so: what makes masks lie off is in every frame, grass beside a line not."""
        return self.disagreement_px <= _MOST_DISAGREEMENT_PX

    @property
    def is_significant(self) -> bool:
        """True if all groups agree and a direction is off by 3 sigma and more than shading feigns: 0.25 px."""
        if not self.is_agreed:
            return False
        pairs = ((self.du_px, self.sigma_du_px), (self.dv_px, self.sigma_dv_px))
        return any(abs(value) > max(0.25, 3.0 * sigma) for value, sigma in pairs)


class _Edges(NamedTuple):
    """Mask boundary points with the image gradient across them."""

    normal: np.ndarray
    """Outward unit normal of the mask [n 2]."""
    gradient: np.ndarray
    """Strength of the image edge at each place of the profile along the normal [n k]."""
    layer: np.ndarray
    """Channel index [n]."""
    cluster: np.ndarray
    """Number of the image tile and frame [n]."""


def estimate_mask_offset(images: Sequence[np.ndarray], masks: Sequence[np.ndarray], table: ClassTable) -> MaskOffset:
    """The offset of masks against images, as networks of reduced resolution leave it, with its standard error.

    Along the normal n of each mask boundary the image edge is found at t; over all points t = e_c - n . (du, dv) is
    solved robustly, where e_c is the erosion of channel c, which moves opposite sides apart and the offset does not.

    Args:
        images: uint8[h w] or uint8[h w 3], of the size of the masks; ten frames or more of one camera.
        masks: class ids, uint8[h w], of the same frames.
        table: class table of the masks.

    Raises:
        SemlocError: numbers or sizes differ, or too few mask boundaries have an edge in the image.
    """
    if len(images) != len(masks) or len(images) == 0:
        raise SemlocError(f"mask offset: given {len(images)} images and {len(masks)} masks, expected pairs")
    sharp = [index for index, channel in enumerate(table.channels) if _SHARP & set(channel.classes)]
    groups: list[list[_Edges]] = [[] for _ in range(min(_NUM_GROUPS, max(len(images), 2)))]
    for frame, (image, mask) in enumerate(zip(images, masks, strict=True)):
        if image.shape[:2] != mask.shape:
            sizes = f"{image.shape[1]}x{image.shape[0]} and {mask.shape[1]}x{mask.shape[0]}"
            raise SemlocError(f"mask offset: image and mask {frame} have the sizes {sizes} px; resize the masks first")
        groups[frame % len(groups)] += _frame_edges(image, mask, table, sharp, frame)
    parts = [part for group in groups for part in group]
    num_found = sum(len(part.layer) for part in parts)
    if num_found < _MIN_POINTS:
        raise SemlocError(
            f"mask offset: only {num_found} mask boundary points to compare with the image, {_MIN_POINTS} are needed; "
            "give more frames, or frames with paint and poles in view"
        )
    whole = _solve(parts, _MIN_POINTS)
    return whole._replace(disagreement_px=max(_distance_px(group, whole) for group in groups))


def offsets_of_cameras(
    found: Mapping[str, MaskOffset | None], size_px: Mapping[str, tuple[int, int]]
) -> dict[str, tuple[float, float]]:
    """The offset (du, dv) [px] of each camera's masks that have one.

    A camera whose own frames do not agree takes what the others of its size say: one network made the masks.

    Args:
        found: by camera; None where its frames show none.
        size_px: (width, height) of its masks.
    """
    sure = {camera: offset for camera, offset in found.items() if offset is not None and offset.is_significant}
    offsets = {camera: (offset.du_px, offset.dv_px) for camera, offset in sure.items()}
    for camera, offset in found.items():
        if camera not in sure and (offset is None or not offset.is_agreed):
            others = [other[:2] for name, other in sure.items() if size_px[name] == size_px[camera]]
            offsets |= {camera: _mean(others)} if _agree(others) else {}
    return offsets


def _agree(shifts: list[tuple[float, float]]) -> bool:
    """Whether several cameras have about the same offset [px]."""
    if len(shifts) < 2:
        return False
    away_px = np.subtract(shifts, np.mean(shifts, axis=0))
    return bool(np.hypot(*away_px.T).max() <= _MOST_DISAGREEMENT_PX)


def _mean(shifts: list[tuple[float, float]]) -> tuple[float, float]:
    du_px, dv_px = np.mean(shifts, axis=0).tolist()
    return du_px, dv_px


def _distance_px(parts: list["_Edges"], whole: MaskOffset) -> float:
    """How far the offset that some frames say on their own is from that of all [px]; infinite where they say none."""
    if sum(len(part.layer) for part in parts) < _MIN_GROUP_POINTS:
        return np.inf
    try:
        alone = _solve(parts, _MIN_GROUP_POINTS)
    except SemlocError:
        return np.inf
    return float(np.hypot(alone.du_px - whole.du_px, alone.dv_px - whole.dv_px))


def _frame_edges(image, mask, table: ClassTable, channels: Sequence[int], frame: int) -> list[_Edges]:
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    grey = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 0.7)
    usable = _is_none_of(mask, table.unusable_ids)
    margin = int(np.ceil(_REACH_PX)) + 2
    usable[:margin], usable[-margin:], usable[:, :margin], usable[:, -margin:] = 0, 0, 0, 0
    usable = cv2.erode(usable, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
    rng = np.random.default_rng(frame)
    parts = []
    for layer in channels:
        binary = 255 - _is_none_of(mask, table.channels[layer].mask_ids)
        left, top, width, height = cv2.boundingRect(binary)
        if not width:
            continue
        # What lies farther away than filters reach changes nothing at a border.
        bottom, right = top + height + _AROUND_PX, left + width + _AROUND_PX
        left, top = max(left - _AROUND_PX, 0), max(top - _AROUND_PX, 0)
        distance = signed_distance(np.ascontiguousarray(binary[top:bottom, left:right]), _BLUR_PX)
        v, u = np.nonzero((np.abs(distance) < 0.5) & (usable[top:bottom, left:right] > 0))
        if len(u) > _POINTS_PER_LAYER:
            chosen = rng.choice(len(u), _POINTS_PER_LAYER, replace=False)
            u, v = u[chosen], v[chosen]
        is_paint = bool(_PAINT & set(table.channels[layer].classes))
        parts += _profiles(grey, distance, (left, top), u, v, is_paint, layer, frame)
    return parts


def _is_none_of(mask: np.ndarray, ids: Sequence[int]) -> np.ndarray:
    """Where a mask has none of some ids, 0 or 255."""
    table = np.full(256, 255, np.uint8)
    table[list(ids)] = 0
    return cv2.LUT(mask, table)


def _profiles(grey, distance, first: tuple[int, int], u, v, is_paint: bool, layer: int, frame: int) -> list[_Edges]:
    """Image gradient along the mask normals through the boundary pixels (u, v) of a distance whose first pixel is
    `first` of the image."""
    smooth = cv2.GaussianBlur(np.clip(distance, -4, 4), (0, 0), 1.0)
    normal = np.stack([smooth[v, u + 1] - smooth[v, u - 1], smooth[v + 1, u] - smooth[v - 1, u]], axis=-1) / 2.0
    length = np.linalg.norm(normal, axis=-1)
    # Ridges of thin lines and corners have no normal.
    good = length > 0.6
    if not good.any():
        return []
    normal, away = normal[good] / length[good, None], distance[v[good], u[good]]
    u, v = u[good] + first[0], v[good] + first[1]
    boundary = np.stack([u, v], axis=-1) - away[:, None] * normal
    points = boundary[:, None] + _places()[None, :, None] * normal[:, None]
    profile = cv2.remap(grey, points.astype(np.float32), None, cv2.INTER_LINEAR)
    slope = np.gradient(profile, _STEP_PX, axis=1)
    # Paint is brighter than the road; a pole may be either.
    strength = np.maximum(-slope, 0.0) if is_paint else np.abs(slope)
    tile = (v // _TILE_PX) * 4096 + u // _TILE_PX + frame * 4096 * 4096
    return [_Edges(normal, strength, np.full(len(u), layer), tile)]


def _places() -> np.ndarray:
    return np.arange(-_REACH_PX, _REACH_PX + _STEP_PX / 2, _STEP_PX)


def _solve(parts: list[_Edges], min_points: int) -> MaskOffset:
    edges = _Edges(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    _, layer = np.unique(edges.layer, return_inverse=True)
    design = np.concatenate([-edges.normal, np.eye(layer.max() + 1)[layer]], axis=1)
    state = np.zeros(design.shape[1])
    # The window around the expected edge narrows while the estimate settles.
    for window_px in (2.5, 2.0, 1.5, 1.2, 1.2, 1.2, 1.2, 1.2):
        found, good = _edge_position(edges.gradient, design @ state, window_px)
        state, weight = _robust_fit(design[good], found[good], state)
    if good.sum() < min_points:
        raise SemlocError(
            f"mask offset: only {good.sum()} mask boundary points have an edge in the image, {min_points} are needed; "
            "check that images and masks belong together"
        )
    residual = found[good] - design[good] @ state
    sigma = _clustered_sigma(design[good], residual, weight, edges.cluster[good])
    return MaskOffset(float(state[0]), float(state[1]), float(sigma[0]), float(sigma[1]), int(good.sum()), np.inf)


def _edge_position(gradient: np.ndarray, expected: np.ndarray, window_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Place of the image edge on each normal [px], the strongest one near the expected place, and whether it counts."""
    places = _places()
    prior = np.exp(-0.5 * ((places - expected[:, None]) / window_px) ** 2)
    best = np.clip(np.argmax(gradient * prior, axis=1), 1, len(places) - 2)
    rows = np.arange(len(best))
    # The peak of the image edge itself, without the pull of the window.
    for _ in range(4):
        left, mid, right = gradient[rows, best - 1], gradient[rows, best], gradient[rows, best + 1]
        best = np.clip(
            best + (right > mid).astype(int) - ((left > mid) & (left >= right)).astype(int), 1, len(places) - 2
        )
    left, mid, right = gradient[rows, best - 1], gradient[rows, best], gradient[rows, best + 1]
    curvature = left - 2.0 * mid + right
    offset = 0.5 * (left - right) / np.where(curvature < 0, curvature, -1.0)
    good = (curvature < 0) & (np.abs(offset) <= 1.0) & (mid > _MIN_CONTRAST)
    return places[best] + np.clip(offset, -1, 1) * _STEP_PX, good


def _robust_fit(design: np.ndarray, target: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    for _ in range(10):
        residual = target - design @ state
        scale = max(1.4826 * np.median(np.abs(residual)), 0.1)
        weight = 1.0 / (1.0 + (residual / scale) ** 2)
        normal_matrix = design.T @ (weight[:, None] * design) + 1e-6 * np.eye(len(state))
        state = np.linalg.solve(normal_matrix, design.T @ (weight * target))
    return state, weight


def _clustered_sigma(design: np.ndarray, residual: np.ndarray, weight: np.ndarray, cluster: np.ndarray) -> np.ndarray:
    """Standard error of each unknown with residuals of one cluster fully correlated (sandwich)."""
    bread = np.linalg.inv(design.T @ (weight[:, None] * design) + 1e-6 * np.eye(design.shape[1]))
    _, cluster = np.unique(cluster, return_inverse=True)
    score = np.zeros((cluster.max() + 1, design.shape[1]))
    np.add.at(score, cluster, (weight * residual)[:, None] * design)
    return np.sqrt(np.diag(bread @ (score.T @ score) @ bread))
