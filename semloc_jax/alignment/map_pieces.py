"""Pieces of map as poses see them, and what they say (room: alignment; host).

In: the counts of `evidence_null`. Out: Pieces of several poses, the Rates of a frame, the evidence of every pose.
"""

from dataclasses import dataclass

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
        sample_piece, sample_px, sample_weight: piece, signed distance and length of each sample.
        sample_bin: bin of its distance.
        border: row of the border of its class in its cell, -1 for none.
    """

    num_poses: int
    pose: np.ndarray
    channel: np.ndarray
    range_bin: np.ndarray
    block: np.ndarray
    observations: np.ndarray
    sample_piece: np.ndarray
    sample_px: np.ndarray
    sample_weight: np.ndarray
    sample_bin: np.ndarray
    border: np.ndarray

    def of_pose(self, index: int) -> "Pieces":
        """The pieces of one pose alone."""
        kept = self.pose == index
        number = np.cumsum(kept) - 1
        own = kept[self.sample_piece]
        rows = {name: getattr(self, name)[kept] for name in ("channel", "range_bin", "block", "border", "observations")}
        samples = {name: getattr(self, name)[own] for name in ("sample_px", "sample_weight", "sample_bin")}
        pose = np.zeros(int(kept.sum()), int)
        return Pieces(1, pose=pose, sample_piece=number[self.sample_piece[own]], **rows, **samples)


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
