"""What is known of the states of a window from before it began (room: fusion; JAX, host around it).

In: a first guess and its standard deviations, or what states that left say of the others. Out: WindowPrior.
First estimates: a state that the prior touches keeps the value at which it was first linearised in every derivative
(Huang, Mourikis, Roumeliotis, IJRR 2010); otherwise the window would think that it sees the yaw. Cameras do not see the
size of the way either, and the window learns it late: so first estimates go along with it, as places on a map that is
drawn larger. What the prior says is kept in that drawing, and its null space with it.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.fusion.inertial_states import AT, SIZES, STATE, unknowns_of
from semloc_jax.geometry import lie
from semloc_jax.solvers.dense import DenseEquations
from semloc_jax.solvers.graph import Values

_STILL_M2 = 1.0
"""A window whose states lie closer together shows no size."""
_LEAST_SCALE, _MOST_SCALE = 0.5, 2.0
_HIGHEST = jax.lax.Precision.HIGHEST


class _Drawing(NamedTuple):
    """How first estimates lie in the window as it is now: p_now = to + scale (p_first - about)."""

    scale: Float[Array, ""]
    about: Float[Array, "3"]
    to: Float[Array, "3"]


class WindowPrior(eqx.Module):
    """What is known of the states from before: cost = g d + 0.5 d H d, d from the first estimates."""

    first: Values
    """First estimates of every state, by family."""
    touched: Bool[Array | np.ndarray, " f"]
    """States that the prior knows of."""
    held: Bool[Array | np.ndarray, " f"]
    """States whose derivatives are taken at their first estimates: those touched, but for the very first prior."""
    gradient: Float[Array | np.ndarray, " d"]
    information: Float[Array | np.ndarray, "d d"]

    def slopes_at(self, value: Values) -> Values:
        """Where derivatives are taken: held states at their first estimates, which go along with the window."""
        held, moved = jnp.asarray(self.held), self._moved_first(value)

        def chosen(first: Array, now: Array) -> Array:
            return jnp.where(jnp.reshape(held, (-1,) + (1,) * (now.ndim - 1)), first, now)

        return {name: chosen(jnp.asarray(moved[name]), jnp.asarray(value[name])) for name in SIZES}

    def equations(self, value: Values) -> DenseEquations:
        """Cost, gradient and information by the states at their values."""
        d, per = self.deviation(value), self.per_drawing(value)
        pull = jnp.matmul(self.information, d, precision=_HIGHEST)
        cost = jnp.dot(self.gradient, d) + 0.5 * jnp.dot(d, pull)
        return DenseEquations(cost, per * (self.gradient + pull), per[:, None] * self.information * per)

    def deviation(self, value: Values) -> Float[Array, " d"]:
        """The states less the first estimates of those that the prior touches, zero for the others.

        In the drawing of the first estimates: distances are divided by the change of size, and that change itself is
        the logarithm of it times the place in the drawing.
        """
        drawing, moved = self._drawing(value), self._moved_first(value)
        T_first = jnp.asarray(self.first["pose"])
        grown = jnp.log(drawing.scale)
        xi = lie.log(lie.compose(lie.inverse(moved["pose"]), value["pose"]))
        shift = grown * (T_first[:, :3, 3] - drawing.about) + drawing.to - drawing.about
        own = jnp.einsum("fji,fj->fi", T_first[:, :3, :3], shift, precision=_HIGHEST)
        parts = {name: value[name] - moved[name] for name in SIZES if name != "pose"}
        parts["velocity"] = parts["velocity"] / drawing.scale + grown * jnp.asarray(self.first["velocity"])
        parts["pose"] = jnp.concatenate([xi[:, :3] / drawing.scale + own, xi[:, 3:]], axis=1)
        kept = jnp.asarray(self.touched)[:, None]
        return jnp.concatenate([jnp.where(kept, parts[name], 0.0).ravel() for name in SIZES])

    def per_drawing(self, value: Values) -> Float[Array, " d"]:
        """Derivative of each deviation by its unknown: the inverse change of size for places and velocities."""
        num = len(self.touched)
        is_metric = np.zeros((num, STATE), bool)
        is_metric[:, :3], is_metric[:, AT["velocity"]] = True, True
        is_metric = np.concatenate([is_metric[:, AT[name]].ravel() for name in SIZES])
        return jnp.where(is_metric, 1.0 / self._drawing(value).scale, 1.0)

    def _moved_first(self, value: Values) -> Values:
        drawing, first = self._drawing(value), dict(self.first)
        T = jnp.asarray(first["pose"])
        first["pose"] = T.at[:, :3, 3].set(drawing.to + drawing.scale * (T[:, :3, 3] - drawing.about))
        first["velocity"] = drawing.scale * jnp.asarray(first["velocity"])
        return first

    def _drawing(self, value: Values) -> _Drawing:
        """The one that brings the first estimates of held states nearest to their values."""
        held = jnp.asarray(self.held)[:, None]
        first, now = jnp.asarray(self.first["pose"])[:, :3, 3], jnp.asarray(value["pose"])[:, :3, 3]
        num = jnp.maximum(jnp.sum(held), 1)
        about, to = (jnp.sum(jnp.where(held, p, 0.0), axis=0) / num for p in (first, now))
        a, b = (jnp.where(held, p - centre, 0.0) for p, centre in ((first, about), (now, to)))
        scale = (jnp.sum(a * b) + _STILL_M2) / (jnp.sum(a * a) + _STILL_M2)
        return _Drawing(jnp.clip(scale, _LEAST_SCALE, _MOST_SCALE), about, to)


def first_prior(values: Values, sigma: Float[np.ndarray, "22"], R_map_base: Float[np.ndarray, "3 3"]) -> WindowPrior:
    """A prior of the first state alone.

    Args:
        values: Of all states; the first is the mean.
        sigma: Standard deviations by family; those of the rotation about the axes of the map.
        R_map_base: Attitude of the first state.
    """
    num = len(values["pose"])
    information = np.zeros((STATE * num, STATE * num))
    own, turn = np.diag(1.0 / sigma**2), slice(AT["pose"].start + 3, AT["pose"].stop)
    own[turn, turn] = R_map_base.T @ own[turn, turn] @ R_map_base
    at = unknowns_of(np.arange(1), num)
    information[np.ix_(at, at)] = own
    touched = np.arange(num) == 0
    first = {name: np.array(values[name]) for name in SIZES}
    return WindowPrior(first, touched, np.zeros(num, bool), np.zeros(len(information)), information)


def moved_prior(
    prior: WindowPrior, left: DenseEquations, slopes_at: Values, values: Values, num_gone: int
) -> WindowPrior:
    """The prior some states later, around the first estimates of all states that it knows of now (pure JAX).

    Args:
        prior: Before.
        left: What the states that leave say of the others, with the prior.
        slopes_at: Where its derivatives were taken.
        values: Where its gradient was taken.
        num_gone: States that leave.
    """
    num = len(prior.touched)
    source = np.full(STATE * num, len(left.gradient))
    source[unknowns_of(np.arange(num - num_gone), num)] = np.arange(len(left.gradient))
    g = jnp.pad(left.gradient, (0, 1))[source]
    H = jnp.pad(0.5 * (left.information + left.information.T), (0, 1))[source[:, None], source]
    size = jnp.max(jnp.abs(H), axis=1)[np.stack([unknowns_of(np.array([k]), num) for k in range(num)])]
    touched = jnp.max(size, axis=1) > 0
    first, now = ({name: shifted(jnp.asarray(of[name]), num_gone) for name in SIZES} for of in (slopes_at, values))
    # The gradient was taken at the values, not at the first estimates.
    moved = WindowPrior(first, touched, touched, g, H)
    at_first = g / moved.per_drawing(now) - jnp.matmul(H, moved.deviation(now), precision=_HIGHEST)
    return WindowPrior(first, touched, touched, at_first, H)


def shifted(array: Array | np.ndarray, num_gone: int) -> Array | np.ndarray:
    """Some states later; the last is repeated."""
    return array[np.minimum(np.arange(len(array)) + num_gone, len(array) - 1)]
