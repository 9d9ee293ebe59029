"""The street of the benchmark: paint, poles and signs as flat polygons, their masks and the points on their contours.

In: a seed. Out: masks of three classes as one camera sees them, and points on the contours (room: bench; host).
Everything is made here from numbers of a seeded generator, so that a benchmark needs no data.
"""

from typing import NamedTuple

import cv2
import numpy as np

from semloc_jax.geometry import lie

LANE, POLE, SIGN = 0, 1, 2
CLASSES = ("lane marking", "pole", "sign")
WIDTH, HEIGHT = 640, 400
FX, FY, CX, CY = 420.0, 420.0, 319.5, 180.0
_FINE = 4  # masks are drawn so many times larger, then reduced: their borders are exact to a fraction of a pixel
_NEAR_M, _FAR_M = 2.5, 60.0
_STEP_M = 0.02


class Element(NamedTuple):
    """A flat polygon on the map, and which of its edges are contours that the map samples."""

    label: int
    corners: np.ndarray
    """Corners [m], float64[n 3], in the map frame."""
    edges: tuple[int, ...]
    """Edge k runs from corner k to the next one."""


def camera_mount() -> np.ndarray:
    """T_base_cam: 1.6 m before the rear axle, 1.5 m high, looking forward and 3 degrees down."""
    pitch = np.deg2rad(3.0)
    T_base_cam = np.eye(4)
    forward = np.array([np.cos(pitch), 0.0, -np.sin(pitch)])
    right = np.array([0.0, -1.0, 0.0])
    T_base_cam[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T_base_cam[:3, 3] = 1.6, 0.0, 1.5
    return T_base_cam


def true_pose() -> np.ndarray:
    """T_map_base of the vehicle in the right-hand lane."""
    return np.asarray(lie.exp(np.array([10.0, -1.6, 0.0, 0.004, -0.006, 0.02])), np.float64)


def street(seed: int) -> list[Element]:
    """Two solid lines, a dashed line between them, poles and signs at both sides."""
    rng = np.random.default_rng(seed)
    elements = [_line(y, -10.0, 90.0) for y in (-3.5, 3.5)]
    elements += [_line(0.0, x, x + 3.0, ends=True) for x in np.arange(-6.0, 90.0, 9.0)]
    for side in (-1.0, 1.0):
        x = rng.uniform(14.0, 18.0)
        while x < 70.0:
            y = side * rng.uniform(4.5, 7.5)
            if rng.random() < 0.7:
                elements.append(_upright(POLE, x, y, 0.0, 0.2, rng.uniform(4.0, 7.0), (1, 3)))
            else:
                wide, tall = rng.uniform(0.6, 1.8), rng.uniform(0.6, 1.2)
                elements.append(_upright(SIGN, x, y, rng.uniform(2.0, 3.5), wide, tall, (0, 1, 2, 3)))
            x += rng.uniform(4.0, 9.0)
    return elements


def _line(y: float, x0: float, x1: float, ends: bool = False) -> Element:
    half = 0.075
    corners = np.array([[x0, y - half, 0], [x1, y - half, 0], [x1, y + half, 0], [x0, y + half, 0]])
    return Element(LANE, corners, (0, 1, 2, 3) if ends else (0, 2))


def _upright(label: int, x: float, y: float, z: float, wide: float, tall: float, edges: tuple[int, ...]) -> Element:
    half = wide / 2
    corners = np.array([[x, y - half, z], [x, y + half, z], [x, y + half, z + tall], [x, y - half, z + tall]])
    return Element(label, corners, edges)


def masks(elements: list[Element], T_cam_map: np.ndarray) -> np.ndarray:
    """What the camera sees of each class, uint8[class h w] with 255 inside."""
    drawn = np.zeros((len(CLASSES), HEIGHT * _FINE, WIDTH * _FINE), np.uint8)
    for element in elements:
        p_cam = _clipped(element.corners @ T_cam_map[:3, :3].T + T_cam_map[:3, 3])
        if len(p_cam) >= 3:
            # Pixel centres are whole numbers: those of the drawing lie a fraction away from those of the mask.
            uv = (_project(p_cam) + 0.5) * _FINE - 0.5
            cv2.fillPoly(drawn[element.label], [np.round(uv * 256).astype(np.int32)], 255, shift=8)
    reduced = [cv2.resize(layer, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for layer in drawn]
    return np.stack([np.where(layer > 127, 255, 0).astype(np.uint8) for layer in reduced])


def contour_points(
    elements: list[Element], T_cam_map: np.ndarray, num_points: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Points at even distances along the contours in the image.

    Returns:
        Points [n 3] in the map frame, class of each, and the length of contour [px] that each stands for.
    """
    points, labels, lengths = [], [], []
    for element in elements:
        for k in element.edges:
            a, b = element.corners[k], element.corners[(k + 1) % len(element.corners)]
            share = (np.arange(num := max(int(np.linalg.norm(b - a) / _STEP_M), 8)) + 0.5) / num
            p_map = a + share[:, None] * (b - a)
            p_cam = p_map @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]
            step = ((b - a) / num) @ T_cam_map[:3, :3].T
            deep = np.maximum(p_cam[:, 2], _NEAR_M)
            du = FX * (step[0] - p_cam[:, 0] / deep * step[2]) / deep
            dv = FY * (step[1] - p_cam[:, 1] / deep * step[2]) / deep
            uv = _project(np.column_stack([p_cam[:, :2], deep]))
            seen = (p_cam[:, 2] > _NEAR_M) & (p_cam[:, 2] < _FAR_M) & (uv >= 3).all(axis=1)
            seen &= (uv[:, 0] < WIDTH - 4) & (uv[:, 1] < HEIGHT - 4)
            points.append(p_map[seen])
            labels.append(np.full(seen.sum(), element.label, np.int32))
            lengths.append(np.hypot(du, dv)[seen])
    running = np.cumsum(np.concatenate(lengths))
    chosen = np.searchsorted(running, (np.arange(num_points) + 0.5) / num_points * running[-1])
    return np.concatenate(points)[chosen], np.concatenate(labels)[chosen], float(running[-1]) / num_points


def _project(p_cam: np.ndarray) -> np.ndarray:
    return p_cam[:, :2] / p_cam[:, 2:] * (FX, FY) + (CX, CY)


def _clipped(p_cam: np.ndarray) -> np.ndarray:
    """The part of a polygon that is farther than a metre from the plane of the lens."""
    kept = []
    for a, b in zip(p_cam, np.roll(p_cam, -1, axis=0), strict=True):
        if a[2] >= 1.0:
            kept.append(a)
        if (a[2] >= 1.0) != (b[2] >= 1.0):
            kept.append(a + (1.0 - a[2]) / (b[2] - a[2]) * (b - a))
    return np.array(kept).reshape(-1, 3)
