"""Evidence with a null: what the masks hold for a pose against seeing the map elsewhere (room: alignment; host).

In: SeenSamples of several poses. Out: nats, explained share and border offset of every pose; rates of the frame.
The samples of one element in one cell of the image are one observation, a piece. Each piece was either seen, and its
samples lie near the border of a mask, or it was not (worn, hidden, not there), and they lie where samples of a random
pose lie. A map that is not matched costs log(1 - P): poses that see different amounts of map can be compared. A border
of a mask on which no contour of the map lies was made by something else: rarely, as the best pose tells, often, where
the pose is wrong.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import erf

from semloc_jax.alignment.border_cells import BorderCells, block_of
from semloc_jax.alignment.map_pieces import Pieces, PoseEvidence, Rates
from semloc_jax.alignment.seen_samples import SeenSamples

RANGE_EDGES_M = (15.0, 25.0, 40.0)
"""Beyond each of them the rate of detection is another one."""


@dataclass(frozen=True)
class NullConfig:
    """Constants of the likelihood, in pixels of an image of usual size (`perception.border_distance.pixel_unit`)."""

    edges_px: tuple[float, ...] = (1.0, 2.0, 3.0, 4.5, 6.5, 9.0, 13.0, 20.0, 30.0, 45.0)
    """Between them the distances of the null are counted."""
    observation_px: float = 30.0
    """Length of contour that makes one full observation."""
    least_px: float = 6.0
    """Shorter pieces say nothing."""
    least_observation: float = 0.2
    uniform: float = 0.03
    """Share of the null that is the same everywhere."""
    narrow: float = 0.75
    """Share of seen samples that lie within one scale; the others within `wide` scales."""
    wide: float = 2.5
    floor: float = 1e-4
    """Least probability of a seen sample in any bin."""
    most_nats: float = 6.0
    """Of one observation."""
    scale_px: tuple[float, float] = (1.0, 6.0)
    """Smallest and largest scale."""
    rate: float = 0.6
    rate_strength: float = 6.0
    """Prior of the rates of detection: mean, and the number of observations that it counts."""
    rounds: int = 5
    matched_nats: float = 0.3
    """A piece with more counts as explained."""
    on_border: float = 2.5
    """Contours nearer to a border than so many scales account for it."""
    left_over: float = 0.6
    """Share of the borders that the map leaves over at the right pose, over that at random ones, before the frame is
    known."""


_LEAST_SAMPLES = 8
"""Of fewer samples no offset is told."""


class _Beside(NamedTuple):
    """Borders of every pose: the share that is left over, and what it says [nats]."""

    left: np.ndarray
    nats: np.ndarray


class EvidenceNull:
    """The likelihood of one frame: null from random poses, rates from the best poses."""

    def __init__(
        self,
        null: SeenSamples,
        channel: np.ndarray,
        element: np.ndarray,
        unit_px: float,
        config: NullConfig,
        null_every: int = 1,
        cells: BorderCells | None = None,
    ):
        """Learn where samples lie when the pose is wrong.

        Args:
            null: What random poses see of every `null_every`-th sample.
            channel, element: of each sample, int[p].
            unit_px: pixels of this image that stand for one of a usual one.
            config: Constants.
            cells: Where the masks have borders; None: nothing is said of what the map leaves over.
        """
        self.config = config
        self.cells = BorderCells.none() if cells is None else cells
        self.unit_px = unit_px
        self.edges_px = unit_px * np.asarray(config.edges_px)
        self.channel, self.element = np.maximum(channel, 0), element
        self.num_channels = int(self.channel.max(initial=0)) + 1
        self.null = self._histogram(null, self.channel[::null_every])
        length_px = self.cells.length_px / unit_px
        full = np.clip(length_px / config.observation_px, config.least_observation, 1.0)
        self._border_observations = np.where(length_px < config.least_px, 0.0, full)
        self.left_over_at_random = self._at_random(null, self.channel[::null_every], null_every)

    @property
    def num_bins(self) -> int:
        """Number of bins of distance."""
        return len(self.edges_px) + 1

    def _histogram(self, seen: SeenSamples, channels: np.ndarray) -> np.ndarray:
        bins, size = self._bins(seen.signed_px), self.num_channels * self.num_bins
        counts = np.bincount(channels[seen.sample] * self.num_bins + bins, seen.length_px, size)
        counts = counts.reshape(-1, self.num_bins)
        total = counts.sum(axis=1, keepdims=True)
        share = np.where(total > 0, counts / np.maximum(total, 1e-9), 1.0 / self.num_bins)
        return (1.0 - self.config.uniform) * share + self.config.uniform / self.num_bins

    def _bins(self, signed_px: np.ndarray) -> np.ndarray:
        return np.searchsorted(self.edges_px, np.abs(signed_px), side="right")

    def _at_random(self, null: SeenSamples, channels: np.ndarray, every: int) -> np.ndarray:
        """Share of the borders of each channel that random poses leave over, float[channel]; 1 for no borders."""
        near_px, channel = self.config.on_border * self.start_scale_px, channels[null.sample]
        near = np.flatnonzero(np.abs(null.signed_px) < near_px[channel])
        border = self.cells.rows(null.camera[near], channel[near], null.cell[near].astype(np.int64))
        length_px = every * null.length_px[near]
        left = self.cells.left_over(null.pose[near], border, length_px, null.num_poses)
        return self._by_channel(left.mean(axis=0), np.ones(self.num_channels))

    def _by_channel(self, left_over: np.ndarray, expected: np.ndarray) -> np.ndarray:
        """Mean share of the borders of each channel that is left over, with what is expected as a prior."""
        strength, weight = self.config.rate_strength, self._border_observations
        total = np.bincount(self.cells.channel, weight * left_over, self.num_channels)
        count = np.bincount(self.cells.channel, weight, self.num_channels)
        return (strength * expected + total) / (strength + count)

    def left_over(self, pieces: Pieces, scale_px: np.ndarray) -> np.ndarray:
        """Share of every border on which no contour of the map lies, float[pose border]."""
        return 1.0 - self._covered(pieces, scale_px)

    def _covered(self, pieces: Pieces, scale_px: np.ndarray) -> np.ndarray:
        near = pieces.on_borders
        rows = np.flatnonzero(near.away_px < (self.config.on_border * scale_px)[near.channel])
        place = near.pose[rows] * len(self.cells.key) + near.border[rows]
        return self.cells.covered(place, near.weight[rows], pieces.num_poses)

    def pieces(self, seen: SeenSamples, image_size: tuple[int, int], cell_px: float) -> Pieces:
        """The samples of every pose gathered by element and cell of the image.

        Args:
            seen: of n poses.
            image_size: width and height of the largest mask [px].
            cell_px: size of the cells.
        """
        num_elements, most_cells = int(self.element.max(initial=0)) + 1, int(seen.cell.max(initial=0)) + 1
        own = (seen.pose.astype(np.int64) * seen.num_cameras + seen.camera) * num_elements + self.element[seen.sample]
        key = own * most_cells + seen.cell
        # Neighbours of a contour fall together: runs first, then what is left is short enough to be sorted.
        starts = np.flatnonzero(np.diff(key, prepend=-1))
        _, first, of_run = np.unique(key[starts], return_index=True, return_inverse=True)
        piece, first = np.repeat(of_run, np.diff(starts, append=len(key))), starts[first]
        weight, config, num = seen.length_px.astype(np.float64), self.config, len(first)
        total_px = np.bincount(piece, weight, num)
        length_px = total_px / self.unit_px
        range_m = np.bincount(piece, weight * seen.range_m, num) / np.maximum(total_px, 1e-9)
        counted = np.clip(length_px / config.observation_px, config.least_observation, 1.0)
        of_bin = np.bincount(piece * self.num_bins + self._bins(seen.signed_px), weight, num * self.num_bins)
        channel, camera, cell = self.channel[seen.sample[first]], seen.camera[first], seen.cell[first].astype(np.int64)
        return Pieces(
            num_poses=seen.num_poses,
            pose=seen.pose[first].astype(np.int64),
            channel=channel,
            range_bin=np.searchsorted(RANGE_EDGES_M, range_m, side="right"),
            block=block_of(camera, cell, cell_px, image_size),
            observations=np.where(length_px < config.least_px, 0.0, counted),
            bin_share=of_bin.reshape(num, self.num_bins) / np.maximum(total_px, 1e-9)[:, None],
            sample_piece=piece,
            sample_px=seen.signed_px.astype(np.float64),
            sample_weight=weight,
            border=self.cells.rows(camera, channel, cell),
        )

    def seen(self, scale_px: np.ndarray) -> np.ndarray:
        """Probability of each bin of distance for seen samples, float[channel bin]."""
        config = self.config
        edges = np.concatenate([[0.0], self.edges_px, [np.inf]])
        scaled = edges / (np.sqrt(2.0) * np.asarray(scale_px)[:, None])
        narrow, wide = np.diff(erf(scaled), axis=1), np.diff(erf(scaled / config.wide), axis=1)
        return config.narrow * narrow + (1.0 - config.narrow) * wide + config.floor

    def log_ratio(self, scale_px: np.ndarray) -> np.ndarray:
        """Nats of one observation at each distance, float[channel bin]."""
        return self._clipped_log(self.seen(scale_px) / self.null)

    def _clipped_log(self, ratio: np.ndarray) -> np.ndarray:
        return np.clip(np.log(ratio), -self.config.most_nats, self.config.most_nats)

    def match(self, pieces: Pieces, rates: Rates) -> np.ndarray:
        """Nats for each piece that it was seen rather than not, had it to be one of both alone."""
        of_channels = pieces.bin_share @ self.log_ratio(rates.scale_px).T
        return of_channels[np.arange(len(of_channels)), pieces.channel]

    def evidence(self, pieces: Pieces, rates: Rates) -> PoseEvidence:
        """What the masks hold for every pose."""
        match = self.match(pieces, rates)
        nats, beside = self._of_pieces(pieces, rates, match), self._of_borders(pieces, rates)
        num = pieces.num_poses
        blocks = int(max(pieces.block.max(initial=0), self.cells.block.max(initial=0))) + 1
        observations = np.bincount(pieces.pose, pieces.observations, num)
        matched = np.bincount(pieces.pose, pieces.observations * (match > self.config.matched_nats), num)
        by_block = np.bincount(pieces.pose * blocks + pieces.block, nats, num * blocks).reshape(num, blocks)
        both = by_block + self._by_block(beside.nats, blocks)
        weight = self._border_observations
        share = beside.left @ weight / max(weight.sum(), 1e-9)
        return PoseEvidence(by_block.sum(axis=1), observations, matched / np.maximum(observations, 1e-9), both, share)

    def total_nats(self, pieces: Pieces, rates: Rates) -> np.ndarray:
        """Sum of the nats of all blocks of every pose, float[n]."""
        nats = self._of_pieces(pieces, rates, self.match(pieces, rates))
        worth = self._border_worth(rates)
        beside = (1.0 - self._at_random_of_border) @ worth - self._covered(pieces, rates.scale_px) @ worth
        return np.bincount(pieces.pose, nats, pieces.num_poses) + beside

    def _of_pieces(self, pieces: Pieces, rates: Rates, match: np.ndarray) -> np.ndarray:
        """Nats of each piece, which was seen or not."""
        detection = rates.detection[pieces.channel, pieces.range_bin]
        return pieces.observations * np.log(1.0 - detection + detection * np.exp(match))

    @property
    def _at_random_of_border(self) -> np.ndarray:
        return self.left_over_at_random[self.cells.channel]

    def _border_worth(self, rates: Rates) -> np.ndarray:
        """Nats of each border that is left over; against what random poses leave over, so that they hold nothing on
        the mean."""
        return self._border_observations * np.log(rates.left_over / self.left_over_at_random)[self.cells.channel]

    def _of_borders(self, pieces: Pieces, rates: Rates) -> "_Beside":
        """Nats of each border of every pose for what the map leaves over of it."""
        left = self.left_over(pieces, rates.scale_px)
        return _Beside(left, (left - self._at_random_of_border) * self._border_worth(rates))

    def _by_block(self, of_border: np.ndarray, blocks: int) -> np.ndarray:
        """Sums over the borders in each part of the image, float[pose block]."""
        where = np.arange(len(of_border))[:, None] * blocks + self.cells.block
        return np.bincount(where.ravel(), of_border.ravel(), len(of_border) * blocks).reshape(-1, blocks)

    def start_rates(self) -> Rates:
        """Rates before anything is known of the frame."""
        config = self.config
        detection = np.full((self.num_channels, len(RANGE_EDGES_M) + 1), config.rate)
        return Rates(self.start_scale_px, detection, config.left_over * self.left_over_at_random)

    @property
    def start_scale_px(self) -> np.ndarray:
        """Scale of each channel before anything is known of the frame, float[channel]."""
        return np.full(self.num_channels, self.unit_px * 2.5)

    def fit(self, pieces: Pieces) -> Rates:
        """Rates with which the pieces of one pose are likeliest: expectation-maximisation with a prior."""
        return self.fit_each(pieces)[0]

    def fit_each(self, pieces: Pieces) -> list[Rates]:
        """Rates with which the pieces of each pose are likeliest, every pose on its own."""
        num, config, start = pieces.num_poses, self.config, self.start_rates()
        scale_px = np.tile(start.scale_px, num)
        detection = np.tile(start.detection, (num, 1))
        low, high = (self.unit_px * limit for limit in config.scale_px)
        # Channels of all poses beside each other: those of one pose are told apart by its number.
        channel = pieces.pose * self.num_channels + pieces.channel
        null = np.tile(self.null, (num, 1))
        of_sample, squares = channel[pieces.sample_piece], pieces.sample_px**2
        key, size = channel * detection.shape[1] + pieces.range_bin, detection.size
        tries = np.bincount(key, pieces.observations, size).reshape(detection.shape)
        for _ in range(config.rounds):
            table = self._clipped_log(self.seen(scale_px) / null)
            match = np.einsum("pb,pb->p", pieces.bin_share, table[channel])
            rate = detection[channel, pieces.range_bin]
            odds = rate * np.exp(match)
            seen = odds / (1.0 - rate + odds)
            held = (pieces.observations * seen)[pieces.sample_piece] * pieces.sample_weight
            precision, share = self._within_scale(pieces.sample_px, scale_px[of_sample])
            squared = np.bincount(of_sample, held * precision * squares, len(scale_px))
            total = np.bincount(of_sample, held * share, len(scale_px))
            found_px = np.sqrt(squared / np.maximum(total, 1e-9))
            scale_px = np.where(total > 0, np.clip(found_px, low, high), scale_px)
            hits = np.bincount(key, pieces.observations * seen, size).reshape(detection.shape)
            prior = config.rate_strength
            detection = (prior * config.rate + hits) / (prior + tries)
        found = []
        for pose, (scale, rate) in enumerate(
            zip(scale_px.reshape(num, -1), detection.reshape(num, self.num_channels, -1), strict=True)
        ):
            left = self.left_over(pieces.of_pose(pose), scale)[0]
            left = self._by_channel(left, start.left_over)
            found.append(Rates(scale, rate, np.minimum(left, self.left_over_at_random)))
        return found

    def _within_scale(self, sample_px: np.ndarray, scale_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For each sample the weight of its square and of itself in the scale: narrow, wide or stray."""
        config = self.config
        scaled = sample_px / scale_px
        narrow = config.narrow * np.exp(-0.5 * scaled**2) / scale_px
        wide = (1.0 - config.narrow) * np.exp(-0.5 * (scaled / config.wide) ** 2) / (config.wide * scale_px)
        total = narrow + wide + config.floor / self.unit_px
        return (narrow + wide / config.wide**2) / total, (narrow + wide) / total

    def border_offset_px(self, pieces: Pieces, rates: Rates) -> float:
        """How far matched pieces of a pose lie outside of their masks, in the class with most of them [px]; NaN: none.

        Not part of the evidence, where it would be an excuse: masks thinner than the paint of the map show it, and so
        does a pose between two lines.
        """
        matched = self.match(pieces, rates) > self.config.matched_nats
        counts = np.bincount(pieces.channel[matched], pieces.observations[matched], self.num_channels)
        channel = int(np.argmax(counts))
        own = (matched & (pieces.channel == channel))[pieces.sample_piece]
        # What is far from any border lies outside of the masks, which are thin: no offset of theirs.
        own &= np.abs(pieces.sample_px) < 3.0 * rates.scale_px[channel]
        if own.sum() < _LEAST_SAMPLES:
            return float("nan")
        order = np.argsort(pieces.sample_px[own])
        weight = np.cumsum(pieces.sample_weight[own][order])
        return float(pieces.sample_px[own][order][np.searchsorted(weight, 0.5 * weight[-1])])


def best_rates(null: EvidenceNull, pieces: Pieces, log_prior: np.ndarray, candidates: np.ndarray) -> Rates:
    """The rates of that candidate under whose own fit evidence and prior together are highest.

    A fit at one wrong winner would confirm itself.
    """
    best, best_nats = null.start_rates(), -np.inf
    for rates in null.fit_each(pieces.of_poses(candidates)):
        nats = float(np.max(null.total_nats(pieces, rates) + log_prior))
        if nats > best_nats:
            best, best_nats = rates, nats
    return best
