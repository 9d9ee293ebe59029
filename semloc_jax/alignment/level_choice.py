"""Which level of the cost maps holds a pose, and how much a pose must explain (room: alignment; pure JAX).

In: share of the visible contour that is explained on each level. Out: index of the finest level that holds; the limits
on that share, each with its use.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


@dataclass(frozen=True)
class InlierLimits:
    """Least share of the visible contour within the ramp of its class, by what asks for it. All values are our choice.

    Nearest points of the literature's localizers have limits of their own: they count matched points.
    """

    level: float = 0.5
    """A finer level of one pose: below, it fits noise."""
    calibration: float = 0.35
    """A level of a calibration. Less than one pose needs: the scatter of single frames averages out."""
    found: float = 0.3
    """An answer of the search for a vehicle that is not tracked; below, it is not followed."""
    tracked: float = 0.28
    """The pose of a tracked frame. Less than `found`: what a search has just found does not fail in the next frame."""
    single_frame: float = 0.15
    """The pose of a frame by itself. Weak: traffic may hide most of the paint in view, and the limits on pieces of the
    map and their evidence (`VerdictConfig`) ask for what is left."""


INLIER_LIMITS = InlierLimits()


def holds(inlier_ratio: float | Float[Array, "*n"] | Float[np.ndarray, "*n"], least: float):
    """Whether a level holds a pose: a level finer than the scatter of the boundaries fits noise.

    Args:
        inlier_ratio: Share of the visible contour within the ramp of the level.
        least: Share that a level needs.
    """
    return inlier_ratio >= least


def telling(ramp_px: Float[Array, " level"], noise_px: float | Float[Array, ""], least: int) -> Int[Array, ""]:
    """Index of the level whose cost tells best how wrong a place is: the finest one that reaches over four times the
    noise of the boundaries. On a finer one everything beyond the next pixels is equally wrong, on a coarser one what is
    seen clearly hardly differs from what is not.

    Args:
        ramp_px: Ramp of each level, coarsest first.
        noise_px: Standard deviation of a boundary.
        least: The coarsest level that is taken.
    """
    reaches = ramp_px >= 4.0 * noise_px * (1.0 - 1e-3)
    return jnp.maximum(jnp.max(jnp.where(reaches, jnp.arange(len(ramp_px)), 0)), least)


def finest_held(
    inlier_ratio: Float[Array, " level"] | Float[np.ndarray, " level"], least: float
) -> Int[Array, ""] | np.integer:
    """Index of the finest level that holds a pose; the coarsest one where none does.

    Args:
        inlier_ratio: Share of the visible contour within the ramp of each level, coarsest first.
        least: Share that a level needs.
    """
    xp = np if isinstance(inlier_ratio, np.ndarray) else jnp
    return xp.max(xp.where(holds(inlier_ratio, least), xp.arange(len(inlier_ratio)), 0))
