"""Candidates for the pose of a frame: a wide first look, and solves that nothing pulls (room: alignment; JAX).

In: the frame, a window, poses to start from. Out: poses that differ, and what a solve makes of each.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.alignment.evidence_null import EvidenceNull
from semloc_jax.alignment.filled_rows import map_filled
from semloc_jax.alignment.hypotheses import score
from semloc_jax.alignment.level_choice import telling
from semloc_jax.alignment.observed import LONGEST_PX, CoarseSamples, ObserveConfig
from semloc_jax.alignment.pose import AlignConfig, Prior, align_one, fit_at
from semloc_jax.alignment.proposals import LATTICE_STEPS
from semloc_jax.alignment.road_patch import RoadPatch
from semloc_jax.alignment.same_pose import units_apart
from semloc_jax.alignment.seen_samples import SeenSamples, coarse_nats
from semloc_jax.alignment.single_frame import FrameInput, SingleFrameConfig, evidence_from
from semloc_jax.cameras import Rig
from semloc_jax.perception.border_distance import BorderDistances
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import MapSamples, PoseEstimate

BATCH = 64
"""Most poses that are solved or observed in one call; of fewer, only those asked for cost time."""
CLOSER_BATCH = 512
"""Poses of a closer look are a multiple of so many."""
COARSE_SAMPLES, COARSE_EVERY = 768, 4
"""Samples of the closer look; the first one takes every so many of them."""
_CLOSER_SHARE = 8
"""One pose in so many is looked at closer."""


class SolvedPoses(NamedTuple):
    """What solves make of their starts."""

    estimates: PoseEstimate
    score: Float[Array, " n"]
    """Ramp cost and prior [nats]."""

    def rows(self, index: np.ndarray | slice) -> "SolvedPoses":
        """Some of them."""
        return jax.tree.map(lambda leaf: leaf[index], self)


@stored_program("config", "align_config")
def solve_batch(
    Ts_start: Float[Array, "n 4 4"],
    Ts_road: Float[Array, "n 4 4"],
    part: Int[Array, " n"],
    rigs: Rig,
    num: Int[Array, ""],
    parts: Bool[Array, "part p"],
    sigma: Float[Array, "6"],
    frame: FrameInput,
    in_view_px: Float[Array, ""],
    config: SingleFrameConfig,
    align_config: AlignConfig,
) -> SolvedPoses:
    """Each start refined with the map as it is seen from there.

    Args:
        Ts_start: Starts relative to the local origin.
        Ts_road: Centres of their priors: the same places on the plane of the road.
        part: Row of `parts` that each is solved with.
        rigs: Cameras that each is solved through, stacked: a leading axis n on every leaf.
        num: How many of them are asked for; the others stay zero.
        parts: Which samples count.
        sigma: Of the priors (x, y, z [m], roll, pitch, yaw [rad]); wide along the road, so that they do not pull.
        frame: Map samples and cost maps.
        in_view_px: Length of contour that costs are scaled by.
        config: View and level on which costs are compared.
        align_config: Levels and steps.
    """

    noise_px = align_config.noise.noise_px * frame.grain
    level = telling(frame.textures.ramp_px, noise_px, config.rank_level)

    def one(row: tuple[Array, Array, Array, Rig]) -> SolvedPoses:
        T_start, T_road, part, rig = row
        prior = Prior(T_road, sigma)
        shown = eqx.tree_at(lambda s: s.valid, frame.samples, frame.samples.valid & parts[part])
        evidence = evidence_from(T_start, frame._replace(samples=shown, rig=rig), config.polish_view)
        estimate = align_one(T_start, evidence, prior, align_config)
        judged = fit_at(estimate.T_local_base, level, evidence, align_config)
        measured = (judged.cost, judged.inlier_ratio)
        estimate = eqx.tree_at(lambda e: (e.cost, e.inlier_ratio), estimate, measured)
        return SolvedPoses(estimate, score(estimate.T_local_base, level, evidence, prior, align_config, in_view_px))

    return map_filled(one, (Ts_start, Ts_road, part, rigs), num)


def solve_all(
    Ts_start: np.ndarray,
    road: RoadPatch,
    sigma: np.ndarray,
    frame: FrameInput,
    in_view_px: float,
    config: SingleFrameConfig,
    align_config: AlignConfig,
    parts: np.ndarray,
    part: np.ndarray | None = None,
    rigs: Sequence[Rig] = (),
    lens: np.ndarray | None = None,
) -> SolvedPoses:
    """`solve_batch` of any number of starts, on the host; the centres of their priors stand on the road.

    Without `part` the first of the parts is solved; without `rigs` all through the cameras of the frame, else through
    those of the number `lens`.
    """
    part, lens = (np.zeros(len(Ts_start), int) if index is None else index for index in (part, lens))
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *(rigs or (frame.rig,)))
    frame = frame._replace(rig=None)  # each start has its own
    found = []
    for first in range(0, len(Ts_start), BATCH):
        own = Ts_start[first : first + BATCH]
        own_lens = np.resize(lens[first : first + BATCH], BATCH)
        solved = solve_batch(
            np.asarray(filled(own, BATCH), np.float32),
            np.asarray(filled(road.place(own), BATCH), np.float32),
            np.resize(part[first : first + BATCH], BATCH).astype(np.int32),
            jax.tree.map(lambda leaf, own=own_lens: leaf[own], stacked),
            np.int32(len(own)),
            parts,
            np.asarray(sigma, np.float32),
            frame,
            np.float32(in_view_px),
            config,
            align_config,
        )
        found.append(jax.tree.map(np.asarray, solved))
    joined = jax.tree.map(lambda *leaves: np.concatenate(leaves), *found)
    return joined.rows(np.arange(len(Ts_start)))


def filled(Ts: np.ndarray, size: int) -> np.ndarray:
    """Poses with the first repeated up to a size."""
    return np.concatenate([Ts, np.repeat(Ts[:1], size - len(Ts), axis=0)])


def planar(x_m: np.ndarray, y_m: np.ndarray, heading_rad: np.ndarray | float) -> np.ndarray:
    """Motions in the plane, float64[n 4 4]."""
    x_m, y_m, heading_rad = np.broadcast_arrays(
        *(np.asarray(value, dtype=np.float64) for value in (x_m, y_m, heading_rad))
    )
    T = np.tile(np.eye(4), (len(x_m), 1, 1))
    T[:, 0, 0] = T[:, 1, 1] = np.cos(heading_rad)
    T[:, 1, 0] = np.sin(heading_rad)
    T[:, 0, 1] = -T[:, 1, 0]
    T[:, 0, 3], T[:, 1, 3] = x_m, y_m
    return T


def along_weak(
    covariance: np.ndarray, lever_m: float, restarts: tuple[int, ...], step_m: tuple[float, float]
) -> np.ndarray:
    """Motions along the two directions of the plane that a pose is held least in, float64[k 4 4].

    One of them is the road as a rule; the other one is a valley of place and heading, in which solves stop early.

    Args:
        covariance: Of the pose, float[6 6].
        lever_m: A turn counts as what it moves so far away.
        restarts: Multiples of a step.
        step_m: Least and largest step; within them it is 1.5 standard deviations.
    """
    plane = np.array((0, 1, 5))
    scale = np.array((1.0, 1.0, lever_m))
    values, vectors = np.linalg.eigh(covariance[np.ix_(plane, plane)] * np.outer(scale, scale))
    steps_m = np.clip(1.5 * np.sqrt(np.maximum(values[1:], 0.0)), *step_m)
    moves = np.vstack(
        [np.outer(restarts, length_m * axis / scale) for length_m, axis in zip(steps_m, vectors.T[1:], strict=True)]
    )
    return planar(moves[:, 0], moves[:, 1], moves[:, 2])


def lattice_in_window(num: int, T_prior: np.ndarray, half_xy_m: float, half_heading_rad: float) -> np.ndarray:
    """Poses that fill a window, denser in its middle where a prior puts them, the prior first, float64[num 4 4]."""
    x, y, heading = _lattice(num)
    return T_prior @ planar(half_xy_m * x, half_xy_m * y, half_heading_rad * heading)


@lru_cache(maxsize=4)
def _lattice(num: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places and headings of a window of +-1 each, the middle first."""
    # On the host: the number of poses follows the prior, and JAX would compile for each.
    unit = 2.0 * np.mod(0.5 + np.outer(np.arange(num), LATTICE_STEPS), 1.0) - 1.0
    unit[0] = 0.0
    x, y = (np.sign(unit[:, :2]) * np.abs(unit[:, :2]) ** 1.5).T
    return x, y, unit[:, 2]


def null_poses(num: int, T_prior: np.ndarray, seed: int) -> np.ndarray:
    """Random poses that are wrong, 3 to 25 m away and turned by up to 25 deg, float64[num 4 4]."""
    random = np.random.default_rng(seed)
    away_m, angle = random.uniform(3.0, 25.0, num), random.uniform(0.0, 2.0 * np.pi, num)
    turn = np.deg2rad(random.uniform(-25.0, 25.0, num))
    return T_prior @ planar(away_m * np.cos(angle), away_m * np.sin(angle), turn)


def coarse_samples(seen: SeenSamples, samples: MapSamples, channel: np.ndarray, unit_px: float) -> CoarseSamples:
    """Samples that stand for equal lengths of contour in the images of the poses they were observed from.

    Args:
        seen: from some poses that span the window.
        samples: the map.
        channel: of each sample.
        unit_px: pixels of this image that stand for one of a usual one.
    """
    length_px = np.zeros(len(channel), np.float32)
    np.maximum.at(length_px, seen.sample, seen.length_px)
    length_px = np.minimum(length_px, LONGEST_PX * unit_px)
    total = float(length_px.sum())
    p_map = np.zeros((3, COARSE_SAMPLES), np.float32)
    chosen_channel, weight = np.zeros(COARSE_SAMPLES, np.int32), np.zeros(COARSE_SAMPLES, np.float32)
    if total > 0:
        places = (np.arange(COARSE_SAMPLES) + 0.5) * total / COARSE_SAMPLES
        index = np.minimum(np.searchsorted(np.cumsum(length_px), places), len(length_px) - 1)
        p_map, chosen_channel = np.asarray(samples.p_map)[index].T, np.maximum(channel, 0)[index]
        # A coarse sample is a piece of a piece: it counts for its length, at most in full.
        weight[:] = min(total / COARSE_SAMPLES / (30.0 * unit_px), 1.0)
    # Every so many of them are one part.
    parts = np.arange(COARSE_SAMPLES).reshape(-1, COARSE_EVERY).T
    return CoarseSamples(
        p_map.astype(np.float32)[:, parts].swapaxes(0, 1), chosen_channel.astype(np.int32)[parts], weight[parts]
    )


def coarse_gain(null: EvidenceNull, borders: BorderDistances, usable: np.ndarray, scale_px: float) -> np.ndarray:
    """Nats of one observation by pixel, at twice the stride of the distances, float32[cam channel h w].

    They are counted from what random poses gain: places of a lattice are a little off, and where all of them lose, the
    best ones would be those that see no map.

    Args:
        null: of the frame.
        borders: distances to mask borders.
        usable: bool[cam h w], at the stride of the distances.
        scale_px: of the distances of what is seen: that of the search, not of the masks.
    """
    table = null.log_ratio(np.full(null.num_channels, scale_px))
    gain = np.log(1.0 - null.config.rate + null.config.rate * np.exp(table))
    gain -= (null.null * gain).sum(axis=1, keepdims=True)
    byte = (np.abs(borders.signed_px[:, : null.num_channels, ::2, ::2]) * (255.0 / borders.reach_px)).astype(np.uint8)
    bins = np.digitize(np.arange(256) * borders.reach_px / 255.0, null.edges_px)
    field = np.stack([gain[c].astype(np.float32)[bins][byte[:, c]] for c in range(null.num_channels)], axis=1)
    rows, columns = field.shape[2:]
    hidden = ~usable[:, ::2, ::2][:, :rows, :columns]
    field *= ~hidden[:, None]
    return field


def coarse_search(
    Ts: np.ndarray,
    samples: CoarseSamples,
    frame: FrameInput,
    gain: np.ndarray,
    stride: int,
    log_prior: np.ndarray,
    config: ObserveConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """The poses that are best at a first look and their nats at a closer one, with the prior: int[k], float[k].

    The first part of the samples tells which poses are worth all of them.

    Args:
        Ts: Poses relative to the local origin; their number is a multiple of COARSE_BATCH.
        samples: Of the closer look.
        frame: Cameras.
        gain: See `coarse_gain`.
        stride: Pixels of the full mask in one of `gain`.
        log_prior: Of each pose, float[n].
        config: Range and border.
    """
    few = samples._replace(weight=samples.weight * COARSE_EVERY)

    def nats(rows: np.ndarray, samples: CoarseSamples, num_parts: int) -> np.ndarray:
        found = coarse_nats(Ts[rows], samples, num_parts, frame.rig, gain, float(stride), config)
        return found.astype(np.float64) + log_prior[rows]

    first = nats(np.arange(len(Ts)), few, 1)
    num_closer = max(len(Ts) // _CLOSER_SHARE // CLOSER_BATCH, 1) * CLOSER_BATCH
    best = np.argsort(-first, kind="stable")[:num_closer]
    return best, nats(best, samples, COARSE_EVERY)


def apart(Ts: np.ndarray, value: np.ndarray, keep: int, units: float) -> np.ndarray:
    """Rows of the poses of highest value that are so many units from every better one kept, int[k]."""
    return spread_out(value, keep, lambda best: units_apart(Ts, Ts[best]) < units)


def spread_out(value: np.ndarray, keep: int, is_near: Callable[[int], np.ndarray]) -> np.ndarray:
    """Rows of highest value, none of them near a better one kept, int[k].

    Args:
        value: float[n]; what is not finite is never kept.
        keep: Most rows.
        is_near: Which rows are near the given one, bool[n].
    """
    left = np.where(np.isfinite(value), value, -np.inf).astype(np.float64)
    kept = []
    while len(kept) < keep and np.isfinite(left[best := int(np.argmax(left))]):
        kept.append(best)
        left[is_near(best)] = -np.inf
        left[best] = -np.inf
    return np.asarray(kept, dtype=int)


def not_near(Ts: np.ndarray, others: np.ndarray, units: float) -> np.ndarray:
    """The poses that are so many units from every one of the others, float64[k 4 4]."""
    near = units_apart(Ts[:, None], others[None]) < units
    return Ts[~near.any(axis=1)]


def wide_sigma(sigma: np.ndarray, least_xy_m: float, least_heading_rad: float) -> np.ndarray:
    """Sigmas of a prior that does not pull a solve: at least so wide in the plane, float64[6]."""
    wide = np.array(sigma, dtype=np.float64)
    wide[:2], wide[5] = np.maximum(wide[:2], least_xy_m), max(wide[5], least_heading_rad)
    return wide


def thinned(samples: MapSamples, channel_of_label: np.ndarray, capacity: int) -> MapSamples:
    """Every k-th sample that masks can show, in a fixed capacity; each stands for k times its length."""
    host = jax.tree.map(np.asarray, samples)
    rows = np.flatnonzero(host.valid & (channel_of_label[host.label] >= 0))
    every = max(-(-len(rows) // capacity), 1)
    rows = rows[::every]
    size = np.zeros(capacity, int)
    size[: len(rows)] = rows
    kept: MapSamples = jax.tree.map(lambda leaf: leaf[size], host)
    valid = np.arange(capacity) < len(rows)
    length_m = (kept.length_m * every).astype(np.float32)
    values = {name: getattr(kept, name) for name in MapSamples.__dataclass_fields__}
    return MapSamples(**jax.device_put({**values, "valid": valid, "length_m": length_m}))
