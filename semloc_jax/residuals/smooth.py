"""The alignment cost as a function with continuous second derivatives (room: residuals; pure JAX).

In: a vehicle pose, views, a signed-distance map of one level, a model of each channel. Out: the cost in nats.
Derivatives of a solution ask for the curvature of the cost: bilinear taps have none. Here are cubic B-spline taps.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from semloc_jax.residuals.alignment import CameraViews, Usable, points_in_camera
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.structs import CostMaps


class DistanceMaps(eqx.Module):
    """Signed distance to the boundary of each channel's mask at one level of the cost maps, in plain floats."""

    distance_px: Float[Array, "cam channel h w"]
    """Pixels of the full mask; saturates where the stored ramp ends."""
    stride: int | float = eqx.field(static=True)


class ChannelModel(eqx.Module):
    """How the boundary of each channel is weighed; every leaf may be differentiated by."""

    weight: Float[Array, " channel"]
    """Factor on the weight of the samples of the channel."""
    ramp_px: Float[Array, " channel"]
    """Distance at which the ramp ends [px]; of effect up to the ramp of the stored cost map."""
    loss_scale: Float[Array, " channel"]
    """Where the robust loss saturates, as a share of the ramp."""
    noise_px: Float[Array, " channel"]
    """Standard deviation of the boundary [px]."""


class SmoothBorder(eqx.Module):
    """How samples fade out where the image ends."""

    border_px: float = eqx.field(static=True, default=2.0)
    """Samples nearer to the border than this count nothing."""
    fade_px: float = eqx.field(static=True, default=8.0)
    """Over this width they grow to their full weight."""


class SmoothScene(eqx.Module):
    """Everything that the cost is a function of, beside the pose: derivatives by any float leaf exist."""

    views: tuple[CameraViews, ...]
    """Intrinsics, extrinsics T_cam_base, map points and weights of all cameras."""
    maps: DistanceMaps
    usable: Usable
    model: ChannelModel
    nats_per_px: Float[Array, ""]
    """Independent observations in one pixel of contour."""
    border: SmoothBorder = SmoothBorder()


def distance_maps(maps: CostMaps, level: int = -1) -> DistanceMaps:
    """The signed distances of one level of the cost maps; they end where its ramp ends."""
    ramp = maps.ramps[level]
    if ramp.dtype == jnp.uint8:  # bytes 0 .. 254 span [-1, 1]
        ramp = ramp.astype(jnp.float32) / 127.0 - 1.0
    return DistanceMaps(ramp * maps.ramp_px[level], maps.stride[level])


class CubicPatch(NamedTuple):
    """The 16 pixels around a place between pixels, and where it lies among them."""

    taps: Float[Array, "4 4 *n"]
    """Pixels by row and column."""
    fx: Float[Array, "*n"]
    fy: Float[Array, "*n"]


def cubic_patch(image: Array, plane: Int[Array, "..."], x: Float[Array, "*n"], y: Float[Array, "*n"]) -> CubicPatch:
    """The pixels of a stack of images [plane h w] around (x, y) [px of the image].

    Beyond the border of an image all is as on its border.
    """
    _, height, width = image.shape
    # NaN would survive a clip and index wildly.
    x = jnp.clip(jnp.nan_to_num(x), -2.0, width + 1.0)
    y = jnp.clip(jnp.nan_to_num(y), -2.0, height + 1.0)
    column, row = jnp.floor(jax.lax.stop_gradient(x)), jnp.floor(jax.lax.stop_gradient(y))
    near = jnp.arange(-1, 3).reshape(4, *(1,) * x.ndim)
    columns = jnp.clip(column.astype(jnp.int32) + near, 0, width - 1)
    rows = jnp.clip(row.astype(jnp.int32) + near, 0, height - 1)
    flat = (plane * height + rows)[:, None] * width + columns[None]
    taps = image.reshape(-1).at[flat].get(mode="promise_in_bounds").astype(x.dtype)
    return CubicPatch(jnp.nan_to_num(taps), x - column, y - row)


def cubic_weights(f: Array, order: int = 0) -> tuple[Array, Array, Array, Array]:
    """Weights of the four taps of a uniform cubic B-spline, or of its first or second derivative.

    The coefficients are the pixels themselves, not prefiltered ones: the result stays within the values of the map,
    depends on 16 pixels only, and is exact on straight boundaries. (Prefiltering would overshoot where the ramp ends
    and make every pixel depend on its whole row and column.) A boundary of radius R moves by 1 / (6 R) px^2.
    """
    g = 1 - f
    if order == 0:
        weights = g * g * g, 4 - 3 * f * f * (1 + g), 4 - 3 * g * g * (1 + f), f * f * f
        return tuple(weight / 6 for weight in weights)
    if order == 1:
        return -g * g / 2, f * (1.5 * f - 2), g * (2 - 1.5 * g), f * f / 2
    return g, 3 * f - 2, 3 * g - 2, f


def cubic_value(patch: CubicPatch, order_x: int = 0, order_y: int = 0) -> Float[Array, "*n"]:
    """The spline, twice continuously differentiable, or a derivative of it [1 / px]."""
    weights_x, weights_y = cubic_weights(patch.fx, order_x), cubic_weights(patch.fy, order_y)
    return sum(weights_y[j] * sum(weights_x[k] * patch.taps[j, k] for k in range(4)) for j in range(4))


def smooth_step(t: Array) -> tuple[Array, Array]:
    """0 below 0, 1 above 1, between them the quintic with continuous second derivatives; and its slope."""
    t = jnp.clip(t, 0.0, 1.0)
    return t * t * t * (t * (6 * t - 15) + 10), 30 * (t * (1 - t)) ** 2


def seen_share(
    u: Array, v: Array, view: CameraViews, usable: Usable, border: SmoothBorder
) -> tuple[Float[Array, " p"], Float[Array, " p"], Float[Array, " p"]]:
    """Share in [0, 1] to which pixels of one camera are seen, and its derivatives by u and v [1 / px].

    It fades at the border of the image and at unusable pixels.
    """
    x, y = ((w + 0.5) / usable.stride - 0.5 for w in (u, v))
    patch = cubic_patch(usable.mask, view.index, x, y)
    free, slope = smooth_step(cubic_value(patch))
    across, by_u = _between(u, view.camera.width, border)
    down, by_v = _between(v, view.camera.height, border)
    free_u, free_v = (slope * cubic_value(patch, *order) / usable.stride for order in ((1, 0), (0, 1)))
    return across * down * free, down * (by_u * free + across * free_u), across * (by_v * free + down * free_v)


def _between(w: Array, size: Array, border: SmoothBorder) -> tuple[Array, Array]:
    """The share along one axis of an image, and its derivative."""
    low = border.border_px - 0.5
    (rise, up), (fall, down) = (smooth_step(t / border.fade_px) for t in (w - low, size - 1 - low - w))
    return rise * fall, (up * fall - rise * down) / border.fade_px


def distance_patch(u: Array, v: Array, view: CameraViews, maps: DistanceMaps) -> CubicPatch:
    """The distances around pixels (u, v) of one camera, each in the channel of its sample."""
    _, num_channels, height, width = maps.distance_px.shape
    planes = maps.distance_px.reshape(-1, height, width)
    scale = 1 / maps.stride
    return cubic_patch(
        planes, view.index * num_channels + view.channel, (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5
    )


def reach_and_gain(channel: Int[Array, "*n"], model: ChannelModel) -> tuple[Array, Array]:
    """Distance at which the loss saturates [px], and nats of one observation for each unit of its penalty.

    Tukey's loss: where it saturates slope and curvature are zero on both sides, so second derivatives are continuous.
    """
    reach_px = (model.ramp_px * model.loss_scale)[channel]
    return reach_px, model.weight[channel] * (reach_px / model.noise_px[channel]) ** 2


def _pixels(T_local_base: Array, view: CameraViews) -> tuple[Array, Array, Array]:
    return view.camera.project_xyz(*points_in_camera(view.T_cam_base, T_local_base, view.p_map))


def smooth_weights(T_local_base: Float[Array, "4 4"], scene: SmoothScene) -> tuple[Float[Array, "cam p"], ...]:
    """Weight of every sample [independent observations], with visibility from a pose."""

    def one(view: CameraViews) -> Array:
        u, v, valid = _pixels(T_local_base, view)
        seen = jnp.where(valid, seen_share(u, v, view, scene.usable, scene.border)[0], 0.0)
        return scene.nats_per_px * view.weight * seen

    return tuple(jax.vmap(one)(view) for view in scene.views)


def smooth_distances(T_local_base: Float[Array, "4 4"], scene: SmoothScene) -> tuple[Float[Array, "cam p"], ...]:
    """Signed distance [px] of every sample to the boundary of its own channel."""

    def one(view: CameraViews) -> Array:
        u, v, _ = _pixels(T_local_base, view)
        return cubic_value(distance_patch(u, v, view, scene.maps))

    return tuple(jax.vmap(one)(view) for view in scene.views)


def smooth_cost(
    T_local_base: Float[Array, "4 4"], weights: tuple[Float[Array, "cam p"], ...], scene: SmoothScene
) -> Float[Array, ""]:
    """Robust cost of the evidence [nats] with given weights; the one definition of what is minimised.

    The weights come in from outside: visibility that the solver may change is a force that pushes bad samples out of
    the image (12 cm on a road). They follow the pose, but the pose does not follow them.
    """
    total = jnp.zeros((), T_local_base.dtype)
    for view, weight, distance in zip(scene.views, weights, smooth_distances(T_local_base, scene), strict=True):
        reach_px, gain = reach_and_gain(view.channel, scene.model)
        total = total + jnp.sum(weight * gain * LOSSES["tukey"].rho(distance / reach_px))
    return total
