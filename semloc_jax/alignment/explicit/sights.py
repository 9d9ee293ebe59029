"""Shapes in the masks of all cameras as lines of sight (room: alignment; host).

In: Primitives and Rig. Out: Sight of each shape: its pixels, their rays, and how pixels grow beside them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.cameras import Camera, Rig
from semloc_jax.geometry import rigid
from semloc_jax.perception.primitives import LampLine, Primitives
from semloc_jax.perception.row_curves import RowCurve
from semloc_jax.perception.sight_lines import sight_lines
from semloc_jax.perception.sign_outlines import SignOutline
from semloc_jax.residuals.lane_curve import MOST_PLACES
from semloc_jax.residuals.seen_point import PointSight
from semloc_jax.structs import ElementClass

_PADDED_TO = 256
"""Pixels and points are padded to a multiple of this, so that few programs serve all frames."""
_CURVE_STEP_PX = 12.0


class ShapeSight(NamedTuple):
    """One shape in one camera."""

    label: ElementClass
    camera: int
    shape: RowCurve | SignOutline | LampLine
    uv: Float[np.ndarray, "k 2"]
    """Of a curve: places on it; of a sign: centre, then corners; of a post: lower and upper end [px]."""
    sights: PointSight
    """The same as lines of sight, a leading axis over them."""

    @property
    def px_per_rad(self) -> float:
        """Pixels of a small angle at its first place."""
        first = self.sights.pixels[0]
        return float(np.sqrt(np.linalg.norm(np.cross(first[0], first[1]))))


def shape_sights(primitives: Sequence[Primitives], rig: Rig) -> list[ShapeSight]:
    """Every shape that lies where its camera sees.

    Args:
        primitives: Of each camera, in the order of the rig.
        rig: Cameras.
    """
    found = []
    for k, (own, camera) in enumerate(zip(primitives, rig.cameras, strict=True)):
        shapes = [
            *((ElementClass.LANE_MARKING, lane, _on_curve(lane)) for lane in own.lanes),
            *((ElementClass.SIGN, sign, np.vstack([sign.centre, sign.corners])) for sign in own.signs),
            *((ElementClass.POLE, lamp, _ends(lamp)) for lamp in own.lamps),
        ]
        if not shapes:
            continue
        ends = np.cumsum([0, *(len(uv) for _, _, uv in shapes)])
        uv = np.concatenate([uv for _, _, uv in shapes])
        lines = sight_lines(camera, np.pad(uv, ((0, -len(uv) % _PADDED_TO), (0, 0))))
        T = np.asarray(rig.T_base_cam, np.float64)[k]
        for (label, shape, places), a, b in zip(shapes, ends[:-1], ends[1:], strict=True):
            if lines.valid[a:b].all():
                sights = PointSight(np.tile(T, (b - a, 1, 1)), lines.ray_cam[a:b], lines.pixels[a:b])
                found.append(ShapeSight(label, k, shape, places, sights))
    return found


def _on_curve(curve: RowCurve) -> np.ndarray:
    num = int(np.clip((curve.last - curve.first) / _CURVE_STEP_PX + 2, 2, MOST_PLACES))
    v = np.linspace(curve.first, curve.last, num)
    return np.stack([curve.column(v), v], axis=1)


def _ends(lamp: LampLine) -> np.ndarray:
    return np.stack([lamp.axis.column(lamp.rows), lamp.rows], axis=1)


class ProjectedPoints(NamedTuple):
    """Points of the map in one camera."""

    uv: Float[np.ndarray, "n 2"]
    in_view: Bool[np.ndarray, " n"]
    distance_m: Float[np.ndarray, " n"]


def projected(
    camera: Camera, T_local_cam: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "n 3"]
) -> ProjectedPoints:
    """Points of the local frame as a camera sees them from a pose."""
    T = rigid.inverse(T_local_cam)
    p_cam = points @ T[:3, :3].T + T[:3, 3]
    padded = np.pad(p_cam, ((0, -len(p_cam) % _PADDED_TO), (0, 0)), constant_values=1.0)
    with jax.enable_x64(True):
        uv, valid = _project(camera, padded)
    uv, valid = np.asarray(uv, np.float64)[: len(p_cam)], np.asarray(valid)[: len(p_cam)]
    width, height = camera.resolution
    inside = valid & (uv > -0.5).all(axis=1) & (uv[:, 0] < width - 0.5) & (uv[:, 1] < height - 0.5)
    return ProjectedPoints(np.where(valid[:, None], uv, np.nan), inside, np.linalg.norm(p_cam, axis=1))


@eqx.filter_jit
def _project(camera: Camera, p_cam):
    return camera.project(p_cam)
