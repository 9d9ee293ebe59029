"""How far poses scatter when only the noise of the masks changes (room: analysis; host).

In: a drive with exact masks and truth, its map, a number of seeds. Out: errors of every frame and seed.
One image of a place says little about its sigma; many masks that a network could have made of it say it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig, sample_within
from semloc_jax.alignment.pose import Prior, align_one
from semloc_jax.alignment.single_frame import FrameInput, SingleFrameConfig, evidence_from, frame_input
from semloc_jax.analysis.expected import ExpectedConfig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.evaluation.metrics import pose_errors
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.maps import SemanticMap
from semloc_jax.perception.cost_maps import cost_maps
from semloc_jax.simulation.degrade import Degradation, degrade

_SHIFT_PX = 0.5
"""What `degrade` moves masks by, as halving and doubling an image does."""


@dataclass(frozen=True)
class SeedErrors:
    """Errors of the pose by place and seed.

    Attributes:
        Ts_map_base: true poses.
        error: longitudinal [m], lateral [m], heading [deg].
    """

    Ts_map_base: Float[np.ndarray, "frame 4 4"]
    error: Float[np.ndarray, "frame seed 3"]

    @property
    def rms(self) -> Float[np.ndarray, "frame 3"]:
        """Root mean square over the seeds: longitudinal [m], lateral [m], heading [deg]."""
        return np.sqrt(np.mean(self.error**2, axis=1))


def errors_by_seed(
    drive: Drive,
    semantic_map: SemanticMap,
    frames: Sequence[Frame],
    num_seeds: int,
    masks: str = "sem",
    degradation: Degradation | None = None,
    expected: ExpectedConfig | None = None,
    config: LocalizeConfig | None = None,
    on_frame: Callable[[], None] | None = None,
) -> SeedErrors:
    """Errors of the single-frame pose of each frame, for many draws of a network's noise on its exact masks.

    The pose is refined from the road at the true place: the scatter of the right answer, not how often it is found.

    Args:
        drive: A drive with truth and exact masks.
        semantic_map: Its map.
        frames: Which frames.
        num_seeds: Draws of the noise for each frame.
        masks: The exact masks.
        degradation: How bad the masks are made; None for the defaults of a simulated drive.
        expected: Whose prior is used, the one that the expected sigmas rest on.
        config: How frames are localized.

    Raises:
        SemlocError: no truth, or no such masks.
    """
    truth, errors = [], []
    for frame in frames:
        solves = noisy_solves(drive, semantic_map, frame, num_seeds, masks, degradation, expected, config)
        found, T_true = np.stack([solve.T_map_base for solve in solves]), drive.truth_at(frame)
        by_name = pose_errors(found, np.broadcast_to(T_true, found.shape))
        errors.append(np.stack([by_name[key] for key in ("longitudinal_m", "lateral_m", "heading_deg")], axis=1))
        truth.append(T_true)
        if on_frame is not None:
            on_frame()
    return SeedErrors(np.stack(truth), np.stack(errors))


class NoisySolve(NamedTuple):
    """The pose of one draw of the noise, and what it was found from."""

    T_map_base: Float[np.ndarray, "4 4"]
    """In the map frame."""
    T_local_base: Float[Array, "4 4"]
    """Relative to the local origin."""
    inputs: FrameInput


def noisy_solves(
    drive: Drive,
    semantic_map: SemanticMap,
    frame: Frame,
    num_seeds: int,
    masks: str = "sem",
    degradation: Degradation | None = None,
    expected: ExpectedConfig | None = None,
    config: LocalizeConfig | None = None,
) -> Iterator[NoisySolve]:
    """The pose of one frame for one draw of a network's noise after another; see `errors_by_seed`."""
    expected, config = expected or ExpectedConfig(), config or LocalizeConfig()
    source = mask_source(masks, drive, offset_px=(0.0, 0.0))
    localizer = FrameLocalizer(semantic_map, source.table, config)
    sigma = jnp.asarray(expected.prior_sigma, jnp.float32)
    T_true, rig = drive.truth_at(frame), source.seen_by(frame.rig.select(source.cameras))
    shifted = rig.with_cameras([camera.shifted(_SHIFT_PX, _SHIFT_PX) for camera in rig.cameras])
    heading = float(np.arctan2(T_true[1, 0], T_true[0, 0]))
    local_map = semantic_map.query(T_true[:3, 3], config.search_radius_m, heading if len(rig) == 1 else None)
    samples = sample_within(local_map, config.sample_spacing_m, config.sample_capacity)
    T_start = semantic_map.road_pose(T_true[0, 3], T_true[1, 3], heading)
    T_local_start = jnp.asarray(local_map.frame.from_map(T_start))
    exact = source.masks(frame)
    for seed in range(num_seeds):
        rngs = [np.random.default_rng([seed, frame.index, k]) for k in range(len(exact))]
        noisy = [degrade(mask, rng, degradation) for mask, rng in zip(exact, rngs, strict=True)]
        maps = cost_maps(noisy, localizer.shown, config.cost_maps)
        inputs = frame_input(samples, maps, shifted, localizer.channel_of_label)
        T_local_base = _refined(T_local_start, inputs, sigma, config.frame)
        yield NoisySolve(local_map.frame.to_map(T_local_base), T_local_base, inputs)


@partial(jax.jit, static_argnames="config")
def _refined(
    T_start: Float[Array, "4 4"], inputs: FrameInput, sigma: Float[Array, "6"], config: SingleFrameConfig
) -> Float[Array, "4 4"]:
    """The pose after two refinements, the second with the map seen from where the first ended."""
    prior = Prior(T_start, sigma)

    def again(T: Array, _: None) -> tuple[Array, None]:
        evidence = evidence_from(T, inputs, config.polish_view)
        return align_one(T, evidence, prior, config.polish_align).T_local_base, None

    return jax.lax.scan(again, T_start, None, length=2)[0]
