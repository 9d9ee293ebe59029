"""What every map element does to the pose of a frame across its own contours (room: residuals; pure JAX).

In: a vehicle pose, a SmoothScene, which element each sample belongs to. Out: ContourPulls, one row for each element.
The border of a mask is rough: its distances also rise and fall along a contour, from pixel to pixel. Force by such
slopes averages out, information by them adds up: a straight solid line then holds the vehicle along itself (half of all
information along a road was of this kind), and force over information corrects half of what it should.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from semloc_jax.residuals.alignment import CameraViews, points_in_camera
from semloc_jax.residuals.contour_rows import contour_rows
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.smooth import SmoothScene, cubic_value, distance_patch, reach_and_gain, seen_share


class ContourPulls(NamedTuple):
    """What every holder does at a pose, by the right tangent of the pose [m, rad]."""

    force: Float[Array, "h 6"]
    """Gradient of its cost [nats], as far as it comes from displacements across contours."""
    information: Float[Array, "h 6 6"]
    """Gauss-Newton information of the same with robust weights."""
    pulling: Float[Array, " h"]
    """Independent observations that the loss has not let go of."""


def contour_pulls(
    T_local_base: Float[Array, "4 4"], scene: SmoothScene, holder: tuple[Int[Array, "cam p"], ...], none: Array
) -> ContourPulls:
    """The pulls of all map elements at a pose.

    Args:
        T_local_base: Pose relative to the local origin.
        scene: Views, distances and noise.
        holder: Holder of each sample of each view of the scene, -1 for padding.
        none: Zeros, one for each element; its length is the number of elements.
    """
    num = none.shape[0]

    def one_camera(view: CameraViews, element: Array) -> ContourPulls:
        by_sample, seen = _by_sample(T_local_base, view, scene)
        row = jnp.where(seen & (element >= 0), element, num)
        return jax.tree.map(lambda leaf: jax.ops.segment_sum(leaf, row, num + 1)[:num], by_sample)

    parts = [jax.vmap(one_camera)(view, element) for view, element in zip(scene.views, holder, strict=True)]
    return jax.tree.map(lambda *leaves: sum(jnp.sum(leaf, axis=0) for leaf in leaves), *parts)


def _by_sample(T_local_base: Array, view: CameraViews, scene: SmoothScene) -> tuple[ContourPulls, Array]:
    rows, (u, v), normal = contour_rows(T_local_base, view.T_cam_base, view.camera, view.p_map, view.tangent_map)
    valid = view.camera.project_xyz(*points_in_camera(view.T_cam_base, T_local_base, view.p_map))[2]
    patch = distance_patch(u, v, view, scene.maps)
    reach_px, gain = reach_and_gain(view.channel, scene.model)
    ratio = cubic_value(patch) / reach_px
    rise = sum(cubic_value(patch, *order) * part for order, part in zip(((1, 0), (0, 1)), normal, strict=True))
    rise = rise / (scene.maps.stride * reach_px)
    held = LOSSES["tukey"].weight(ratio)
    weight = scene.nats_per_px * view.weight * seen_share(u, v, view, scene.usable, scene.border)[0]
    # What lies behind the camera has no finite place in the image and no weight either.
    seen = valid & (weight > 0) & jnp.isfinite(rows).all(axis=0)
    weight, rows = jnp.where(seen, weight, 0.0), jnp.where(seen, rows * rise, 0.0)
    nats = weight * gain * held
    information = (nats * rows)[:, None] * rows
    return ContourPulls((nats * ratio * rows).T, information.transpose(2, 0, 1), weight * held), seen
