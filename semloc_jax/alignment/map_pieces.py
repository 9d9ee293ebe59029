"""Pieces of map as poses see them, and what they say (room: alignment; host).

In: the counts of `evidence_null`. Out: Pieces of several poses, the Rates of a frame, the evidence of every pose.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class Rates:
    """What the frame says about its own masks.

    Attributes:
        scale_px: of the distances of seen samples, for each channel.
        detection: probability that a piece is seen, float[channel range].
        left_over: share of the borders of each channel on which no contour of the map lies, float[channel].
    """

    scale_px: np.ndarray
    detection: np.ndarray
    left_over: np.ndarray


@dataclass(frozen=True)
class Pieces:
    """The pieces of several poses; all arrays have one row for each piece, or for each sample of them.

    Attributes:
        num_poses: number of poses.
        pose, channel, range_bin: of each piece.
        block: coarse part of the image that each piece lies in.
        observations: how much each piece counts.
        bin_share: share of the length of each piece whose distance is in each bin, float[piece bin].
        sample_piece, sample_px, sample_weight: piece, signed distance and length of each sample.
        border: row of the border of its class in its cell, -1 for none.
    """

    num_poses: int
    pose: np.ndarray
    channel: np.ndarray
    range_bin: np.ndarray
    block: np.ndarray
    observations: np.ndarray
    bin_share: np.ndarray
    sample_piece: np.ndarray
    sample_px: np.ndarray
    sample_weight: np.ndarray
    border: np.ndarray

    def of_pose(self, index: int) -> "Pieces":
        """The pieces of one pose alone."""
        return self.of_poses([index])

    def of_poses(self, indices: Sequence[int] | np.ndarray) -> "Pieces":
        """The pieces of some poses, which are numbered anew in the order of `indices`."""
        place = np.full(self.num_poses, -1)
        place[np.asarray(indices, int)] = np.arange(len(indices))
        kept = place[self.pose] >= 0
        number = np.cumsum(kept) - 1
        own = kept[self.sample_piece]
        names = ("channel", "range_bin", "block", "border", "observations", "bin_share")
        rows = {name: getattr(self, name)[kept] for name in names}
        samples = {name: getattr(self, name)[own] for name in ("sample_px", "sample_weight")}
        known = {"pose": place[self.pose[kept]], "sample_piece": number[self.sample_piece[own]]}
        return Pieces(len(indices), **known, **rows, **samples)

    def joined(self, other: "Pieces") -> "Pieces":
        """The pieces of these poses and of others after them."""
        later = {"pose": self.num_poses, "sample_piece": len(self.pose)}
        pairs = {name: (getattr(self, name), getattr(other, name) + later.get(name, 0)) for name in _COLUMNS}
        joined = {name: np.concatenate(pair) for name, pair in pairs.items()}
        return Pieces(self.num_poses + other.num_poses, **joined)

    @cached_property
    def on_borders(self) -> "OnBorders":
        """The samples whose class has a border in their cell."""
        border = self.border[self.sample_piece]
        rows = np.flatnonzero(border >= 0)
        piece = self.sample_piece[rows]
        away_px = np.abs(self.sample_px[rows])
        return OnBorders(self.pose[piece], border[rows], self.channel[piece], away_px, self.sample_weight[rows])


_COLUMNS = tuple(field.name for field in fields(Pieces) if field.name != "num_poses")


class OnBorders(NamedTuple):
    """Samples in cells with borders of their class."""

    pose: np.ndarray
    border: np.ndarray
    channel: np.ndarray
    away_px: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class PoseEvidence:
    """What the masks hold for each pose.

    Attributes:
        nats: float[n], of the map that is seen or not.
        observations: float[n], number of full pieces in view.
        explained: float[n], share of them that is matched.
        block_nats: float[n block], the same by part of the image, with those of the borders that the map leaves over.
        left_over: float[n], share of the borders on which no contour of the map lies.
    """

    nats: np.ndarray
    observations: np.ndarray
    explained: np.ndarray
    block_nats: np.ndarray
    left_over: np.ndarray
