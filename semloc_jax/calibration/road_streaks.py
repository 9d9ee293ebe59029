"""Painted lines as single cameras see them at single times (room: calibration; host).

In: frames, masks, a rig that may be a degree off. Out: Streaks: lines of sight along each line and to its ends, which
do not depend on how the cameras are mounted.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Drive, Frame
from semloc_jax.geometry import polyline
from semloc_jax.geometry.rigid import planar_pose
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.mapping.looking import Gatherer, Look, Looker, RoadLookConfig
from semloc_jax.mapping.vectorize import STROKES, VectorConfig, elements_of
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

_LOOK = RoadLookConfig(range_m=11.0)
_VECTOR = VectorConfig(min_looks=1, joined_gap_m=1.0)
_SPACING_M = 0.25
_SHORTEST_M = 1.0
_BENT_M = 0.05
"""A line that strays farther from a straight one is no line to measure by."""
_BESIDE = planar_pose(0.5 * _LOOK.spacing_m, 0.5 * _LOOK.spacing_m)
"""Places of a look lie in the middle of the cells of the grid: on their borders half of the cells would stay empty."""
_REACH_M = 8.0
"""Paint farther from its camera is smeared over the top view, and an uneven road moves it by more than a mount does."""


@dataclass(frozen=True)
class Streak:
    """A painted line in one image.

    Attributes:
        frame: index among the frames.
        camera: index in the rig.
        label: class of the paint.
        rays_cam: unit lines of sight to places of its middle.
        end_rays_cam: to both ends; NaN for an end that was not seen.
    """

    frame: int
    camera: int
    label: ElementClass
    rays_cam: Float[np.ndarray, "n 3"]
    end_rays_cam: Float[np.ndarray, "2 3"]


def find_streaks(drive: Drive, frames: Sequence[Frame], masks: MaskSource) -> list[Streak]:
    """The painted lines of all frames in every camera.

    Args:
        drive: with the calibration to start from.
        frames: to look at.
        masks: of its cameras.
    """
    looker = Looker(drive, masks, _LOOK)
    poses = np.asarray(drive.rig.select(masks.cameras).T_base_cam, np.float64)
    found = []
    for index, frame in enumerate(frames):
        for camera, look in enumerate(looker.looks(frame, 0, _BESIDE[None])):
            for element in _lines(look, masks):
                streak = _seen(element, poses[camera])
                if streak is not None:
                    found.append(replace(streak, frame=index, camera=camera))
    return found


def _lines(look: Look, masks: MaskSource) -> Iterator[MapElement]:
    """Straight strokes of paint that one camera shows, in the base frame of the calibration to start from."""
    gatherer = Gatherer(masks.table, _LOOK.spacing_m)
    gatherer.add(look)
    layers = [layer for layer in gatherer.layers if layer.label in STROKES]
    for element in elements_of(gatherer.paint, layers, lambda xy: np.zeros(len(xy)), _VECTOR):
        element = element.with_points(element.points - _BESIDE[:3, 3])
        xy = element.points[:, :2]
        direction = (xy[-1] - xy[0]) / max(float(np.linalg.norm(xy[-1] - xy[0])), 1e-6)
        across = (xy - xy.mean(axis=0)) @ [-direction[1], direction[0]]
        if np.abs(across).max() < _BENT_M:
            yield element


def _seen(element: MapElement, T_base_cam: np.ndarray) -> Streak | None:
    """A line as the camera that showed it sees it; None where too little of it is near."""
    points = element.points
    length_m = float(polyline.arc_length(points)[-1])
    places = polyline.interpolate(points, np.arange(0.5 * _SPACING_M, length_m, _SPACING_M))
    places = places[np.linalg.norm(places[:, :2] - T_base_cam[:2, 3], axis=1) < _REACH_M]
    if len(places) * _SPACING_M < _SHORTEST_M:
        return None
    ends = points[[0, -1]].copy()
    is_seen = np.array(element.true_ends) & (np.linalg.norm(ends[:, :2] - T_base_cam[:2, 3], axis=1) < _REACH_M)
    ends[~is_seen] = np.nan
    return Streak(0, 0, element.label, _rays(T_base_cam, places), _rays(T_base_cam, ends))


def _rays(T_base_cam: np.ndarray, p_base: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit lines of sight to places; NaN stays."""
    p_cam = (p_base - T_base_cam[:3, 3]) @ T_base_cam[:3, :3]
    return p_cam / np.linalg.norm(p_cam, axis=1, keepdims=True)
