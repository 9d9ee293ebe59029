"""Where a camera should look, from how well the pose would be known (room: analysis; JAX and host).

In: a map, cameras, places along a way. Out: pitch, height and field of view that make the expected sigmas small.
The expected information of `analysis.expected` as a smooth function of the placement: what enters or leaves the image
fades instead of switching, so that its gradient says where to turn the camera.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.optimize import minimize

from semloc_jax.analysis.expected import expected_covariance, expected_sigma
from semloc_jax.analysis.survey import PlaceViewer, SurveyConfig, Way, survey_ways
from semloc_jax.cameras import Camera, Rig
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import lie
from semloc_jax.maps import SemanticMap
from semloc_jax.perception import ClassTable
from semloc_jax.residuals.contour_rows import contour_rows
from semloc_jax.residuals.smooth import smooth_step
from semloc_jax.residuals.view import GROUND_CLASSES, contour_points
from semloc_jax.structs import MapSamples


class CameraPlacement(NamedTuple):
    """How a camera is changed against the calibration that was given."""

    down_deg: Float[Array, ""] | float = 0.0
    """Turned downwards about its own horizontal axis."""
    rise_m: Float[Array, ""] | float = 0.0
    """Mounted higher."""
    zoom: Float[Array, ""] | float = 1.0
    """Longer focal length at the same number of pixels: below 1 the view is wider."""

    def applied(self, rig: Rig, name: str) -> Rig:
        """The rig with one camera placed so."""
        index = rig.index(name)
        T_base_cam = jnp.asarray(rig.T_base_cam)
        turn = jnp.zeros(6, T_base_cam.dtype).at[3].set(-jnp.deg2rad(self.down_deg))
        moved = (T_base_cam[index] @ lie.exp(turn)).at[2, 3].add(self.rise_m)
        camera = rig.cameras[index]
        focal = tuple(self.zoom * jnp.asarray(value) for value in (camera.fx, camera.fy))
        zoomed = eqx.tree_at(lambda c: (c.fx, c.fy), camera, focal)
        cameras = [zoomed if k == index else other for k, other in enumerate(rig.cameras)]
        return rig.with_cameras(cameras).with_places(T_base_cam.at[index].set(moved))


@dataclass(frozen=True)
class PlacementConfig:
    """What may be changed, and how smooth the gradient is. All values are our choice."""

    survey: SurveyConfig = field(default_factory=SurveyConfig)
    down_deg: tuple[float, float] = (-10.0, 25.0)
    """Range of the turn; equal ends hold it."""
    rise_m: tuple[float, float] = (-0.5, 0.8)
    zoom: tuple[float, float] = (0.6, 2.0)
    starts: tuple[float, ...] = (0.0, 0.6)
    """Descents begin at the given camera and at these shares of each range: the objective has more than one valley."""
    fade_px: float = 12.0
    """Width at the border of the image over which samples come in."""
    max_steps: int = 25


@dataclass(frozen=True)
class PlacementReport:
    """What was found.

    Attributes:
        placement: against the camera that was given.
        rig: the cameras with it.
        sigma_before, sigma_after: expected longitudinal [m], lateral [m], heading [deg] sigma of each place, by the
            survey itself and not by its smooth counterpart.
    """

    placement: CameraPlacement
    rig: Rig
    sigma_before: Float[np.ndarray, "n 3"]
    sigma_after: Float[np.ndarray, "n 3"]

    @property
    def gain(self) -> Float[np.ndarray, "3"]:
        """How many times smaller each sigma is, geometric mean over the places."""
        return np.exp(np.mean(np.log(self.sigma_before / self.sigma_after), axis=0))

    def __str__(self) -> str:
        """One line for a report."""
        p, gain = self.placement, self.gain
        return (
            f"{p.down_deg:+.1f} deg down, {p.rise_m:+.2f} m higher, focal length x {p.zoom:.2f}: sigma longitudinal "
            f"/ {gain[0]:.2f}, lateral / {gain[1]:.2f}, heading / {gain[2]:.2f}"
        )


class PlacementProblem(NamedTuple):
    """Everything the objective is a function of, beside the placement."""

    samples: MapSamples
    """With a leading axis of places."""
    Ts_map_base: Float[Array, "place 4 4"]
    rig: Rig
    channel_of_label: Int[Array | np.ndarray, " label"]


def placement_problem(
    semantic_map: SemanticMap,
    rig: Rig,
    table: ClassTable,
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    config: PlacementConfig,
) -> PlacementProblem:
    """The problem of some places."""
    viewer = PlaceViewer(semantic_map, table, config.survey)
    parts = [viewer.samples(viewer.local_map(T), T) for T in Ts_map_base]
    samples = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(part[0] for part in parts))
    return PlacementProblem(samples, jnp.stack([part[1] for part in parts]), viewer.rig(rig), viewer.channel_of_label)


@partial(jax.jit, static_argnames=("name", "config"))
def mean_log_sigma(
    placement: CameraPlacement, problem: PlacementProblem, name: str, config: PlacementConfig
) -> Float[Array, ""]:
    """Mean over places and directions of the logarithm of the expected sigma; smooth in the placement.

    Args:
        placement: Of one camera.
        problem: Places.
        name: The camera that is placed.
        config: Noise, prior, smoothness.
    """
    rig = placement.applied(problem.rig, name)
    expected = config.survey.expected

    def one(samples: MapSamples, T: Array) -> Array:
        information = sum(
            _smooth_information(samples, T, camera, rig.T_base_cam[k], problem.channel_of_label, config)
            for k, camera in enumerate(rig.cameras)
        )
        sigma = jnp.asarray(expected.prior_sigma, T.dtype)
        return jnp.mean(jnp.log(expected_sigma(expected_covariance(information, sigma))))

    return jnp.mean(jax.lax.map(lambda place: one(*place), (problem.samples, problem.Ts_map_base)))


def place_camera(
    semantic_map: SemanticMap,
    rig: Rig,
    table: ClassTable,
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    name: str | None = None,
    config: PlacementConfig | None = None,
) -> PlacementReport:
    """Pitch, height and field of view of one camera that make the expected sigmas along a way small.

    Args:
        semantic_map: The map.
        rig: Cameras; the others stay as they are.
        table: What masks will show.
        Ts_map_base: Places.
        name: The camera that is placed; None for the first.
        config: None for the defaults.

    Raises:
        SemlocError: no places, no such camera, or a range that does not hold the given camera.
    """
    config, name = config or PlacementConfig(), name or rig.names[0]
    rig.index(name)
    bounds = np.array([config.down_deg, config.rise_m, np.log(config.zoom)])
    if not len(Ts_map_base) or (bounds[:, 0] > 0).any() or (bounds[:, 1] < 0).any():
        raise SemlocError(
            "placement: expected at least one place and ranges that hold the given camera "
            "(0 deg, 0 m, zoom 1 within their ends)"
        )
    problem = placement_problem(semantic_map, rig, table, Ts_map_base, config)
    unit = np.maximum(bounds[:, 1] - bounds[:, 0], 1e-9)
    slope = jax.jit(jax.value_and_grad(lambda x: mean_log_sigma(_placement(x), problem, name, config)))

    def objective(share: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = slope(jnp.asarray(share * unit, problem.Ts_map_base.dtype))
        return float(value), np.asarray(gradient, np.float64) * unit

    ends = list(zip(*(bounds / unit[:, None]).T, strict=True))
    begins = [np.zeros(3), *(bounds[:, 0] / unit + share for share in config.starts if share > 0)]
    options = {"maxiter": config.max_steps, "ftol": 1e-5}
    found = [minimize(objective, x, jac=True, bounds=ends, method="L-BFGS-B", options=options) for x in begins]
    best = min(found, key=lambda end: end.fun)
    down_deg, rise_m, zoom = (float(value) for value in _placement(best.x * unit))
    placement = CameraPlacement(down_deg, rise_m, zoom)
    placed = placement.applied(rig, name)
    before, after = (_exact_sigma(semantic_map, cameras, table, Ts_map_base, config) for cameras in (rig, placed))
    return PlacementReport(placement, placed, before, after)


def _placement(x: Array | np.ndarray) -> CameraPlacement:
    return CameraPlacement(x[0], x[1], jnp.exp(x[2]))


def _exact_sigma(
    semantic_map: SemanticMap, rig: Rig, table: ClassTable, Ts: Float[np.ndarray, "n 4 4"], config: PlacementConfig
) -> Float[np.ndarray, "n 3"]:
    way = Way("places", Ts, np.arange(len(Ts), dtype=float))
    return survey_ways(semantic_map, rig, table, [way], config.survey).ways[0].sigma


def _smooth_information(
    samples: MapSamples, T: Array, camera: Camera, T_base_cam: Array, channel_of_label: Array, config: PlacementConfig
) -> Float[Array, "6 6"]:
    """Information of one camera, as in `expected_scatter`, with every switch replaced by a fade."""
    view, align = config.survey.expected.view, config.survey.expected.align
    T_map_cam = T @ T_base_cam
    T_cam_base = lie.inverse(T_base_cam)
    # Which side of a pole or a box is its contour does not depend on pitch, and hardly on height.
    p_map, is_contour = jax.lax.stop_gradient(contour_points(samples, T_map_cam[:3, 3]))
    a, (u, v), _ = contour_rows(T, T_cam_base, camera, p_map.T, samples.tangent_map.T)
    weight, valid = _length_px(samples, p_map, T_map_cam, camera, view.min_ground_px_per_m)
    range_m = jnp.linalg.norm(p_map - T_map_cam[:3, 3], axis=-1)
    near = smooth_step((view.max_range_m + 2.0 - range_m) / 4.0)[0]
    shown = _inside(u, camera.width, config.fade_px) * _inside(v, camera.height, config.fade_px)
    known = samples.valid & is_contour & valid & (jnp.asarray(channel_of_label)[samples.label] >= 0)
    weight = jnp.where(known, weight * near * shown, 0.0)
    observations = (
        jax.ops.segment_sum(weight, jnp.maximum(samples.element, 0), len(weight)) * view.noise.observations_per_px
    )
    weight = weight / (1 + view.shared_error * observations[jnp.maximum(samples.element, 0)])
    a = jnp.where(known, a, 0.0)
    return jnp.einsum("ip,p,jp->ij", a, weight, a) * align.noise.information_per_px


def _inside(w: Array, size: Array, fade_px: float) -> Array:
    return smooth_step((w + 0.5) / fade_px)[0] * smooth_step((size - 0.5 - w) / fade_px)[0]


def _length_px(
    samples: MapSamples, p_map: Array, T_map_cam: Array, camera: Camera, min_px_per_m: float
) -> tuple[Array, Array]:
    """Length of contour of each sample in the image, less where the ground is seen at a grazing angle, and validity."""
    T_cam_map = lie.inverse(T_map_cam)
    away = (p_map - T_map_cam[:3, 3]) * jnp.asarray([1.0, 1.0, 0.0], p_map.dtype)
    away = away / jnp.maximum(jnp.linalg.norm(away, axis=-1, keepdims=True), 1e-3)
    (_, _, valid), push = jax.linearize(camera.project_xyz, *lie.transform(T_cam_map, p_map).T)

    def moved_px(direction: Array) -> Array:
        du, dv, _ = push(*(direction @ T_cam_map[:3, :3].T).T)
        return jnp.sqrt(du * du + dv * dv + 1e-9)

    length = jnp.minimum(moved_px(samples.tangent_map) * samples.length_m, 50.0)
    grazing = smooth_step((moved_px(away) / min_px_per_m - 0.7) / 0.6)[0]
    on_ground = jnp.isin(samples.label, jnp.asarray(GROUND_CLASSES))
    return length * jnp.where(on_ground, grazing, 1.0), valid
