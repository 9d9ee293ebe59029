"""What is known of the errors of mask boundaries: the one noise model of the package (room: residuals; pure JAX).

In: widths of ramps, scatter of residuals [px]. Out: NoiseModel: floors, gains and weights; the limit of an inlier.
Views weigh map samples by it, solvers turn the robust cost into nats with it, covariances come from it.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.errors import SemlocError

INLIER_REACH = 0.95
"""A contour nearer to a boundary of its class than this share of the ramp is explained by it: beyond, the ramp is
flat but for rounding. Ours."""

_LEAST_GRAIN = 0.2
"""Masks drawn from the map itself have a grain of 0.25: rounding to pixels is an error, too. Ours."""
_NOISE_OF_SCATTER = 1.5
"""Standard deviation of a boundary over the scatter of boundaries about a solved pose, which has taken a part of their
common errors with it. Degraded masks of two drives: 1.6 and 1.8 px of scatter, where a noise of 2 px has the errors of
the poses right."""

POSE_SHARE = 0.4
"""Variance of the pose of one frame over what `NoiseModel` gives it, which takes each stretch of contour for one
observation: errors of the two edges of a line cancel in part. Poses across the road and headings of four drives have
errors of 0.3 (exact masks) to 0.9 (masks without a network) of their sigmas with it."""

POSE_FREEDOM = 10.0
"""What the noise model is worth, in frames: the degrees of freedom of a sigma that it states. Ours."""

Pixels = float | np.floating | Float[np.ndarray, "*n"] | Float[Array, "*n"]


@dataclass(frozen=True)
class NoiseModel:
    """Errors of mask boundaries. All values are ours, but for those that `semloc learn` finds."""

    noise_px: float = 2.0
    """Standard deviation of a mask boundary [px]."""
    correlation_px: float = 60.0
    """Length of contour [px] over which the errors of a mask boundary are the same: one independent observation."""
    ramp_share: float = 0.15
    """On a coarse level the boundary noise counts as at least this share of the ramp: it is only a way to the next."""

    def __post_init__(self) -> None:
        if not (self.noise_px > 0 and self.correlation_px > 0 and self.ramp_share >= 0):
            raise SemlocError(
                f"noise: expected noise_px and correlation_px above 0, ramp_share not negative; got {self}"
            )

    def floor_px(self, ramp_px: Pixels, grain: Pixels = 1.0) -> Pixels:
        """Standard deviation of a boundary on a level with this ramp, in masks of this grain [px]."""
        return _at_least(self.ramp_share * ramp_px, self.noise_px * grain)

    def gain(self, ramp_px: Pixels, grain: Pixels = 1.0) -> Pixels:
        """Nats for each unit of sample weight x rho on a level with this ramp, in masks of this grain."""
        return (ramp_px / self.floor_px(ramp_px, grain)) ** 2 / (self.correlation_px * grain)

    def excess(self, scatter_px: Pixels, ramp_px: Pixels, grain: Pixels = 1.0) -> Pixels:
        """How many times larger than assumed the errors of a level are, told by their scatter [px]; at least 1."""
        return _at_least(scatter_px / self.floor_px(ramp_px, grain), 1.0)

    def grain(self, scatter_px: Pixels) -> Pixels:
        """The grain of masks: size of the errors of boundaries, and of the stretches over which they are the same, as
        a share of what the model has. Told by the scatter about a solved pose [px]; never above 1, see `excess`."""
        share = _NOISE_OF_SCATTER * scatter_px / self.noise_px
        return -_at_least(-_at_least(share, _LEAST_GRAIN), -1.0)

    @property
    def observations_per_px(self) -> float:
        """Independent observations for each pixel of contour."""
        return 1.0 / self.correlation_px

    @property
    def information_per_px(self) -> float:
        """Information about the place of a boundary for each pixel of contour [1 / px^2]."""
        return 1.0 / (self.noise_px**2 * self.correlation_px)


def _at_least(value: Pixels, least: Pixels) -> Pixels:
    if isinstance(value, jax.Array) or isinstance(least, jax.Array):
        return jnp.maximum(value, least)
    # A number of numpy is no weak type to JAX: it would turn float32 arrays into float64 ones.
    return np.maximum(value, least) if np.ndim(value) else float(max(value, least))


def is_inlier(ramp_value: Float[Array, "*n"] | Float[np.ndarray, "*n"]) -> Bool[Array, "*n"] | Bool[np.ndarray, "*n"]:
    """Whether each contour lies within reach of a boundary of its class, from its signed ramp value in [-1, 1]."""
    return abs(ramp_value) < INLIER_REACH
