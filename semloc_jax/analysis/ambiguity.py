"""How well a shifted pose explains the same view (room: analysis; JAX).

In: the samples seen from a pose. Out: for poses shifted along and across the road, the share of the view they explain.
No image is needed: perfect masks have their boundaries where the contours are, so the ramp at a pixel is its distance
to the nearest contour of the class.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.scene import SceneConfig
from semloc_jax.cameras import Rig
from semloc_jax.geometry import lie
from semloc_jax.residuals.alignment import points_in_camera
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.view import ViewConfig, view
from semloc_jax.structs import MapSamples, ViewSamples

_PIECE_PX = 4.0
"""Half of the longest piece of contour that a sample stands for."""


@dataclass(frozen=True)
class AmbiguityConfig:
    """Where second poses are looked for. All values are our choice."""

    longitudinal_m: float = 15.0
    lateral_m: float = 4.0
    step_longitudinal_m: float = 0.75
    step_lateral_m: float = 0.4
    apart_m: float = 2.0
    """Poses nearer than this are the same place."""
    ramp_px: float = 14.0
    """Distance at which a contour explains nothing."""
    capacity: int = 384
    """Samples of each camera that are compared."""

    def grid(self) -> tuple[Float[np.ndarray, " a"], Float[np.ndarray, " b"]]:
        """Longitudinal and lateral shifts [m] that are tried, symmetric about 0."""
        counts = int(self.longitudinal_m / self.step_longitudinal_m), int(self.lateral_m / self.step_lateral_m)
        ahead, left = (np.arange(-count, count + 1) for count in counts)
        return ahead * self.step_longitudinal_m, left * self.step_lateral_m


class SecondPose(NamedTuple):
    """The pose elsewhere that explains the view best."""

    share: Float[Array | np.ndarray, ""]
    """Share of the map in view from there that the masks explain, in [0, 1]."""
    shift_m: Float[Array | np.ndarray, "2"]
    """Where it is: longitudinal and lateral shift [m]."""


def second_pose(
    samples: MapSamples,
    T_local_base: Float[Array, "4 4"],
    rig: Rig,
    channel_of_label: Int[Array, " label"],
    config: AmbiguityConfig,
    scene: SceneConfig,
) -> SecondPose:
    """The best explanation of the view from `T_local_base` at least `apart_m` away that is no flank of a better one."""
    ahead, left = config.grid()
    shifts = np.stack(np.meshgrid(ahead, left, indexing="ij"), axis=-1)
    share = explained_share(samples, T_local_base, rig, channel_of_label, shifts.reshape(-1, 2), config, scene)
    share = share.reshape(shifts.shape[:2])
    border = jnp.pad(share, 1, mode="edge")
    beside = jnp.stack([border[2:, 1:-1], border[:-2, 1:-1], border[1:-1, 2:], border[1:-1, :-2]])
    is_peak = (share >= jnp.max(beside, axis=0)) & (np.hypot(*np.moveaxis(shifts, -1, 0)) >= config.apart_m)
    best = jnp.argmax(jnp.where(is_peak, share, -1.0))
    return SecondPose(share.reshape(-1)[best], jnp.asarray(shifts.reshape(-1, 2), share.dtype)[best])


def explained_share(
    samples: MapSamples,
    T_local_base: Float[Array, "4 4"],
    rig: Rig,
    channel_of_label: Int[Array, " label"],
    shifts: Float[Array | np.ndarray, "n 2"],
    config: AmbiguityConfig,
    scene: SceneConfig,
) -> Float[Array, " n"]:
    """Share of the map in view from each shifted pose that the masks of the unshifted pose explain, in [0, 1].

    Args:
        samples: Map samples relative to the local origin.
        T_local_base: The pose whose masks are imagined.
        rig: Cameras.
        channel_of_label: Cost-map channel of each ElementClass.
        shifts: Longitudinal and lateral shift of the other poses [m].
        config: Ramp and number of samples.
        scene: What cameras see of the map.
    """
    # With a margin: from a shifted pose other parts of the map are in view.
    wide = replace(scene.view_of(ViewConfig(margin_share=0.3)), capacity=config.capacity)
    near = view(samples, T_local_base, rig, channel_of_label, wide)
    here = [_contour(T_local_base, rig, index, near) for index in range(len(rig))]
    visible = [rig.cameras[i].in_image(*here[i][0]) & (near.weight[i] > 0) for i in range(len(rig))]

    def at(shift: Array) -> Array:
        offset = jnp.zeros(3, T_local_base.dtype).at[:2].set(shift)
        T = T_local_base.at[:3, 3].add(T_local_base[:3, :3] @ offset)
        parts = [_cost(T, rig, i, near, here[i], visible[i], config.ramp_px) for i in range(len(rig))]
        cost, weight = (jnp.sum(jnp.stack(column)) for column in zip(*parts, strict=True))
        return 1 - jnp.where(weight > 0, cost / jnp.maximum(weight, 1e-6), 1.0)

    share = jax.lax.map(at, jnp.asarray(shifts, T_local_base.dtype), batch_size=8)
    return jnp.clip(share, 0.0, 1.0)


def _contour(T_local_base: Array, rig: Rig, index: int, seen: ViewSamples) -> tuple[Array, Array]:
    """Pixels of the samples of one camera, and unit directions of their contours in the image, both `[2 p]`."""
    T_cam_base = lie.inverse(jnp.asarray(rig.T_base_cam[index], T_local_base.dtype))
    R_cam_map = (T_cam_base @ lie.inverse(T_local_base))[:3, :3]
    points = points_in_camera(T_cam_base, T_local_base, seen.p_map[index])
    along = tuple(R_cam_map @ seen.tangent_map[index])
    uv, direction = jax.jvp(lambda *p: jnp.stack(rig.cameras[index].project_xyz(*p)[:2]), points, along)
    return uv, direction / jnp.maximum(jnp.linalg.norm(direction, axis=0), 1e-6)


def _cost(
    T: Array, rig: Rig, index: int, near: ViewSamples, here: tuple[Array, Array], visible: Array, ramp_px: float
) -> tuple[Array, Array]:
    """Weighted robust cost of one camera at pose T against the contours that are visible from here, and the weight."""
    uv = _contour(T, rig, index, near)[0]
    here_uv, direction = here
    away = uv[:, :, None] - here_uv[:, None, :]
    along = jnp.sum(away * direction[:, None, :], axis=0)
    # Each sample stands for a piece of its contour: only what is beyond its ends counts along it.
    beyond = jnp.maximum(jnp.abs(along) - _PIECE_PX, 0.0)
    squared = jnp.maximum(jnp.sum(away * away, axis=0) - along * along, 0.0) + beyond * beyond
    same = (near.channel[index][:, None] == near.channel[index]) & visible
    distance = jnp.sqrt(jnp.min(jnp.where(same, squared, jnp.inf), axis=1))
    loss = LOSSES["tukey"]
    cost = loss.rho(jnp.minimum(distance / ramp_px, 1.0)) / loss.worst
    weight = jnp.where(rig.cameras[index].in_image(*uv), near.weight[index], 0.0)
    return jnp.sum(weight * cost), jnp.sum(weight)
