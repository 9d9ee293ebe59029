"""One frame against the map: propose, search, polish where it looks right (room: alignment; JAX).

In: map samples, cost maps, prior. Out: Modes, the distinct poses that explain the masks, best first.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.along_road import AlongRoadConfig, RoadPosterior, weighed_along_road, widened
from semloc_jax.alignment.hypotheses import Modes, SearchConfig, score, search_from, weigh
from semloc_jax.alignment.level_choice import telling
from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, align_one, fit_at, typical_px, usual_grain
from semloc_jax.alignment.proposals import ProposalKind, propose
from semloc_jax.cameras import Rig
from semloc_jax.residuals.alignment import CameraViews, Usable, camera_views
from semloc_jax.residuals.texture import RampTextures, pack
from semloc_jax.residuals.view import ViewConfig, view
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import CostMaps, MapSamples, PoseEstimate


@dataclass(frozen=True)
class SingleFrameConfig:
    """How one frame is localized from a wide prior. All values are ours."""

    num_hypotheses: int = 1024
    proposals: ProposalKind = "lattice"
    reach: float = 2.5
    """Half width of the search window in sigmas of the prior."""
    min_reach_deg: float = 5.0
    """The search covers at least this heading to both sides, however small the sigma of the prior."""
    seed: int = 0
    """Of the random proposals."""
    search_view: ViewConfig = field(default_factory=lambda: ViewConfig(margin_share=0.15))
    polish_view: ViewConfig = field(default_factory=lambda: ViewConfig(most_alone=3.0))
    search_align: AlignConfig = field(default_factory=AlignConfig)
    polish_align: AlignConfig = field(default_factory=lambda: AlignConfig(levels=(2, 3), max_steps=20))
    search: SearchConfig = field(default_factory=SearchConfig)
    along_road: AlongRoadConfig = field(default_factory=AlongRoadConfig)
    rank_level: int = 2
    """Coarsest level on which the polished modes are ranked; a finer one in fine masks."""


class FrameInput(NamedTuple):
    """What stays the same for every pose of a frame."""

    samples: MapSamples
    """Map samples relative to the local origin."""
    rig: Rig
    channel_of_label: Int[Array, " label"]
    """Cost-map channel of each ElementClass, -1 for none."""
    textures: RampTextures
    usable: Usable
    grain: Float[Array | np.ndarray, ""] = usual_grain()
    """Of the masks, see `NoiseModel.grain`."""


class ImageInput(NamedTuple):
    """What the masks of a frame say, whatever map it is held against."""

    textures: RampTextures
    usable: Usable


def image_input(maps: CostMaps) -> ImageInput:
    """The masks of one frame, packed for the device."""
    return ImageInput(_pack(maps), Usable(jnp.asarray(maps.usable), maps.usable_stride))


def frame_input(
    samples: MapSamples, maps: CostMaps, rig: Rig, channel_of_label: Int[Array | np.ndarray, " label"]
) -> FrameInput:
    """The input of one frame, packed for the device."""
    return FrameInput(samples, rig, jnp.asarray(channel_of_label), *image_input(maps))


_pack = stored_program("dtype")(pack)


def evidence_from(T_local_base: Float[Array | np.ndarray, "4 4"], frame: FrameInput, config: ViewConfig) -> Evidence:
    """The evidence of a frame with the map as it is seen from a pose.

    >>> localizer = sj.FrameLocalizer(street, sj.load_class_table("drive"))
    >>> T_near = sj.planar_pose(2.2, 0.0)
    >>> frame, local_map = localizer.prepare([mask], rig, T_near)
    >>> T_local = local_map.frame.from_map(T_near)  # what goes to JAX is relative to a place near the vehicle
    >>> evidence = sj.evidence_from(T_local, frame, localizer.config.frame.polish_view)
    >>> evidence.views[0].p_map.shape
    (1, 3, 1024)
    """
    views = _views(T_local_base, frame.samples, frame.rig, frame.channel_of_label, frame.grain, config)
    return Evidence(views, frame.textures, frame.usable, frame.grain)


@stored_program("config")
def _views(
    T_local_base: Float[Array, "4 4"],
    samples: MapSamples,
    rig: Rig,
    channel_of_label: Int[Array, " label"],
    grain: Float[Array | np.ndarray, ""],
    config: ViewConfig,
) -> tuple[CameraViews, ...]:
    # The textures stay outside: what passes through a compiled function is copied, 30 MB a camera.
    return camera_views(rig, view(samples, T_local_base, rig, channel_of_label, config, grain))


@stored_program("config")
def search_starts(prior: Prior, config: SingleFrameConfig) -> Float[Array, "n 4 4"]:
    """Start poses of the search in the window around the prior."""
    sigma_xy_yaw = prior.sigma[np.array([0, 1, 5])]
    sigma_xy_yaw = sigma_xy_yaw.at[2].max(float(np.deg2rad(config.min_reach_deg)) / config.reach)
    key = jax.random.key(config.seed)
    return propose(config.proposals, config.num_hypotheses, prior.T_local_base, sigma_xy_yaw, config.reach, key)


OnRoad = Callable[[Float[np.ndarray, "4 4"], Prior], tuple[Float[np.ndarray, "4 4"], Prior]]


def localize_frame(
    frame: FrameInput,
    prior: Prior,
    config: SingleFrameConfig,
    on_road: OnRoad | None = None,
) -> Modes:
    """Modes of the pose of one frame, best first.

    Args:
        frame: Map samples, cost maps, cameras.
        prior: Prior pose and its sigmas; the plane of its x and y axes is taken as the road.
        config: Hypotheses, schedule, refinement.
        on_road: A pose and the prior with height, roll and pitch of the road at that pose: a crowned road leans the
            other way a lane aside. None keeps both as they are.
    """
    evidence = evidence_from(prior.T_local_base, frame, config.search_view)
    candidates, scores = search_from(search_starts(prior, config), evidence, prior, config.search_align, config.search)
    return settle(candidates, scores, frame, prior, config, on_road)


def settle(
    candidates: Float[Array | np.ndarray, "m 4 4"],
    scores: Float[Array | np.ndarray, " m"],
    frame: FrameInput,
    prior: Prior,
    config: SingleFrameConfig,
    on_road: OnRoad | None = None,
) -> Modes:
    """Modes from candidate poses: places along the road through the best are weighed, and all refined and ranked.

    Args:
        candidates: Poses relative to the local origin, best first.
        scores: Their costs [nats]; infinite: empty slot.
        frame: As `localize_frame`.
        prior: As `localize_frame`.
        config: As `localize_frame`.
        on_road: As `localize_frame`.
    """
    # On the host: an operation outside of the stored programs would be compiled in every process.
    best = np.asarray(candidates)[0]
    if on_road is not None:
        best, prior = on_road(best, prior)
    best, grain = sharpest(jnp.asarray(best), frame, prior, config)
    frame = frame._replace(grain=grain)
    closer = evidence_from(best, frame, config.polish_view)
    road = weighed_along_road(best, closer, prior, config.search_align, config.along_road, config.search.chunk)
    around = evidence_from(prior.T_local_base, frame, config.search_view).views
    in_view_px = np.float32(sum(np.sum(view.weight) for view in jax.device_get(around)))
    return polish(candidates, scores, road, frame, prior, config, in_view_px)


@stored_program("config")
def sharpest(
    T_local_base: Float[Array, "4 4"], frame: FrameInput, prior: Prior, config: SingleFrameConfig
) -> tuple[Float[Array, "4 4"], Float[Array, ""]]:
    """The best pose of a search refined as in the finest masks, and the grain that the masks turn out to have.

    In the finest masks the prior hardly pulls: how far the boundaries lie off then is theirs, not the prior's.
    """
    align_config = config.polish_align
    finest = frame._replace(grain=align_config.noise.grain(jnp.zeros((), T_local_base.dtype)))
    evidence = evidence_from(T_local_base, finest, config.polish_view)
    T = align_one(T_local_base, evidence, prior, align_config).T_local_base
    return T, align_config.noise.grain(typical_px(T, config.rank_level, evidence, align_config))


@stored_program("config")
def polish(
    candidates: Float[Array, "m 4 4"],
    scores: Float[Array, " m"],
    road: RoadPosterior,
    frame: FrameInput,
    prior: Prior,
    config: SingleFrameConfig,
    in_view_px: Float[Array, ""],
) -> Modes:
    """Each candidate, of the search and along the road, refined with the view as it is from there, and ranked anew.

    The views differ in how much of the map they hold; ranked by one `in_view_px`, more of it in view is no fault.
    """

    noise_px = config.polish_align.noise.noise_px * frame.grain
    level = telling(frame.textures.ramp_px, noise_px, config.rank_level)

    def one(T_local_base: Array) -> tuple[PoseEstimate, Array]:
        evidence = evidence_from(T_local_base, frame, config.polish_view)
        estimate = align_one(T_local_base, evidence, prior, config.polish_align)
        # Every mode is judged on one level, whichever held its pose last.
        judged = fit_at(estimate.T_local_base, level, evidence, config.polish_align)
        measured = (judged.cost, judged.inlier_ratio, widened(estimate.covariance, road.spread))
        estimate = eqx.tree_at(lambda e: (e.cost, e.inlier_ratio, e.covariance), estimate, measured)
        return estimate, score(estimate.T_local_base, level, evidence, prior, config.polish_align, in_view_px)

    candidates, scores = jnp.concatenate([candidates, road.Ts_local_base]), jnp.concatenate([scores, road.scores])
    estimates, polished = jax.lax.map(one, candidates)
    return weigh(estimates, jnp.where(jnp.isfinite(scores), polished, jnp.inf))
