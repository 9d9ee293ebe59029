"""How the pose of a converged solve follows each of the things that hold it (room: analysis; JAX and host).

In: SmoothScene, prior, which holder each sample belongs to. Out: HolderTerms at a pose, the pose where their forces
balance, and Influence: d(pose) / d(rigid motion of each holder), all from one factorisation.
A holder is a map element or a part of the prior. Its rigid motion eta and that of the vehicle xi enter its cost through
exp(-xi) exp(eta) p alone, both in the axes of the vehicle. With F the sum of all forces (gradients by xi) the implicit
function says d(xi) / d(eta_h) = -(dF/dxi)^-1 (dF_h/deta_h). Who moves everything moves the pose: over all holders these
6x6 matrices sum to the identity.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.pose import Prior
from semloc_jax.geometry import rigid
from semloc_jax.residuals.alignment import points_in_camera
from semloc_jax.residuals.noise import INLIER_REACH
from semloc_jax.residuals.smooth import SmoothScene
from semloc_jax.residuals.smooth_curvature import sample_expansion

PRIOR_PARTS = ("prior", "road")
"""Holders that are no map elements: position and heading of the prior; height and tilt of the road of the map."""
OF_PART = np.array([[1, 1, 0, 0, 0, 1], [0, 0, 1, 1, 1, 0]], bool)
"""Which directions of the tangent each part of the prior holds."""
_GENERATORS = np.zeros((6, 4, 4))
_GENERATORS[[0, 1, 2], [0, 1, 2], 3] = 1.0
_GENERATORS[[3, 4, 5], [2, 0, 1], [1, 2, 0]], _GENERATORS[[3, 4, 5], [1, 2, 0], [2, 0, 1]] = 1.0, -1.0
_INSIDE = (1 - INLIER_REACH**2) ** 2
"""Weight of the kernel at the limit of an inlier."""


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
    """What the kernel leaves of them."""
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
    T_map_base: Float[Array, "4 4"], scene: SmoothScene, holder: tuple[Int[Array, "cam p"], ...], none: Array
) -> HolderTerms:
    """The terms of all map elements at a pose.

    Args:
        T_map_base: Pose relative to the local origin.
        scene: What is minimised.
        holder: Holder of each sample of each view of the scene, -1 for padding.
        none: Zeros, one for each element; its length is the number of elements.
    """
    num = none.shape[0]

    def one_camera(view, element) -> HolderTerms:
        samples = sample_expansion(T_map_base, view, scene)
        R = view.T_cam_base[:3, :3]
        gradient = R.T @ samples.gradient
        hessian, information = (
            jnp.einsum("ia,ijp,jb->abp", R, part, R) for part in (samples.hessian, samples.information)
        )
        p_base = jnp.stack(points_in_camera(jnp.eye(4, dtype=R.dtype), T_map_base, view.p_map))
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


def prior_terms(T_map_base: Float[np.ndarray, "4 4"], prior: Prior) -> HolderTerms:
    """The terms of both parts of the prior (`PRIOR_PARTS`), which have no samples.

    The deviation is measured as in `alignment.implicit`: translation and axis-times-sine of T_prior^-1 T.
    """
    sigma = np.asarray(prior.sigma, np.float64)
    precision = np.where(sigma > 0, 1 / np.where(sigma > 0, sigma, 1.0), 0.0) ** 2
    D = rigid.inverse(np.asarray(prior.T_map_base, np.float64)) @ T_map_base
    once = _deviation(D @ _GENERATORS)
    twice = _deviation(D @ _GENERATORS[:, None] @ _GENERATORS)
    parts = []
    for part in OF_PART:
        pull = part * precision
        bent = twice @ (pull * _deviation(D))
        curved = (once * pull) @ once.T
        force = once @ (pull * _deviation(D))
        cost = 0.5 * np.sum(pull * _deviation(D) ** 2)
        parts.append((cost, force, curved + 0.5 * (bent + bent.T), -(curved + bent.T), np.diag(pull)))
    zero = np.zeros(len(PRIOR_PARTS))
    return HolderTerms(*map(np.stack, zip(*parts, strict=True)), zero, zero, zero, zero, zero, zero.astype(int))


def _deviation(T: Float[np.ndarray, "*b 4 4"]) -> Float[np.ndarray, "*b 6"]:
    """Translation, and axis times sine of the rotation; linear in the numbers of T."""
    R = T[..., :3, :3]
    sine = [0.5 * (R[..., i, j] - R[..., j, i]) for i, j in ((2, 1), (0, 2), (1, 0))]
    return np.concatenate([T[..., :3, 3], np.stack(sine, axis=-1)], axis=-1)


class Balance(NamedTuple):
    """The pose where all forces balance, and the terms there.

    Attributes:
        T_map_base: relative to the local origin, float64.
        terms: float64; elements first, the parts of the prior last.
        is_exact: whether it is a minimum to the last digits of the float type.
    """

    T_map_base: Float[np.ndarray, "4 4"]
    terms: HolderTerms
    is_exact: bool


def balance(
    T_start: Float[np.ndarray, "4 4"],
    scene: SmoothScene,
    prior: Prior,
    holder: tuple[Int[Array, "cam p"], ...],
    num_elements: int,
    max_steps: int = 20,
) -> Balance:
    """The optimum of the smooth cost near a pose: what `alignment.implicit.smooth_optimum` finds.

    Newton's method on the host, so that a frame is explained with one compiled program.

    Args:
        T_start: Pose relative to the local origin.
        scene: What is minimised.
        prior: Its prior.
        holder: Holder of each sample of each view, -1 for padding.
        num_elements: Capacity of elements.
        max_steps: Most evaluations.
    """
    sigma, at = np.asarray(prior.sigma, np.float64), _evaluated(scene, prior, holder, num_elements)
    tolerance = float(np.finfo(scene.nats_per_px.dtype).eps) ** (2 / 3)
    T, damping = np.asarray(T_start, np.float64), 0.0
    terms = at(T)
    for _ in range(max_steps):
        force, J = _scaled(terms, sigma)
        shift = max(damping, 0.1 - np.linalg.eigvalsh(0.5 * (J + J.T))[0], 0.0)
        step = -np.linalg.solve(J + shift * np.eye(6), force)
        step = step / max(np.abs(step).max(), 1.0)
        if np.abs(step).max() < tolerance:
            break
        T_new = T @ rigid.exp(sigma * step)
        new = at(T_new)
        # At the limit of the float type the cost no longer tells, but the force does.
        is_lower = new.cost.sum() < terms.cost.sum()
        if is_lower or np.abs(_scaled(new, sigma)[0]).max() < 0.5 * np.abs(force).max():
            T, terms, damping = T_new, new, 0.1 * damping if damping > 0.02 else 0.0
        else:
            damping = max(10 * damping, 1.0)
    force, J = _scaled(terms, sigma)
    is_minimum = np.linalg.eigvalsh(0.5 * (J + J.T))[0] > 0
    return Balance(T, terms, bool(is_minimum and np.abs(np.linalg.solve(J, force)).max() < 30 * tolerance))


def unsettled(
    T_map_base: Float[np.ndarray, "4 4"],
    scene: SmoothScene,
    prior: Prior,
    holder: tuple[Int[Array, "cam p"], ...],
    num_elements: int,
) -> Balance:
    """A pose that is no optimum, with terms in Gauss-Newton's approximation; arguments as `balance`."""
    terms = _evaluated(scene, prior, holder, num_elements)(np.asarray(T_map_base, np.float64))
    return Balance(T_map_base, terms._replace(by_pose=terms.information, by_motion=-terms.information), False)


def _evaluated(
    scene: SmoothScene, prior: Prior, holder: tuple[Int[Array, "cam p"], ...], num_elements: int
) -> Callable[[np.ndarray], HolderTerms]:
    """The terms of elements and prior as a function of the pose, in float64."""
    dtype = scene.nats_per_px.dtype
    none = jnp.zeros(num_elements, dtype)

    def at(T: np.ndarray) -> HolderTerms:
        both = (jax.device_get(holder_terms(jnp.asarray(T, dtype), scene, holder, none)), prior_terms(T, prior))
        return jax.tree.map(lambda *parts: np.concatenate([np.asarray(part, np.float64) for part in parts]), *both)

    return at


def _scaled(terms: HolderTerms, sigma: Float[np.ndarray, "6"]) -> tuple[np.ndarray, np.ndarray]:
    """Force and its derivative by the pose, in units of the prior's sigmas; locked directions hold themselves."""
    force = sigma * terms.force.sum(axis=0)
    J = sigma[:, None] * terms.by_pose.sum(axis=0) * sigma + np.diag(np.where(sigma > 0, 0.0, 1.0))
    return force, J


class Influence(NamedTuple):
    """How the pose follows its holders.

    Attributes:
        motion: d(right tangent of the pose) / d(rigid motion of the holder), both in the axes of the vehicle.
        share: of the variance of each direction of the pose that comes from the noise of the holder: C I_h C over C.
            Sums to 1 over all holders.
        sigma: standard deviation of each direction.
        sigma_without: the same where the holder is missing; infinite where nothing else holds a direction.
        curvature: smallest singular value of dF/dxi in units of the prior's information; 1 is the prior alone.
    """

    motion: Float[np.ndarray, "h 6 6"]
    share: Float[np.ndarray, "h 6"]
    sigma: Float[np.ndarray, "6"]
    sigma_without: Float[np.ndarray, "h 6"]
    curvature: float


def influence(
    terms: HolderTerms, sigma: Float[np.ndarray, "6"], noise_excess: float = 1.0, singular_below: float = 0.05
) -> Influence:
    """The influence of every holder at the pose where the forces balance.

    Args:
        terms: Of `balance`.
        sigma: Standard deviations of the prior; 0 locks a direction.
        noise_excess: How many times more the residuals scatter than the model says; see `alignment.pose.assess`.
        singular_below: Curvature below which derivatives are damped, as in `alignment.implicit`.
    """
    _, J = _scaled(terms, sigma)
    U, s, Vt = np.linalg.svd(J)
    inverse = (Vt.T / np.maximum(s, singular_below)) @ U.T
    motion = -np.einsum("a,ab,b,hbc->hac", sigma, inverse, sigma, terms.by_motion)
    information = sigma[:, None] * terms.information * sigma
    information[: -len(PRIOR_PARTS)] /= noise_excess**2
    total = information.sum(axis=0) + np.diag(np.where(sigma > 0, 0.0, 1.0))
    C = np.linalg.inv(total)
    share = np.einsum("ia,hab,bi->hi", C, information, C) / np.diag(C)
    left = total - information
    values = np.linalg.eigvalsh(left)[:, 0]
    regular = np.where((values > 1e-9)[:, None, None], left, np.eye(6))
    without = np.sqrt(np.diagonal(np.linalg.inv(regular), axis1=1, axis2=2))
    without = np.where((values > 1e-9)[:, None], without, np.inf)
    scale = np.where(sigma > 0, sigma, 0.0)
    return Influence(motion, share, scale * np.sqrt(np.diag(C)), _times(without, scale), float(s[-1]))


def _times(without: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Scaled sigmas; 0 for locked directions."""
    return np.where(scale > 0, without * np.where(scale > 0, scale, 1.0), 0.0)
