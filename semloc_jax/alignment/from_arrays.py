"""Where is this camera, from arrays alone: masks, cameras, a map and a first guess (room: alignment; host).

In: masks of class ids, Camera or Rig, SemanticMap, first guess. Out: LocalizationResult, or a pose with derivatives.
No folder, no drive: `align` refines one first guess, `search` looks all around it. Poses are in the map frame.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.alignment.hypotheses import Modes
from semloc_jax.alignment.implicit import SmoothConfig, smooth_optimum, smooth_scene
from semloc_jax.alignment.pose import Prior, align_one
from semloc_jax.alignment.pose_in_map import DifferentiablePose
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.alignment.single_frame import FrameInput, SingleFrameConfig, evidence_from, localize_frame, settle
from semloc_jax.cameras import Camera, Rig, mounted
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.maps import SemanticMap
from semloc_jax.perception import ClassTable, load_class_table, table_of
from semloc_jax.perception.cost_maps import CostMapConfig, cost_maps
from semloc_jax.perception.finer_masks import finer, rig_of
from semloc_jax.residuals.pose_terms import Terms, from_origin
from semloc_jax.residuals.smooth import SmoothScene
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.solvers.factors import Factors

START_SIGMA = (1.0, 1.0, 0.03, *np.deg2rad((0.5, 0.5, 3.0)).tolist())
"""How far a first guess may be off, one sigma in the vehicle frame: x, y, z [m], roll, pitch, yaw [rad]."""
_NUM_VIEWS = 2
"""Times that the map is seen anew from the pose found: silhouettes and what is in view change with it."""
_COARSEST_M = 1e5
"""Farthest from the origin of the map at which float32 tells centimetres apart."""

Masks = np.ndarray | jax.Array | Sequence
Classes = str | ClassTable | Mapping
FirstGuess = PosePrior | np.ndarray | jax.Array


class _Arrays(NamedTuple):
    """What the user gave, checked and packed."""

    localizer: FrameLocalizer
    masks: list[np.ndarray]
    frame: FrameInput
    local: LocalFrame
    T_map_prior: np.ndarray
    prior: Prior
    """Relative to the local origin; differentiable by what the user gave."""


def align(
    masks: Masks,
    cameras: Camera | Rig,
    semantic_map: SemanticMap,
    prior: FirstGuess,
    *,
    classes: Classes,
    sigma: np.ndarray | jax.Array | Sequence = START_SIGMA,
    config: LocalizeConfig | None = None,
    terms: Terms = (),
    differentiable: bool = False,
) -> LocalizationResult | DifferentiablePose:
    """The pose that aligns the map with the masks, refined from one first guess.

    Along the road the covariance is measured from how far the masks leave the pose open, up to 2 m to both sides.

    Args:
        masks: Class ids uint8[h w], one mask or one for each camera, of the size of its camera.
        cameras: A Rig; or one Camera, whose own pose is found then: base is in its lens, x along the line of sight,
            y left, z up.
        semantic_map: The map.
        prior: First guess T_map_base [4 4] in the map frame, or a PosePrior, which stands on the road of the map.
        classes: What the ids mean: {id: class or classes of the map}, a class table, or the name of a preset.
        sigma: How far the first guess may be off (x, y, z [m], roll, pitch, yaw [rad], in the vehicle frame); 0 locks a
            direction. A PosePrior brings its own.
        config: None for the defaults.
        terms: Other measurements of the pose in the map frame, see `pose_term`.
        differentiable: True: a DifferentiablePose, whose `T_map_base`, `covariance` and `tangent()` have derivatives
            by cameras, `T_base_cam`, prior and sigma (jax.grad, jax.jacobian). By every number of the scene, map points
            and mask ramps among them: `differentiable_scene`.

    Returns:
        LocalizationResult: `T_map_base`, `covariance` of its right tangent, `status`, `localized`, `reasons`.
        Bad evidence is told by its status, never by an exception.

    Raises:
        SemlocError: masks and cameras do not fit, no class of the map is in `classes`, no map around the first guess.

    >>> lines = [("lane_marking", [[0, 2, 0], [30, 2, 0]]), ("lane_marking", [[0, -2, 0], [30, -2, 0]])]
    >>> street = sj.map_from_arrays([*lines, ("stop_line", [[14, -1.9, 0], [14, 1.9, 0]])])
    >>> camera = sj.camera_from_K([[400, 0, 319.5], [0, 400, 199.5], [0, 0, 1]], (640, 400))
    >>> rig = sj.Rig([camera], [sj.mounted((1.6, 0, 1.4), down_deg=4)], ["front"])
    >>> mask = sj.render_masks(street, rig, sj.planar_pose(2.0, 0.1, 0.01))[0]  # yours: uint8[400 640]
    >>> found = sj.align(mask, rig, street, sj.planar_pose(2.6, -0.2), classes={10: "lane_marking", 12: "stop_line"})
    >>> bool(np.abs(found.T_map_base[:2, 3] - [2.0, 0.1]).max() < 0.1), found.status.name
    (True, 'CONVERGED')
    >>> found.covariance.shape
    (6, 6)
    """
    given = _given(masks, cameras, semantic_map, prior, classes, sigma, config, terms)
    if differentiable:
        _require_fine(given.local.origin_map)
        scene = _scene(given)
        found = smooth_optimum(scene.T_start, scene.scene, scene.prior, _smooth(given))
        return DifferentiablePose.of(found, given.local.origin_map)
    found = _settled(given)
    return _judged(given, found)


def search(
    masks: Masks,
    cameras: Camera | Rig,
    semantic_map: SemanticMap,
    prior: FirstGuess,
    *,
    classes: Classes,
    sigma: np.ndarray | jax.Array | Sequence = START_SIGMA,
    config: LocalizeConfig | None = None,
    terms: Terms = (),
) -> LocalizationResult:
    """All poses around a first guess that explain the masks, best first, with a verdict.

    Arguments as `align`. With a `PosePrior` this is what `semloc localize` does. The window reaches 2.5 sigmas of the
    first guess; along the road the covariance is measured from how far the masks leave the pose open.

    Returns:
        LocalizationResult with all its `modes`.

    >>> found = sj.search(mask, rig, street, sj.planar_pose(2.6, -0.2), classes=classes)
    >>> bool(abs(found.T_map_base[0, 3] - 2.0) < 0.1), found.localized, len(found.modes)
    (True, True, 1)
    """
    if terms and isinstance(prior, PosePrior):
        raise SemlocError("terms: given beside a PosePrior; expected a first guess T_map_base [4 4] with them")
    given = _given(masks, cameras, semantic_map, prior, classes, sigma, config, terms)
    if isinstance(prior, PosePrior):
        return given.localizer.localize(None, given.masks, prior, cameras)
    found = localize_frame(given.frame, given.prior, given.localizer.config.frame)
    return _judged(given, found)


class DifferentiableScene(NamedTuple):
    """What a pose is a differentiable function of: `align_differentiable(T_start, scene, prior)`.

    Everything is relative to `origin_map`.
    """

    scene: SmoothScene
    """Cameras, extrinsics, map points, weights; distances to the mask boundaries [px]; model of each channel."""
    prior: Prior
    T_start: Float[Array, "4 4"]
    """Where the fast solve ended: which optimum is meant."""
    origin_map: Float[np.ndarray, "3"]
    """Local origin in the map frame [m]."""


def differentiable_scene(
    masks: Masks,
    cameras: Camera | Rig,
    semantic_map: SemanticMap,
    prior: FirstGuess,
    *,
    classes: Classes,
    sigma: np.ndarray | jax.Array | Sequence = START_SIGMA,
    config: LocalizeConfig | None = None,
    terms: Terms = (),
) -> DifferentiableScene:
    """The scene that `align(..., differentiable=True)` solves, to be differentiated by any of its numbers.

    Arguments as `align`.

    >>> scene, prior, T_start, _ = sj.differentiable_scene(mask, rig, street, sj.planar_pose(2.2, 0.0), classes=classes)
    >>> lateral = lambda scene: sj.align_differentiable(T_start, scene, prior).tangent()[1]
    >>> slope = jax.grad(lateral, allow_int=True)(scene)
    >>> bool(jnp.isfinite(slope.maps.distance_px).all()), slope.views[0].p_map.shape  # by mask ramps, by map points
    (True, (1, 3, 1024))
    """
    return _scene(_given(masks, cameras, semantic_map, prior, classes, sigma, config, terms))


def pose_term(
    residual: Callable[..., Array],
    data: tuple[Any, ...],
    sqrt_info: ArrayLike,
    robust: Callable[[Array], tuple[Array, Array]] | None = None,
) -> Factors:
    """A cost term of vehicle poses: a range to a beacon, a compass, the height over a lidar map.

    Args:
        residual: (T_map_base [4 4], data of one observation ..., its sqrt_info) -> whitened residuals; differentiable
            by JAX, 0 where `sqrt_info` is 0. A function of a module, not a lambda: it is known by what it is.
        data: What was measured: arrays with a leading axis over the observations, in the map frame.
        sqrt_info: The last argument of the residual, with that axis too.
        robust: RobustLoss of each observation, such as `residuals.motion.cauchy(2.0)`; None for squares.

    Raises:
        SemlocError: arrays without one leading axis.

    Returns:
        Factors, for `terms` of `align`, `search`, `Prior`, of a frame of the `Localizer`, of a window; and, with other
        `keys`, for a graph of many poses.

    >>> def range_residual(T_map_base, beacon_map, range_m, sqrt_info):
    ...     return sqrt_info * (jnp.linalg.norm(T_map_base[:3, 3] - beacon_map) - range_m)[None]
    >>> beacon_map, range_m, sigma_m = np.array([[10.0, 5.0, 3.0]]), np.array([9.85]), 0.05
    >>> term = sj.pose_term(range_residual, (beacon_map, range_m), np.array([1.0 / sigma_m]))
    >>> found = sj.align(mask, rig, street, sj.planar_pose(2.6, -0.2), classes=classes, terms=(term,))
    >>> bool(abs(np.linalg.norm(found.T_map_base[:3, 3] - beacon_map[0]) - 9.85) < 0.05)
    True
    """
    sqrt_info = np.asarray(sqrt_info)
    if sqrt_info.ndim == 0 or any(np.shape(leaf)[:1] != sqrt_info.shape[:1] for leaf in data):
        shapes = [list(np.shape(leaf)) for leaf in data]
        raise SemlocError(
            f"pose_term: data {shapes} and sqrt_info {list(sqrt_info.shape)}; expected arrays with one leading axis "
            "over the observations"
        )
    return Factors(residual, ("pose",), (np.zeros(len(sqrt_info), int),), data, sqrt_info, robust=robust)


def _given(
    masks: Masks,
    cameras: Camera | Rig,
    semantic_map: SemanticMap,
    prior: FirstGuess,
    classes: Classes,
    sigma: np.ndarray | jax.Array | Sequence,
    config: LocalizeConfig | None,
    terms: Terms,
) -> _Arrays:
    rig = cameras if isinstance(cameras, Rig) else _alone(cameras, prior)
    listed = finer(_masks(masks, rig))
    rig = rig_of(listed, rig)
    if isinstance(classes, str):
        table = load_class_table(classes)
    else:
        table = classes if isinstance(classes, ClassTable) else table_of(classes)
    localizer = FrameLocalizer(semantic_map, table, config)
    T_near = prior.on_road(semantic_map) if isinstance(prior, PosePrior) else _values(prior)
    frame, local_map = localizer.prepare(listed, rig, T_near)
    local = local_map.frame
    if isinstance(prior, PosePrior):
        known = prior.to_solver(T_near, local, localizer.config.road, semantic_map.road_spread(T_near))
    else:
        known = _known(prior, local, _six(sigma))
    if terms:
        _require_fine(local.origin_map)
        known = Prior(known.T_local_base, known.sigma, from_origin(terms, local.origin_map))
    return _Arrays(localizer, listed, frame, local, T_near, known)


def _known(T_map_base: Float[ArrayLike, "4 4"], local: LocalFrame, sigma: ArrayLike) -> Prior:
    """The prior in the local frame; a pose that JAX differentiates by stays differentiable."""
    if isinstance(T_map_base, jax.core.Tracer):
        shift = np.zeros((4, 4))
        shift[:3, 3] = local.origin_map
        T_local = (T_map_base - shift).astype(jnp.float32)
    else:
        T_local = jnp.asarray(local.from_map(T_map_base))
    return Prior(T_local, jnp.asarray(sigma, jnp.float32))


def _alone(camera: Camera, prior: FirstGuess) -> Rig:
    """The rig of one camera whose own pose is asked for."""
    if not isinstance(camera, Camera):
        raise SemlocError(f"cameras: given {type(camera).__name__}; expected a Rig, or one Camera (camera_from_K)")
    if isinstance(prior, PosePrior):
        raise SemlocError(
            "prior: a PosePrior stands on the road, and where the camera sits above it is not known; expected "
            "cameras=Rig([camera], [T_base_cam], ['front']) (see mounted), or a prior pose [4 4] of the camera itself"
        )
    return Rig([camera], mounted((0.0, 0.0, 0.0))[None], ["camera"])


def _masks(masks: Masks, rig: Rig) -> list[np.ndarray]:
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(masks)):
        raise SemlocError(
            "masks: given traced ones; expected arrays of class ids, which have no derivative. Differentiate by the "
            "ramps around their boundaries: differentiable_scene(...).scene.maps.distance_px"
        )
    listed = [np.asarray(mask) for mask in ([masks] if np.ndim(masks) == 2 else masks)]
    if len(listed) != len(rig):
        raise SemlocError(f"masks: given {len(listed)} for {len(rig)} cameras; expected one for each camera of the rig")
    for mask, camera, name in zip(listed, rig.cameras, rig.names, strict=True):
        width, height = camera.resolution
        if mask.shape != (height, width) or mask.dtype != np.uint8:
            raise SemlocError(
                f"mask of camera '{name}': given {mask.dtype}{list(mask.shape)}; expected class ids "
                f"uint8[{height} {width}], the size of the camera; see camera.resized for masks of another size"
            )
    return listed


def _values(T: FirstGuess) -> Float[np.ndarray, "4 4"]:
    """The numbers of a pose, also while JAX differentiates by it."""
    if np.shape(T) != (4, 4):
        raise SemlocError(f"prior: given shape {np.shape(T)}; expected a pose T_map_base [4 4] or a PosePrior")
    try:
        values = np.array([[float(T[i][j]) for j in range(4)] for i in range(4)])
    except jax.errors.ConcretizationTypeError as error:
        raise SemlocError(
            "prior: traced by jit; expected a pose whose numbers are known, since the map around it is looked up. Call "
            "differentiable_scene outside of jit and align_differentiable inside"
        ) from error
    if not np.isfinite(values).all() or not np.allclose(values[3], (0, 0, 0, 1)):
        raise SemlocError(f"prior: given {values.tolist()}; expected a finite rigid motion T_map_base [4 4]")
    return values


def _six(sigma: np.ndarray | jax.Array | Sequence) -> ArrayLike:
    sigma = sigma if isinstance(sigma, jax.Array) else np.asarray(sigma, dtype=np.float64)
    if np.shape(sigma) != (6,):
        raise SemlocError(f"sigma: shape {np.shape(sigma)}; expected 6: x, y, z [m], roll, pitch, yaw [rad]")
    return sigma


def _judged(given: _Arrays, found: Modes) -> LocalizationResult:
    known = given.T_map_prior, given.local, _sigma_xy_m(given.prior), {}, given.frame.rig
    return given.localizer.judged(None, found, *known)


def _sigma_xy_m(prior: Prior) -> float:
    """Horizontal standard deviation of the prior [m]; a locked one is as good as none."""
    return float(np.max(np.asarray(prior.sigma)[:2])) or 1.0


@stored_program("config")
def _aligned(prior: Prior, frame: FrameInput, config: SingleFrameConfig) -> Float[Array, "4 4"]:
    """The pose that the fast solve finds from the prior."""

    def seen_anew(T: Array, _: None) -> tuple[Array, None]:
        evidence = evidence_from(T, frame, config.polish_view)
        return align_one(T, evidence, prior, config.search_align).T_local_base, None

    return jax.lax.scan(seen_anew, prior.T_local_base, length=_NUM_VIEWS)[0]


def _settled(given: _Arrays) -> Modes:
    """What the pose of the fast solve becomes once the places along the road through it are weighed.

    Curvature at one optimum says nothing of a valley with several: a pose that nothing holds along the road would pass
    for a sure one.
    """
    config = given.localizer.config.frame
    T = np.asarray(_aligned(given.prior, given.frame, config))
    num = config.search.stages[-1].keep  # as many as a search hands on: the two share their programs
    scores = np.full(num, np.inf, np.float32)
    scores[0] = 0.0
    return settle(np.repeat(T[None], num, 0), scores, given.frame, given.prior, config)


def _scene(given: _Arrays) -> DifferentiableScene:
    """The smooth scene around where the fast solve ends."""
    config = given.localizer.config
    values = jax.lax.stop_gradient((given.prior, given.frame))
    T_start = _aligned(*values, config.frame)
    evidence = evidence_from(T_start, given.frame, config.frame.polish_view)
    level = config.frame.rank_level
    stored = CostMapConfig((config.cost_maps.ramp_px[level],), (config.cost_maps.stride[level],))
    maps = cost_maps(given.masks, given.localizer.shown, stored)
    scene = smooth_scene(evidence, maps, config.frame.polish_align)
    return DifferentiableScene(scene, given.prior, T_start, given.local.origin_map)


def _smooth(given: _Arrays) -> SmoothConfig:
    return SmoothConfig(align=given.localizer.config.frame.polish_align)


def _require_fine(origin_map: np.ndarray) -> None:
    """Raises where float32 cannot tell places of the map apart."""
    if np.abs(origin_map).max() > _COARSEST_M:
        raise SemlocError(
            f"map coordinates around {origin_map.round().tolist()} m: float32 is too coarse for a differentiable pose "
            "and for terms there; subtract an offset from map and prior, or use differentiable_scene, whose numbers "
            "are relative to origin_map"
        )
