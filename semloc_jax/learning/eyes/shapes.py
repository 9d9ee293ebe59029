"""The surfaces of map elements as a camera sees them (room: learning; host).

In: map elements, poses of the camera. Out: Surfaces: pieces of four corners in pixels, with what moves them.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.cameras import Camera
from semloc_jax.geometry import rigid
from semloc_jax.geometry.polyline import arc_length
from semloc_jax.maps.contours import Contour, element_contours
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.sampling import BUCKETS
from semloc_jax.structs import SampleKind

_STEP_M = 0.5
"""Length of a piece: short enough to be straight in a fisheye, and to end where a camera stops to see."""
_TOO_NEAR_M = 0.3
"""Corners nearer to the lens than this are not seen."""
_MOST_WIDTHS = 4.0
"""Corners farther beside the image than so many of its widths are not seen: they lie across the line of sight."""
_FARTHEST_M = 80.0
"""What is farther away is left out."""


class Surfaces(NamedTuple):
    """Pieces of surfaces in one image; n pieces, farthest first."""

    uv: Float[np.ndarray, "n 4 2"]
    """Corners in order [px]; first to second and third to fourth are borders, the other two where `is_end` says so. A
    side of an outline is there and back: the outline itself is the first corners of its pieces."""
    sigma_px: Float[np.ndarray, "n 4"]
    """Standard deviation across each side, from corner k to the next, by the pose and the map [px]."""
    is_end: Bool[np.ndarray, "n 2"]
    """Whether the sides second to third, and fourth to first, are borders."""
    element: np.ndarray
    """Place of the element of each piece in the list."""
    distance_m: np.ndarray


def seen_surfaces(
    elements: Sequence[MapElement],
    camera: Camera,
    T_map_base: Float[np.ndarray, "4 4"],
    T_base_cam: Float[np.ndarray, "4 4"],
    covariance: Float[np.ndarray, "6 6"],
    map_sigma_m: float,
) -> Surfaces:
    """The surfaces of elements in an image.

    Args:
        elements: In the map frame.
        camera: The camera.
        T_map_base: Vehicle pose.
        T_base_cam: Where the camera sits.
        covariance: Of the right tangent of the pose.
        map_sigma_m: How far an element may be from its place in the map.
    """
    T_map_cam = np.asarray(T_map_base) @ np.asarray(T_base_cam)
    pieces = [
        (corners, ends, k) for k, element in enumerate(elements) for corners, ends in _pieces(element, T_map_cam[:3, 3])
    ]
    if not pieces:
        return Surfaces(np.zeros((0, 4, 2)), np.zeros((0, 4)), np.zeros((0, 2), bool), np.zeros(0, int), np.zeros(0))
    corners = np.array([piece[0] for piece in pieces])
    is_end, element = np.array([piece[1] for piece in pieces]), np.array([piece[2] for piece in pieces])
    spread = np.linalg.cholesky(covariance + 1e-12 * np.eye(6)).T
    moved = [T_map_base, *(T_map_base @ rigid.exp(row) for row in spread)]
    uvs, seen = zip(*(seen_corners(camera, corners, T @ T_base_cam) for T in moved), strict=True)
    uv, shifts = uvs[0], np.stack(uvs[1:]) - uvs[0]
    distance_m = _together(np.linalg.norm(corners.mean(axis=1) - T_map_cam[:3, 3], axis=1), corners, element)
    side = np.roll(uv, -1, axis=1) - uv
    length_px = np.maximum(np.linalg.norm(side, axis=2), 1e-6)
    normal = np.stack([side[..., 1], -side[..., 0]], axis=2) / length_px[..., None]
    by_pose = np.einsum("knij,nij->kni", 0.5 * (shifts + np.roll(shifts, -1, axis=2)), normal)
    length_m = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    px_per_m = np.minimum(length_px / np.maximum(length_m, 1e-3), np.asarray(camera.fx) / distance_m[:, None])
    sigma_px = np.sqrt((by_pose**2).sum(axis=0) + (map_sigma_m * px_per_m) ** 2)
    keep = np.flatnonzero(seen[0] & np.isfinite(sigma_px).all(axis=1))
    keep = keep[np.argsort(-distance_m[keep], kind="stable")]
    return Surfaces(uv[keep], sigma_px[keep], is_end[keep], element[keep], distance_m[keep])


def _together(distance_m: np.ndarray, corners: np.ndarray, element: np.ndarray) -> np.ndarray:
    """The distances of pieces [n], one for all sides of an outline: ordered by them its corners stay in order."""
    is_side, distance_m = (corners[:, 1] == corners[:, 2]).all(axis=1), distance_m.copy()
    for k in np.unique(element[is_side]):
        own = is_side & (element == k)
        distance_m[own] = distance_m[own].mean()
    return distance_m


def _pieces(element: MapElement, center: np.ndarray) -> Iterator[tuple[np.ndarray, tuple[bool, bool]]]:
    """Four corners [4 3] of each piece of an element seen from `center`, and which of its ends are borders."""
    contours = element_contours(element, element.true_ends)
    if not contours or np.linalg.norm(element.points - center, axis=1).min() > _FARTHEST_M:
        return
    kind = contours[0].kind
    if element.closed and kind == SampleKind.FIXED:
        yield from _of_ring(contours[0].line[:-1])
    elif kind == SampleKind.CORNER:
        yield from _of_box(contours, center)
    elif len(contours) >= 2:
        one, other = (_silhouette(contour, center) for contour in contours[:2])
        other = other if kind == SampleKind.ROUND else other[::-1]
        ends = (True, True) if kind == SampleKind.ROUND else element.true_ends
        yield from _of_sides(one, other, ends)


def _of_sides(one: np.ndarray, other: np.ndarray, ends: tuple[bool, bool]) -> Iterator[tuple[np.ndarray, tuple]]:
    """Pieces between two lines that run the same way."""
    num = max(int(np.ceil(arc_length(one)[-1] / _STEP_M)), 1)
    a, b = (_evenly(line, num) for line in (one, other))
    for k in range(num):
        yield np.stack([a[k], a[k + 1], b[k + 1], b[k]]), (k == num - 1 and ends[1], k == 0 and ends[0])


def _of_ring(ring: np.ndarray) -> Iterator[tuple[np.ndarray, tuple]]:
    """The sides of an outline; two corners are one each, so that nothing lies between them."""
    for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        yield np.stack([a, b, b, a]), (False, False)


def _of_box(edges: Sequence[Contour], center: np.ndarray) -> Iterator[tuple[np.ndarray, tuple]]:
    """The face between the two upright edges that are outermost in view."""
    x, y = edges[0].line[0, :2] - center[:2]
    feet = np.array([edge.line[0, :2] for edge in edges]) - center[:2]
    angles = np.arctan2(x * feet[:, 1] - y * feet[:, 0], x * feet[:, 0] + y * feet[:, 1])
    left, right = edges[int(np.argmax(angles))].line, edges[int(np.argmin(angles))].line
    yield from _of_sides(left, right, (False, False))


def _silhouette(contour: Contour, center: np.ndarray) -> np.ndarray:
    """The line where it is seen: beside its axis, for what is round."""
    if contour.kind != SampleKind.ROUND:
        return contour.line
    axis = contour.line[-1] - contour.line[0]
    side = np.cross(axis, contour.line - center)
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    return contour.line + np.linspace(*contour.offset_m, len(contour.line))[:, None] * side


def _evenly(line: np.ndarray, num: int) -> np.ndarray:
    """`num` + 1 points at equal shares of a line."""
    along = arc_length(line)
    return np.stack([np.interp(np.linspace(0.0, along[-1], num + 1), along, axis) for axis in line.T], axis=1)


def seen_corners(camera: Camera, p_map: np.ndarray, T_map_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of corners [n 4 3], and whether all corners of a piece are seen."""
    p_cam = (p_map - T_map_cam[:3, 3]) @ T_map_cam[:3, :3]
    size = next(size for size in (*BUCKETS, len(p_cam)) if size >= len(p_cam))
    padded = np.zeros((size, 4, 3), np.float32)
    padded[:, :, 2], padded[: len(p_cam)] = 1.0, p_cam
    uv, valid = (np.asarray(a)[: len(p_cam)] for a in _uv(camera, jnp.asarray(padded)))
    return uv.astype(np.float64), valid.all(axis=1)


@eqx.filter_jit
def _uv(camera: Camera, p_cam: Float[Array, "n 4 3"]) -> tuple[Float[Array, "n 4 2"], Bool[Array, "n 4"]]:
    camera = camera.astype(jnp.float32)
    uv, valid = camera.project(p_cam)
    is_near = jnp.linalg.norm(p_cam, axis=-1) < _TOO_NEAR_M
    return uv, valid & ~is_near & (jnp.abs(uv).max(axis=-1) < _MOST_WIDTHS * camera.width)
