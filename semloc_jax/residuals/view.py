"""Map samples as one place sees them: contours of round things, visibility, uniform density in the image (room:
residuals; pure JAX).

In: MapSamples, an approximate pose, the rig. Out: ViewSamples, one bucket of fixed capacity for each camera.
What is decided here depends so weakly on the pose that it is kept while the pose is searched within metres.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.cameras import Camera, Rig
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import lie
from semloc_jax.residuals import native_kernels
from semloc_jax.residuals.native_kernels import Path
from semloc_jax.residuals.noise import NoiseModel
from semloc_jax.residuals.projection import projected
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.structs import ElementClass, MapSamples, SampleKind, ViewSamples


@dataclass(frozen=True)
class ViewConfig:
    """How map samples are chosen for a view. All values are ours; the paper gives none."""

    capacity: int = 1024
    """Samples kept for each camera."""
    margin_share: float = 0.0
    """Share of the image width by which a sample may lie outside the image and still be kept (for wide searches)."""
    max_range_m: float = 60.0
    """Samples farther from the camera are left out: they are too small for the mask and hidden too often."""
    min_ground_px_per_m: float = 0.6
    """What lies on the ground is left out where one metre away from the camera is fewer pixels than this, of those
    that the camera took (`Rig.finer`): seen at such a grazing angle paint is mostly hidden and its mask is noise
    (f h / r^2: 42 m for a usual front camera)."""
    min_spacing_px: float = 1.5
    """Closest spacing of samples along a contour in the image [px]."""
    metric_exponent: float = 0.0
    """Weight of a sample is (length in px)^(1-a) (length in m x px_per_m)^a: 0 weighs the image, 1 the world evenly."""
    shared_error: float = 0.1
    """Variance of an element's place in the map over that of one independent observation of its border."""
    noise: NoiseModel = field(default_factory=NoiseModel)
    """How long one independent observation of a border is, and how far off."""
    most_alone: float = 1.0
    """An edge shorter than `noise.correlation_px` is still one observation: its samples weigh more by the ratio of the
    two, up to this factor. Ends of dashes, 3 to 10 px long, tell where along the road a frame is. 1 weighs by length
    only."""
    class_weight: tuple[float, ...] = ()
    """Factor on the weight of each ElementClass, in its order; empty for 1. `semloc learn` finds them."""
    path: Path = "auto"
    """How points are projected; see `semloc_jax.residuals.native_kernels`."""

    def __post_init__(self) -> None:
        if len(self.class_weight) not in (0, len(ElementClass)) or any(not w >= 0 for w in self.class_weight):
            raise SemlocError(
                f"view: class_weight has {len(self.class_weight)} values {self.class_weight}; expected one that is not "
                f"negative for each of {', '.join(label.name.lower() for label in ElementClass)}, or none"
            )


GROUND_CLASSES = (0, 1, 2, 3, 4, 5, 6)
"""ElementClass values of what is painted on the ground: the first ones."""
PX_PER_M = 20.0
"""Pixels for each metre of contour in the evenly weighted world: a contour about 40 m away in a usual camera."""


def contour_points(samples: MapSamples, center_map: Float[Array, "3"]) -> tuple[Float[Array, "n 3"], Bool[Array, " n"]]:
    """Where the contour of each sample lies when seen from `center_map`, and whether it is a contour from there.

    ROUND: the point where the line of sight touches the cylinder. CORNER: kept if it is outermost, which is where
    exactly one of its two faces is turned to the camera: the line of sight runs across the bisector of the corner.
    """
    sight = samples.p_map - center_map
    side = jnp.cross(samples.tangent_map, sight)
    distance = jnp.maximum(jnp.linalg.norm(side, axis=-1, keepdims=True), 1e-6)
    side = side / distance
    radius = jnp.where(samples.kind == SampleKind.ROUND, samples.offset_m, 0.0)[:, None]
    share = jnp.clip(radius / distance, -0.9, 0.9)
    to_camera = jnp.cross(samples.tangent_map, side)
    p_map = samples.p_map + radius * (jnp.sqrt(1 - share * share) * side + share * to_camera)
    reach = jnp.abs(jnp.sum((samples.p_map - samples.center_map) * side, axis=-1))
    is_contour = (samples.kind != SampleKind.CORNER) | (reach >= samples.offset_m)
    return p_map, is_contour


def view(
    samples: MapSamples,
    T_local_base: Float[Array, "4 4"],
    rig: Rig,
    channel_of_label: Int[Array, " label"],
    config: ViewConfig,
    grain: Float[Array | np.ndarray, ""] | float = 1.0,
) -> ViewSamples:
    """The samples that the rig sees from about `T_local_base`, thinned to uniform density along contours in the image.

    Args:
        samples: Samples in the map frame relative to the local origin [m].
        T_local_base: Approximate vehicle pose in that frame.
        rig: Cameras.
        channel_of_label: Cost-map channel of each ElementClass; -1 where no mask shows the class.
        config: Ranges, density, capacity.
        grain: Of the masks, see `NoiseModel.grain`.

    Which samples are kept, their weights and the silhouettes of round things are constants to a derivative: they stay
    as they are while the pose is solved. The points themselves are differentiable by `samples.p_map`.
    """
    points = samples.p_map
    samples, T_local_base, rig = jax.lax.stop_gradient((samples, T_local_base, rig))
    config = replace(config, min_ground_px_per_m=rig.finer * config.min_ground_px_per_m)
    dtype = T_local_base.dtype
    buckets = []
    for camera, T_base_cam in zip(rig.cameras, rig.T_base_cam, strict=True):
        native = native_kernels.use(config.path, camera, LOSSES["tukey"], dtype) == "analytic"
        one_camera = _native_view if native else _camera_view
        T_base_cam = jnp.asarray(T_base_cam, dtype)
        buckets.append(one_camera(samples, points, T_local_base, T_base_cam, camera, channel_of_label, config, grain))
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *buckets)


def _native_view(
    samples: MapSamples,
    points: Array,
    T_local_base: Array,
    T_base_cam: Array,
    camera: Camera,
    channel_of_label: Array,
    config: ViewConfig,
    grain: Array | np.ndarray | float,
) -> ViewSamples:
    """`_camera_view` by one kernel: most of what XLA has to compile for a view is not arithmetic but sums by index."""
    noise = config.noise.noise_px, config.noise.correlation_px
    limits = config.margin_share, config.max_range_m, config.min_ground_px_per_m, config.min_spacing_px
    numbers = (*limits, config.metric_exponent, config.shared_error, *noise, config.most_alone, PX_PER_M)
    seen = native_kernels.view(
        T_local_base,
        T_base_cam,
        samples,
        jnp.asarray(channel_of_label),
        jnp.asarray(config.class_weight or (1.0,) * len(ElementClass), jnp.float32),
        jnp.asarray(grain, jnp.float32),
        jnp.asarray(numbers, jnp.float32),
        camera,
        config.capacity,
        len(GROUND_CLASSES),
    )
    p_map = points[seen.index].T + seen.silhouette_map
    return ViewSamples(p_map, seen.tangent_map, seen.channel, seen.weight, seen.element, seen.edge)


def _camera_view(
    samples: MapSamples,
    points: Array,
    T_local_base: Array,
    T_base_cam: Array,
    camera: Camera,
    channel_of_label: Array,
    config: ViewConfig,
    grain: Array | np.ndarray | float,
) -> ViewSamples:
    T_local_cam, ground_z = T_local_base @ T_base_cam, T_local_base[2, 3]
    p_map, is_contour = contour_points(samples, T_local_cam[:3, 3])
    seen = _in_image(p_map, samples, T_local_cam, ground_z, camera, config)
    p_cam, length_px, depth_px_per_m = seen.p_cam, seen.length_px, seen.depth_px_per_m
    channel = jnp.asarray(channel_of_label)[samples.label]
    on_ground = jnp.isin(samples.label, jnp.asarray(GROUND_CLASSES))
    near = jnp.sum(p_cam * p_cam, axis=-1) < config.max_range_m**2
    resolved = ~on_ground | (depth_px_per_m >= config.min_ground_px_per_m)
    keep = samples.valid & is_contour & seen.in_view & near & resolved & (channel >= 0)

    length_px = jnp.where(keep, jnp.minimum(length_px, 50.0), 0.0)
    chosen, spacing_px = _thin(length_px, keep, config)
    index = jnp.nonzero(chosen, size=config.capacity, fill_value=0)[0]
    filled = jnp.arange(config.capacity) < jnp.sum(chosen)
    shown_px = jnp.maximum(length_px, spacing_px)[index]
    shown_m = samples.length_m[index] * shown_px / jnp.maximum(length_px[index], 1e-3)
    weight = shown_px ** (1 - config.metric_exponent) * (shown_m * PX_PER_M) ** config.metric_exponent
    edge = _edges(samples)
    if config.most_alone > 1:
        weight = weight * _alone(edge, length_px, config, grain)[index]
    # An observation of variance s^2 with an independent map error of variance t^2 has the weight s^2 / (s^2 + t^2).
    weight = weight / (1 + (seen.height_px[index] / (config.noise.noise_px * grain)) ** 2)
    weight = jnp.where(filled, weight, 0.0).astype(p_map.dtype)
    element = jnp.where(filled, samples.element[index], -1)
    weight = _limited_by_element(weight, element, config, grain)
    if config.class_weight:
        weight = weight * jnp.asarray(config.class_weight, weight.dtype)[samples.label[index]]
    return ViewSamples(
        p_map=(p_map + (points - samples.p_map))[index].T,
        tangent_map=samples.tangent_map[index].T,
        channel=jnp.where(filled, channel[index], 0),
        weight=weight,
        element=element,
        edge=edge[index],
    )


def _edges(samples: MapSamples) -> Int[Array, " n"]:
    """Number of the straight edge of each sample."""
    turned = jnp.sum(samples.tangent_map[1:] * samples.tangent_map[:-1], axis=-1) < 0.7
    starts = jnp.concatenate([jnp.zeros(1, bool), turned | (samples.element[1:] != samples.element[:-1])])
    return jnp.cumsum(starts)


def _alone(edge: Array, length_px: Array, config: ViewConfig, grain: Array | np.ndarray | float) -> Array:
    """How much more each sample weighs because its straight edge is shorter than one independent observation."""
    edge_px = jax.ops.segment_sum(length_px, edge, len(edge))[edge]
    return jnp.clip(config.noise.correlation_px * grain / jnp.maximum(edge_px, 1.0), 1.0, config.most_alone)


def _limited_by_element(weight: Array, element: Array, config: ViewConfig, grain: Array | np.ndarray | float) -> Array:
    """The weights with each element's share limited: its place in the map is wrong for all of its samples at once.

    n independent observations (variance s^2) that share an error of variance t^2 hold n / (1 + n t^2 / s^2) of them.
    """
    # Numbered anew: a dense map has more elements than a view has samples.
    _, own = jnp.unique(element, return_inverse=True, size=config.capacity)
    observations = jax.ops.segment_sum(weight, own, config.capacity)[own] / (config.noise.correlation_px * grain)
    return weight / (1 + config.shared_error * observations)


class _InImage(NamedTuple):
    """What the camera makes of each sample."""

    p_cam: Array
    """Point in the camera frame [m]."""
    in_view: Array
    length_px: Array
    """Length in the image that the sample stands for."""
    depth_px_per_m: Array
    """Pixels for each metre away from the camera along the ground."""
    height_px: Array
    """Standard deviation across the contour that comes from a height that is not known."""


def _in_image(
    p_map: Array, samples: MapSamples, T_local_cam: Array, ground_z: Array, camera: Camera, config: ViewConfig
) -> _InImage:
    T_cam_local = lie.inverse(T_local_cam)
    p_cam = lie.transform(T_cam_local, p_map)
    rotation = T_cam_local.at[:3, 3].set(0.0)
    away = (p_map - T_local_cam[:3, 3]) * jnp.asarray([1.0, 1.0, 0.0], p_map.dtype)
    away_m = jnp.linalg.norm(away, axis=-1)
    away = away / jnp.maximum(away_m, 1e-3)[:, None]
    seen = projected(camera, p_cam.T, config.path)

    def moved_px(direction: Array) -> tuple[Array, Array]:
        return seen.moved_px(lie.transform(rotation, direction))

    du, dv = moved_px(samples.tangent_map)
    along_px = jnp.hypot(du, dv)
    normal_u, normal_v = dv / jnp.maximum(along_px, 1e-3), -du / jnp.maximum(along_px, 1e-3)
    away_u, away_v = moved_px(away)
    side_u, side_v = moved_px(jnp.stack([-away[:, 1], away[:, 0], away[:, 2]], axis=-1))
    up_u, up_v = moved_px(jnp.asarray([0.0, 0.0, 1.0], p_map.dtype))
    sigma = samples.height_sigma
    rise_m = jnp.hypot(sigma[:, 0], 0.5 * sigma[:, 1] * away_m**2)
    lean_m = sigma[:, 2] * (p_map[:, 2] - ground_z)
    height_px = jnp.sqrt(
        (rise_m * (up_u * normal_u + up_v * normal_v)) ** 2
        + (lean_m * (away_u * normal_u + away_v * normal_v)) ** 2
        + (lean_m * (side_u * normal_u + side_v * normal_v)) ** 2
    )
    margin_px = -config.margin_share * jnp.asarray(camera.width, p_map.dtype)
    in_view = seen.valid & camera.in_image(seen.u, seen.v, margin_px)
    return _InImage(p_cam, in_view, along_px * samples.length_m, jnp.hypot(away_u, away_v), height_px)


def _thin(length_px: Array, keep: Array, config: ViewConfig) -> tuple[Array, Array]:
    """Every sample at which the running length in the image passes a multiple of the spacing that fits the capacity."""
    total_px = jnp.sum(length_px)
    spacing_px = jnp.maximum(total_px / (0.9 * config.capacity), config.min_spacing_px)
    # A sample longer than the spacing counts once: the spacing is what is left for the others.
    running = jnp.cumsum(jnp.minimum(length_px, spacing_px)) / spacing_px
    before = jnp.concatenate([jnp.zeros(1, running.dtype), running[:-1]])
    return keep & (jnp.floor(running) > jnp.floor(before)), spacing_px
