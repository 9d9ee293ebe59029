"""The last lesson of eyes: they are taught for the pose, through the solver (room: learning; JAX and host).

In: Eyes, frames whose poses are known, the map, labelled images. Out: Eyes under which these poses are more likely.

Labels ask every border the same. The pose asks for those that hold it, and for sigmas that say how far each may be
trusted. It is a differentiable function of every distance that the eyes tell; see `alignment.implicit`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.implicit import smooth_optimum
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.eyes.batches import CropConfig, ImagePool, draw_batch
from semloc_jax.learning.eyes.loss import Batch, eyes_loss
from semloc_jax.learning.eyes.poses import TeacherPose
from semloc_jax.learning.loss import PLANAR, POLISH, FrameScore, heavy_tailed_nll, scored
from semloc_jax.learning.scenes import TrainingFrame, training_frame
from semloc_jax.learning.training import TrainingConfig, descend
from semloc_jax.maps import SemanticMap
from semloc_jax.perception.border_mask import LEAST_SHARE, NEAR_SHARE, SURE_PX
from semloc_jax.perception.networks.dense_net import filled_up
from semloc_jax.perception.networks.eyes import CELL_PX, REACH_PX, Eyes, Said, read_out, ready, working_scale
from semloc_jax.residuals.smooth import DistanceMaps

Net = TypeVar("Net", bound=eqx.Module)
_PRIOR_SEED = 7
_SAVE_EVERY = 5
"""Steps between checkpoints: one takes seconds."""


@dataclass(frozen=True)
class ThroughConfig:
    """The last lesson. All values are ours."""

    num_steps: int = 0
    """0: there is none."""
    rate: float = 2e-4
    """Of Adam at its begin: the eyes see already and are to be turned, not taught anew."""
    frames: int = 2
    """Of one step, all of one drive."""
    labels_share: float = 1.0
    """Weight of the labels beside the likelihood of the pose: what no pose asks for stays as it is."""
    most_pull: float = 1.0
    """Longest slope of one frame by all its distances [nats / px]: one that is lost shall not outweigh others."""
    sigma_m: float = 0.5
    """Noise of the priors along and across, one standard deviation."""
    sigma_deg: float = 2.0

    def __post_init__(self) -> None:
        if self.num_steps < 0 or self.frames < 1 or min(self.rate, self.most_pull, self.sigma_m, self.sigma_deg) <= 0.0:
            raise SemlocError(f"through the solver: {self}; expected counts of at least 0, 1 and values above 0")


class PoseSight(eqx.Module):
    """A frame as eyes see it, its map and where the vehicle was."""

    picture: Float[Array, "cam h w c"]
    """As the network takes it, filled up."""
    frame: TrainingFrame
    """Its cost maps are those that the eyes will tell; its `place` says which of their classes each channel is."""
    doubt: Float[Array, "3 3"]
    """Covariance of the pose along and across [m] and in heading [rad]."""
    stride: float = eqx.field(static=True)
    """Pixels of the image in one cell."""
    cells: tuple[int, int] = eqx.field(static=True)
    """Rows and columns of cells that lie in the image."""


class ThroughBatch(NamedTuple):
    """What one step learns from."""

    sights: tuple[PoseSight, ...]
    """Some of one drive."""
    crops: Batch


def pose_sights(
    poses: Sequence[TeacherPose], semantic_map: SemanticMap, masks: MaskSource, eyes: Eyes, config: ThroughConfig
) -> list[PoseSight]:
    """What there is to learn from in a drive: one for each of its poses, with a prior that is off by seeded errors.

    Args:
        poses: Frames whose poses are known, and how well.
        semantic_map: The map.
        masks: Of these eyes.
        eyes: They tell which classes are told.
        config: Noise of the priors.
    """
    localizer, learning = FrameLocalizer(semantic_map, masks.table), LearningConfig()
    found = []
    for pose in poses:
        prior = _prior_beside(pose, config)
        frame = training_frame(pose.frame, prior, pose.T_map_base, pose.T_map_base, localizer, masks, learning)
        images = [pose.frame.image(camera) for camera in masks.cameras]
        pictures = np.stack([ready(eyes.picture(image)) for image in images])
        rows, columns = (-(-side // int(CELL_PX)) for side in pictures.shape[1:3])
        step_px = eyes.config.step_px
        dtype = frame.T_true.dtype
        found.append(
            PoseSight(
                jax.vmap(lambda picture, step_px=step_px: filled_up(picture, step_px))(jnp.asarray(pictures)),
                frame,
                jnp.asarray(pose.covariance[np.ix_(PLANAR, PLANAR)], dtype),
                float(CELL_PX / working_scale(images[0].shape[1])),
                (rows, columns),
            )
        )
    return found


def _prior_beside(pose: TeacherPose, config: ThroughConfig) -> PosePrior:
    """The prior of a frame, off by noise that follows from its place in the drive."""
    sigma_rad = float(np.deg2rad(config.sigma_deg))
    rng = np.random.default_rng((_PRIOR_SEED, pose.frame.index))
    along, across, turn = rng.normal(size=3) * [config.sigma_m, config.sigma_m, sigma_rad]
    T = pose.T_map_base @ rigid.exp(np.array([along, across, 0.0, 0.0, 0.0, turn]))
    return PosePrior(T[0, 3], T[1, 3], float(np.arctan2(T[1, 0], T[0, 0])), config.sigma_m, sigma_rad)


def counted_px(said: Said, scale: float) -> Float[Array, "*b h w k"]:
    """Distances in pixels of the image as a solver takes them; `SeenBorders.counted_px`, with derivatives.

    Args:
        said: What the eyes say [px of the network's image].
        scale: Pixels of the network's image for one of the image.
    """
    share = jnp.clip(SURE_PX / jnp.maximum(jnp.exp(said.log_sigma) / scale, 1e-3), LEAST_SHARE, 1.0)
    signed = jnp.clip(said.signed_px, -REACH_PX, REACH_PX)
    return jnp.where(jnp.abs(signed) < NEAR_SHARE * REACH_PX, signed * share, signed) / scale


@eqx.filter_jit
def planes_told(network: eqx.Module, sight: PoseSight) -> Float[Array, "cam channel h w"]:
    """Distances that the eyes tell of a frame, as its scene takes them [px of the image]."""
    rows, columns = sight.cells
    said = read_out(jax.vmap(network)(sight.picture)[:, :rows, :columns])
    planes = jnp.moveaxis(counted_px(said, CELL_PX / sight.stride)[..., sight.frame.place], -1, 1)
    return planes.astype(sight.frame.scene.views[0].p_map.dtype)


def planes_score(planes: Float[Array, "cam channel h w"], sight: PoseSight) -> FrameScore:
    """How well distances foretell the pose of a frame: they are solved, differentiable by them."""
    scene = eqx.tree_at(lambda s: s.maps, sight.frame.scene, DistanceMaps(planes, sight.stride))
    estimate = smooth_optimum(sight.frame.T_start, scene, sight.frame.prior, POLISH)
    return scored(estimate, sight.frame.T_true, sight.doubt)


def through_slope(network: Net, batch: ThroughBatch, config: ThroughConfig, dof: float) -> tuple[Array, Net]:
    """Mean heavy-tailed negative log-likelihood of the poses with the loss of the labels beside it, and the gradient.

    Frame by frame, in parts that are compiled by themselves: what the eyes tell, the slope of the pose by it, the way
    back through the network. One program that looped over the frames took six times as long on a CPU.
    """
    value, gradient = _label_slope(network, batch.crops, config.labels_share)
    for sight in batch.sights:
        loss, slope = _pose_slope(planes_told(network, sight), sight, config.most_pull, dof)
        share = 1.0 / len(batch.sights)
        value, gradient = value + share * loss, _brought_back(network, sight, share * slope, gradient)
    return value, gradient


@eqx.filter_jit
def _label_slope(network: Net, crops: Batch, share: float) -> tuple[Array, Net]:
    """The loss of the labels and its gradient by the weights."""
    return eqx.filter_value_and_grad(lambda n: share * eyes_loss(n, crops))(network)


@eqx.filter_jit
def _pose_slope(planes: Array, sight: PoseSight, most_pull: float, dof: float) -> tuple[Array, Array]:
    """The loss of a frame and its slope by the distances; both are zero for a frame that has none."""
    loss, slope = jax.value_and_grad(lambda p: heavy_tailed_nll(planes_score(p, sight), dof))(planes)
    return jnp.where(jnp.isfinite(loss), loss, 0.0), bounded(slope, most_pull)


def bounded(slope: Array, most: float) -> Array:
    """A slope no longer than `most`; zero where it is not finite."""
    size = jnp.sqrt(jnp.sum(slope * slope))
    return jnp.where(jnp.isfinite(size), slope * jnp.minimum(1.0, most / jnp.maximum(size, 1e-12)), 0.0)


@eqx.filter_jit
def _brought_back(network: Net, sight: PoseSight, slope: Array, gradient: Net) -> Net:
    """A gradient by the weights, and beside it that of a frame whose slope by the distances is known."""
    more = eqx.filter_grad(lambda n: jnp.sum(slope * planes_told(n, sight)))(network)
    return jax.tree.map(jnp.add, gradient, more)


def taught_through(
    eyes: Eyes,
    drives: Sequence[Sequence[PoseSight]],
    pool: ImagePool,
    crops: CropConfig,
    config: ThroughConfig,
    seed: int,
    on_step: Callable[[int, float], None] | None = None,
    checkpoint: Path | None = None,
) -> Eyes:
    """The eyes after the last lesson.

    Args:
        eyes: That see already.
        drives: What `pose_sights` made of each drive.
        pool: Labelled images of them.
        crops: Of the batches.
        config: Steps, rate.
        seed: Of the batches.
        on_step: Called with the number of a step and its loss.
        checkpoint: File to go on from where it is there.

    Raises:
        SemlocError: no drive has any pose.
    """
    drives = [sights for sights in drives if sights]
    if not drives:
        raise SemlocError("through the solver: no frame has a pose to learn from; expected at least one")
    chance = np.array([len(sights) for sights in drives], np.float64)
    dof = LearningConfig().tail_dof

    def batch_of(rng: np.random.Generator) -> ThroughBatch:
        sights = drives[rng.choice(len(drives), p=chance / chance.sum())]
        drawn = [sights[k] for k in rng.choice(len(sights), config.frames, replace=len(sights) < config.frames)]
        return ThroughBatch(tuple(drawn), draw_batch(pool, crops, eyes.config.step_px, rng))

    def slope(network: Net, batch: ThroughBatch) -> tuple[Array, Net]:
        return through_slope(network, batch, config, dof)

    training = TrainingConfig(num_steps=config.num_steps, rate=config.rate, seed=seed, save_every=_SAVE_EVERY)
    network = descend(eyes.network, slope, batch_of, training, checkpoint, on_step)
    taught_on = eyes.card.get("taught", {}) | {"through_steps": config.num_steps}
    return replace(eyes, network=network, card={"taught": taught_on})
