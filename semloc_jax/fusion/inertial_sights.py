"""What views of landmarks say of the states that see them, and what the road says of landmarks on it (room: fusion;
pure JAX).

In: Views, values of states and landmarks. Out: whitened residuals, normal equations with the landmarks apart.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.fusion.inertial_states import SEEN, SIZES
from semloc_jax.residuals.inverse_depth import (
    Sight,
    on_road_linearised,
    on_road_residual,
    sight_linearised,
    sight_residual,
)
from semloc_jax.residuals.motion import cauchy_cost
from semloc_jax.solvers import landmark_kernels
from semloc_jax.solvers.graph import Values

_HIGHEST = jax.lax.Precision.HIGHEST
_TOUCHED = "pose", "height", "bend"


class Views(NamedTuple):
    """Landmarks and the times that see them."""

    anchor: Int[Array | np.ndarray, " l"]
    """State that saw the landmark first."""
    camera: Int[Array | np.ndarray, " l"]
    axes: Float[Array | np.ndarray, "l 3 3"]
    """R_cam_axes at the anchor."""
    ray_cam: Float[Array | np.ndarray, "l f 3"]
    pixels: Float[Array | np.ndarray, "l f 2 3"]
    sqrt_info: Float[Array | np.ndarray, "l f"]
    """1 / standard deviation [1/px] of the step of the track that ends at each view, and of the first view at the
    anchor; 0 where the landmark is not seen. Views follow each other without a gap."""
    T_base_cam: Float[Array | np.ndarray, "f c 4 4"]
    up: Float[Array | np.ndarray, "l 3"]
    """Vertical axis of the base at the anchor, in `axes`."""
    lift_m: Float[Array | np.ndarray, " l"]
    """Height of the camera in the base at the anchor."""
    away_m: Float[Array | np.ndarray, " l"]
    """How far from the camera its line of sight meets a flat road, over ground."""
    on_road: Float[Array | np.ndarray, " l"]
    """See `on_road_residual`: its weight; 0 for a landmark that is not known to lie on the road."""

    def only(self, is_kept: Bool[Array | np.ndarray, " l"]) -> "Views":
        """With weights for these landmarks alone."""
        where = jnp.where if isinstance(is_kept, Array) else np.where
        return self._replace(
            sqrt_info=where(is_kept[:, None], self.sqrt_info, 0.0), on_road=where(is_kept, self.on_road, 0.0)
        )


class SeenEquations(NamedTuple):
    """Normal equations of landmarks; the unknowns of states are all poses, then all heights, then all bends."""

    cost: Float[Array, ""]
    gradient: Float[Array, " p"]
    information: Float[Array, "p p"]
    landmark_gradient: Float[Array, "l 3"]
    landmark: Float[Array, "l 3 3"]
    across: Float[Array, "l p 3"]


def _arguments(views: Views, value: Values) -> tuple:
    """Arguments of the residual of every landmark and time, [l f ...]."""
    num_l, num_f = jnp.shape(views.sqrt_info)
    T_base_cam = jnp.asarray(views.T_base_cam)[:, views.camera].swapaxes(0, 1)
    anchor = jnp.asarray(views.anchor)
    T_anchor_cam = jnp.take_along_axis(T_base_cam, anchor[:, None, None, None], axis=1)
    many = (num_l, num_f)
    sight = Sight(
        jnp.broadcast_to(jnp.asarray(views.axes)[:, None], (*many, 3, 3)),
        jnp.broadcast_to(T_anchor_cam, (*many, 4, 4)),
        T_base_cam,
        jnp.asarray(views.ray_cam),
        jnp.asarray(views.pixels),
    )
    T_map_anchor = jnp.broadcast_to(value["pose"][anchor][:, None], (*many, 4, 4))
    T_map_base = jnp.broadcast_to(value["pose"][None], (*many, 4, 4))
    landmark = jnp.broadcast_to(value["landmark"][:, None], (*many, 3))
    return T_map_anchor, T_map_base, landmark, sight, (jnp.asarray(views.sqrt_info) > 0).astype(landmark.dtype)


def step_residuals(views: Views, value: Values) -> Float[Array, "l f 2"]:
    """Whitened steps of all tracks away from their landmarks; zero where a landmark is not seen.

    A corner is followed from image to image, so its error in one image is that in the image before and a new one.
    """
    r = jax.vmap(jax.vmap(sight_residual))(*_arguments(views, value))
    return _steps_of(r, views) * jnp.asarray(views.sqrt_info)[..., None]


def seen_equations(views: Views, value: Values, at: Values, threshold: float) -> SeenEquations:
    """What views and road say at the values, with derivatives by the states taken at `at`.

    Args:
        views: Landmarks and what was seen of them.
        value: States and landmarks.
        at: States, maybe at first estimates.
        threshold: Whitened distance beyond which the pull of one step grows no more.
    """
    if landmark_kernels.are_used(jnp.result_type(value["landmark"])):
        states = *(value[name] for name in _TOUCHED), value["landmark"], *(at[name] for name in _TOUCHED)
        anchor, camera, *rest = views
        states, indices, rest = jax.tree.map(jnp.asarray, (states, (anchor, camera), tuple(rest)))
        return SeenEquations(*landmark_kernels.seen(*states, indices, rest, threshold))
    return _by_jax(views, value, at, threshold)


def _by_jax(views: Views, value: Values, at: Values, threshold: float) -> SeenEquations:
    r = jax.vmap(jax.vmap(sight_residual))(*_arguments(views, value))
    _, Ja, Jk, Jl = jax.vmap(jax.vmap(sight_linearised))(*_arguments(views, at | {"landmark": value["landmark"]}))
    sqrt_info = jnp.asarray(views.sqrt_info)
    steps = _steps_of(r, views) * sqrt_info[..., None]
    cost, root = jax.vmap(jax.vmap(lambda one: cauchy_cost(_kept_from_zero(one), threshold)))(steps)
    weights = _StepWeights.of(sqrt_info * root, views)
    r, Wa, Wl = (weights.times(part) for part in (r, Ja, Jl))
    num_l, num_f = r.shape[:2]
    of_anchor = jax.nn.one_hot(jnp.asarray(views.anchor), num_f, dtype=r.dtype)
    g = jnp.einsum("lfri,lfr->fi", Jk, r, precision=_HIGHEST)
    g += jnp.einsum("lg,lfri,lfr->gi", of_anchor, Ja, r, precision=_HIGHEST)
    between = jnp.einsum("lg,lfij->gfij", of_anchor, _gram(Wa, Jk), precision=_HIGHEST)
    anchors = jnp.einsum("lg,lij->gij", of_anchor, jnp.sum(_gram(Ja, Wa), axis=1), precision=_HIGHEST)
    H = between + between.transpose(1, 0, 3, 2)
    here, before = jnp.arange(num_f), jnp.arange(num_f - 1)
    beside = -_sum_gram(Jk[:, 1:] * weights.back[:, 1:, None, None], Jk[:, :-1])
    H = H.at[here, here].add(anchors + _sum_gram(Jk * weights.own[..., None, None], Jk))
    H = H.at[before + 1, before].add(beside).at[before, before + 1].add(beside.swapaxes(1, 2))
    across = _gram(Jk, Wl) + of_anchor[:, :, None, None] * jnp.sum(_gram(Ja, Wl), axis=1)[:, None]
    is_used = jnp.any(jnp.asarray(views.sqrt_info) > 0, axis=1)
    landmark = jnp.sum(_gram(Jl, Wl), axis=1)
    # Inverse depths of points that show no parallax stay where they are: a prior far beyond what any road holds.
    weak = jnp.diag(jnp.asarray([1e-4, 1e-4, 1e-2], r.dtype))
    landmark += jnp.where(is_used[:, None, None], weak, jnp.eye(3, dtype=r.dtype))
    road = _on_road(views, value, at, threshold)
    poses, num = SIZES["pose"] * num_f, SEEN * num_f
    both = jnp.einsum("lg,lab,gh->agbh", of_anchor, road.information, jnp.eye(num_f), precision=_HIGHEST)
    beside = jnp.einsum("lg,lak->lagk", of_anchor, road.across, precision=_HIGHEST)
    return SeenEquations(
        jnp.sum(cost) + jnp.sum(road.cost),
        jnp.concatenate([g.ravel(), (road.gradient.T @ of_anchor).ravel()]),
        jnp.zeros((num, num), r.dtype)
        .at[:poses, :poses]
        .set(H.transpose(0, 2, 1, 3).reshape(poses, poses))
        .at[poses:, poses:]
        .set(both.reshape(num - poses, num - poses)),
        jnp.einsum("lfri,lfr->li", Jl, r, precision=_HIGHEST) + road.landmark_gradient,
        landmark + road.landmark,
        jnp.concatenate([across.reshape(num_l, poses, 3), beside.reshape(num_l, num - poses, 3)], axis=1),
    )


class _Road(NamedTuple):
    """Normal equations of landmarks on the road, by height and bend at each one's anchor and by the landmark."""

    cost: Float[Array, " l"]
    gradient: Float[Array, "l 2"]
    information: Float[Array, "l 2 2"]
    landmark_gradient: Float[Array, "l 3"]
    landmark: Float[Array, "l 3 3"]
    across: Float[Array, "l 2 3"]


def _on_road(views: Views, value: Values, at: Values, threshold: float) -> _Road:
    known = views.up, views.lift_m, views.away_m, views.on_road[:, None]
    data = value["landmark"], *(jnp.asarray(part) for part in known)
    here, there = ([of[name][views.anchor] for name in _TOUCHED[1:]] for of in (value, at))
    r = jax.vmap(on_road_residual)(*here, *data)
    _, *by_road, by_landmark = jax.vmap(on_road_linearised)(*there, *data)
    cost, root = jax.vmap(lambda one: cauchy_cost(_kept_from_zero(one), threshold))(r)
    r, Jl = root * r[:, 0], root[:, None] * by_landmark[:, 0]
    Jr = root[:, None] * jnp.concatenate(by_road, axis=2)[:, 0]
    return _Road(
        cost,
        Jr * r[:, None],
        Jr[:, :, None] * Jr[:, None],
        Jl * r[:, None],
        Jl[:, :, None] * Jl[:, None],
        Jr[:, :, None] * Jl[:, None],
    )


def _steps_of(r: Float[Array, "l f 2"], views: Views) -> Float[Array, "l f 2"]:
    """Errors less those of the view before, where there is one."""
    seen = jnp.asarray(views.sqrt_info) > 0
    is_followed = (seen[:, 1:] & seen[:, :-1])[..., None]
    return jnp.concatenate([r[:, :1], r[:, 1:] - jnp.where(is_followed, r[:, :-1], 0.0)], axis=1)


class _StepWeights(NamedTuple):
    """W of each landmark with r W r = sum of its squared whitened steps: a band of three."""

    own: Float[Array, "l f"]
    back: Float[Array, "l f"]
    """Minus the entry of each view and the one before; zero for the first."""

    @classmethod
    def of(cls, sqrt_info: Float[Array, "l f"], views: Views) -> "_StepWeights":
        seen = jnp.asarray(views.sqrt_info) > 0
        info = sqrt_info**2
        back = jnp.where(seen[:, 1:] & seen[:, :-1], info[:, 1:], 0.0)
        return cls(info + jnp.pad(back, ((0, 0), (0, 1))), jnp.pad(back, ((0, 0), (1, 0))))

    def times(self, parts: Float[Array, "l f ..."]) -> Float[Array, "l f ..."]:
        """W times one matrix of each landmark."""
        shape = (*self.own.shape, *(1,) * (parts.ndim - 2))
        own, back = self.own.reshape(shape), self.back.reshape(shape)
        nothing = jnp.zeros_like(parts[:, :1])
        before = jnp.concatenate([nothing, back[:, 1:] * parts[:, :-1]], axis=1)
        after = jnp.concatenate([back[:, 1:] * parts[:, 1:], nothing], axis=1)
        return own * parts - before - after


def _gram(A: Array, B: Array) -> Array:
    return jnp.einsum("lfri,lfrj->lfij", A, B, precision=_HIGHEST)


def _sum_gram(A: Array, B: Array) -> Array:
    return jnp.einsum("lfri,lfrj->fij", A, B, precision=_HIGHEST)


def _kept_from_zero(r: Array) -> Array:
    # The norm has no derivative at zero; nobody asks for one, but NaN must not appear.
    return jnp.where(jnp.any(r != 0), r, 1e-12)
