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
from semloc_jax.residuals.holder_terms import HolderTerms, holder_terms
from semloc_jax.residuals.smooth import SmoothScene

PRIOR_PARTS = ("prior", "road")
"""Holders that are no map elements: position and heading of the prior; height and tilt of the road of the map."""
OF_PART = np.array([[1, 1, 0, 0, 0, 1], [0, 0, 1, 1, 1, 0]], bool)
"""Which directions of the tangent each part of the prior holds."""
_GENERATORS = np.zeros((6, 4, 4))
_GENERATORS[[0, 1, 2], [0, 1, 2], 3] = 1.0
_GENERATORS[[3, 4, 5], [2, 0, 1], [1, 2, 0]], _GENERATORS[[3, 4, 5], [1, 2, 0], [2, 0, 1]] = 1.0, -1.0


def prior_terms(T_local_base: Float[np.ndarray, "4 4"], prior: Prior) -> HolderTerms:
    """The terms of both parts of the prior (`PRIOR_PARTS`), which have no samples.

    The deviation is measured as in `alignment.implicit`: translation and axis-times-sine of T_prior^-1 T.
    """
    sigma = np.asarray(prior.sigma, np.float64)
    precision = np.where(sigma > 0, 1 / np.where(sigma > 0, sigma, 1.0), 0.0) ** 2
    D = rigid.inverse(np.asarray(prior.T_local_base, np.float64)) @ T_local_base
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
        T_local_base: relative to the local origin, float64.
        terms: float64; elements first, the parts of the prior last.
        is_exact: whether it is a minimum to the last digits of the float type.
    """

    T_local_base: Float[np.ndarray, "4 4"]
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
    T_local_base: Float[np.ndarray, "4 4"],
    scene: SmoothScene,
    prior: Prior,
    holder: tuple[Int[Array, "cam p"], ...],
    num_elements: int,
) -> Balance:
    """A pose that is no optimum, with terms in Gauss-Newton's approximation; arguments as `balance`."""
    terms = _evaluated(scene, prior, holder, num_elements)(np.asarray(T_local_base, np.float64))
    return Balance(T_local_base, terms._replace(by_pose=terms.information, by_motion=-terms.information), False)


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


_SINGULAR_BELOW = 0.05
"""Curvature below which derivatives are damped, as in `alignment.implicit`."""


def influence(terms: HolderTerms, sigma: Float[np.ndarray, "6"], noise_excess: float = 1.0) -> Influence:
    """The influence of every holder at the pose where the forces balance.

    Args:
        terms: Of `balance`.
        sigma: Standard deviations of the prior; 0 locks a direction.
        noise_excess: How many times more the residuals scatter than the model says; see `alignment.pose.assess`.
    """
    _, J = _scaled(terms, sigma)
    U, s, Vt = np.linalg.svd(J)
    inverse = (Vt.T / np.maximum(s, _SINGULAR_BELOW)) @ U.T
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
