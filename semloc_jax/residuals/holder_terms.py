"""What every map element does to the pose of a frame: force and information (room: residuals; pure JAX).

In: a vehicle pose, a SmoothScene, which element each sample belongs to. Out: HolderTerms, one row for each element.
The rigid motion eta of an element and that of the vehicle xi enter its cost through exp(-xi) exp(eta) p alone, both in
the axes of the vehicle: moving an element is moving the vehicle the other way, for that element alone.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from semloc_jax.residuals.alignment import points_in_camera
from semloc_jax.residuals.noise import INLIER_REACH
from semloc_jax.residuals.smooth import SmoothScene
from semloc_jax.residuals.smooth_curvature import sample_expansion

_INSIDE = (1 - INLIER_REACH**2) ** 2
"""Weight of the loss at the limit of an inlier."""


class HolderTerms(NamedTuple):
    """What every holder does at a pose."""

    cost: Float[Array, " h"]
    """Its cost [nats]."""
    force: Float[Array, "h 6"]
    """Gradient of its cost [nats] by the right tangent of the pose."""
    by_pose: Float[Array, "h 6 6"]
    """Derivative of its force by the pose."""
    by_motion: Float[Array, "h 6 6"]
    """Derivative of its force by its own rigid motion, in the axes of the vehicle."""
    information: Float[Array, "h 6 6"]
    """Gauss-Newton information with robust weights [1/m, 1/rad]^2."""
    weight: Float[Array, " h"]
    """Independent observations in view."""
    pulling: Float[Array, " h"]
    """What the loss leaves of them."""
    inlier: Float[Array, " h"]
    """Those within reach of a boundary of their class."""
    absolute_px: Float[Array, " h"]
    """Sum of |distance| [px] over what pulls."""
    square_px2: Float[Array, " h"]
    """Sum of squared distances [px^2] over what pulls."""
    num_samples: Int[Array, " h"]
    """Samples in view."""


@jax.jit
def holder_terms(
    T_local_base: Float[Array, "4 4"], scene: SmoothScene, holder: tuple[Int[Array, "cam p"], ...], none: Array
) -> HolderTerms:
    """The terms of all map elements at a pose.

    Args:
        T_local_base: Pose relative to the local origin.
        scene: What is minimised.
        holder: Holder of each sample of each view of the scene, -1 for padding.
        none: Zeros, one for each element; its length is the number of elements.
    """
    num = none.shape[0]

    def one_camera(view, element) -> HolderTerms:
        samples = sample_expansion(T_local_base, view, scene)
        R = view.T_cam_base[:3, :3]
        gradient = R.T @ samples.gradient
        hessian, information = (
            jnp.einsum("ia,ijp,jb->abp", R, part, R) for part in (samples.hessian, samples.information)
        )
        p_base = jnp.stack(points_in_camera(jnp.eye(4, dtype=R.dtype), T_local_base, view.p_map))
        once, twice = _moves(p_base)
        bent = jnp.einsum("ip,abip->abp", gradient, twice)
        curved = jnp.einsum("aip,ijp,bjp->abp", once, hessian, once)
        pulling = samples.weight * samples.pull
        seen = samples.weight > 0
        by_sample = HolderTerms(
            cost=samples.weight * samples.penalty,
            force=-jnp.einsum("ip,aip->pa", gradient, once),
            by_pose=(curved + 0.5 * (bent + bent.transpose(1, 0, 2))).transpose(2, 0, 1),
            by_motion=-(curved + bent).transpose(2, 0, 1),
            information=jnp.einsum("aip,ijp,bjp->pab", once, information, once),
            weight=samples.weight,
            pulling=pulling,
            inlier=samples.weight * (samples.pull > _INSIDE),
            absolute_px=pulling * jnp.abs(samples.distance_px),
            square_px2=pulling * samples.distance_px**2,
            num_samples=seen.astype(jnp.int32),
        )
        # What lies behind the camera has no finite place in the image and no weight either.
        row = jnp.where(seen & (element >= 0), element, num)
        return jax.tree.map(
            lambda leaf: jax.ops.segment_sum(jnp.where(_as(seen, leaf), leaf, 0), row, num + 1)[:num], by_sample
        )

    parts = [jax.vmap(one_camera)(view, element) for view, element in zip(scene.views, holder, strict=True)]
    return jax.tree.map(lambda *leaves: sum(jnp.sum(leaf, axis=0) for leaf in leaves), *parts)


def _as(seen: Array, leaf: Array) -> Array:
    return seen.reshape(seen.shape + (1,) * (leaf.ndim - 1))


def _moves(p: Float[Array, "3 p"]) -> tuple[Float[Array, "6 3 p"], Float[Array, "6 6 3 p"]]:
    """First derivatives E_b p of points by a rigid motion, and E_a E_b p."""
    axes = jnp.eye(3, dtype=p.dtype)
    steps = jnp.broadcast_to(axes[:, :, None], (3, 3, p.shape[1]))
    once = jnp.concatenate([steps, jnp.cross(axes[:, :, None], p[None], axis=1)])
    turned = jnp.cross(axes[:, None, :, None], once[None], axis=2)
    return once, jnp.concatenate([jnp.zeros_like(turned), turned])
