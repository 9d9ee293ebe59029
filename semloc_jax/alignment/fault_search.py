"""A frame solved with other lenses and without kinds of elements (room: alignment; host).

In: a frame, the steps of a search in it, the pose that was found. Out: LensDoubt, every FaultMode.
A wrong lens and elements that were moved are paid with another place along the road, often behind a ridge of the cost
that no solve crosses from the pose that was found: they are tried from places before and behind it.
"""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from semloc_jax.alignment.agreement import NUM_KINDS
from semloc_jax.alignment.candidates import planar, solve_all
from semloc_jax.alignment.fault_modes import PLANE, FaultConfig, FaultMode, places_without
from semloc_jax.alignment.lens_doubt import LensDoubt, ThroughLens, doubted, told_share
from semloc_jax.alignment.map_pieces import Rates
from semloc_jax.alignment.posterior import PosteriorConfig, temper
from semloc_jax.alignment.search_steps import SearchSteps
from semloc_jax.alignment.seen_samples import SeenSamples
from semloc_jax.alignment.single_frame import FrameInput
from semloc_jax.cameras import Rig
from semloc_jax.geometry import rigid

_LENS_STARTS_M = np.array([0.0, -0.5, 0.5, -1.0, 1.0])
_KIND_STEP_M = 0.5
_KIND_STARTS_M = _KIND_STEP_M * np.arange(-4, 5)
"""Ours: minima of a cost along the road are a third of a metre and more apart."""
_KINDS = ("lane lines", "posts and signs")


class FaultSearch:
    """What may be wrong with one pose of a frame."""

    def __init__(self, steps: SearchSteps, frame: FrameInput, T_local_base: np.ndarray, in_view_px: float):
        """The frame has its grain; the pose is relative to the local origin."""
        self.steps, self.frame, self.T, self.in_view_px = steps, frame, T_local_base, in_view_px
        self.whole = np.ones((1, len(frame.samples.label)), bool)

    def weighed(self, covariance: np.ndarray, rates: Rates, config: FaultConfig) -> tuple[LensDoubt, list[FaultMode]]:
        """The lens that the frame speaks for; the poses with other lenses, and those that the map has without lane
        lines and without what stands. The covariance is that of the pose."""
        doubt, of_lenses = doubted(self.frame.rig, lambda rigs: self._through(rigs, rates), covariance, config)
        return doubt, [*of_lenses, *self._kinds(rates, config)]

    def _through(self, rigs: Sequence[Rig], rates: Rates) -> list[ThroughLens]:
        """The best pose through each of some cameras, the stated ones first; the kinds are solved in the same call."""
        steps, ahead, num = self.steps, self._starts(_LENS_STARTS_M), len(rigs)
        parts, beside = self._kind_parts(), self._starts(_KIND_STARTS_M)
        lens = np.concatenate([np.repeat(np.arange(num), len(ahead)), np.zeros(len(parts) * len(beside), int)])
        part = np.concatenate([np.zeros(num * len(ahead), int), np.repeat(parts, len(beside))])
        starts = np.concatenate([np.tile(ahead, (num, 1, 1)), np.tile(beside, (len(parts), 1, 1))])
        found = steps.solved_with_few(starts, self.in_view_px, part, rigs, lens)
        few, self._without = found.rows(slice(num * len(ahead))), found.rows(slice(num * len(ahead), None))
        # Few samples rank places roughly: from the pose itself it is solved to the end as well.
        others = np.asarray(few.estimates.T_local_base, np.float64)[_least_of_each(few.score, num)]
        starts = np.stack([np.repeat(self.T[None], num, axis=0), others], axis=1).reshape(-1, 4, 4)
        known = steps.road, steps.wide_sigma, self.frame, self.in_view_px, steps.frame_config
        lens = np.repeat(np.arange(num), 2)
        solved = solve_all(starts, *known, steps.final_align, self.whole, rigs=rigs, lens=lens)
        rows = _least_of_each(solved.score, num)
        best = solved.rows(rows)
        Ts = np.asarray(best.estimates.T_local_base, np.float64)
        share = told_share(float(best.estimates.coverage[0]), float(best.estimates.inlier_ratio[0]))
        cost = share * np.asarray(best.score)
        known = zip(cost.tolist(), Ts, self._nats_through(rigs, Ts, rates), strict=True)
        return [ThroughLens(*one) for one in known]

    def _nats_through(self, rigs: Sequence[Rig], Ts: np.ndarray, rates: Rates) -> list[float]:
        """By how much the evidence is higher through each of some cameras at its pose than through the first ones."""
        steps = self.steps
        seen = [steps.observed(T[None], rig=rig) for rig, T in zip(rigs, Ts, strict=True)]
        pieces = steps.null.pieces(reduce(SeenSamples.joined, seen), steps.image_size, steps.observe_config.cell_px)
        return _gained(steps.null.evidence(pieces, rates).block_nats, steps.config.posterior).tolist()

    def _kind_parts(self) -> np.ndarray:
        """The parts of the map without each of the kinds."""
        return len(self.steps.parts) - NUM_KINDS + 1 + 2 * np.arange(len(_KINDS))

    def _kinds(self, rates: Rates, config: FaultConfig) -> list[FaultMode]:
        """The poses that the map has without lane lines, and without what stands."""
        rests = self._kind_parts()
        part = np.repeat(rests, len(_KIND_STARTS_M))
        Ts = np.asarray(self._without.estimates.T_local_base, np.float64)
        covariance = np.asarray(self._without.estimates.covariance, np.float64)[:, PLANE][:, :, PLANE]
        found = []
        for rest, kind in zip(rests, _KINDS, strict=True):
            own = part == rest
            gain = self._gain(Ts[own], self.steps.parts[rest], rates)
            moved = rigid.log(rigid.inverse(self.T) @ Ts[own])[:, PLANE]
            cause = f"{kind} that do not stand where the map says"
            held = np.asarray(self.steps.wide_sigma, np.float64)[list(PLANE)]
            found += places_without(gain, moved, covariance[own], held, _KIND_STEP_M, cause, config)
        return found

    def _gain(self, Ts: np.ndarray, part: np.ndarray, rates: Rates) -> np.ndarray:
        """By how much a part of the map fits better at each pose than at the one that is told [nats], as far as the
        scatter of that over the image can be believed."""
        pieces = self.steps.pieces(np.concatenate([self.T[None], Ts]), part)
        return _gained(self.steps.null.evidence(pieces, rates).block_nats, self.steps.config.posterior)[1:]

    def _starts(self, ahead_m: np.ndarray) -> np.ndarray:
        return self.steps.road.place(self.T @ planar(ahead_m, np.zeros_like(ahead_m), np.zeros_like(ahead_m)))


def _gained(block_nats: np.ndarray, config: PosteriorConfig) -> np.ndarray:
    """Evidence of each row over the first one [nats], as far as its scatter over the image can be believed."""
    return (block_nats.sum(axis=1) - block_nats[0].sum()) * temper(block_nats, 0, config)


def _least_of_each(score: np.ndarray, num: int) -> np.ndarray:
    """Rows of the least of the scores of each of `num` groups that follow one another, int[num]."""
    each = np.nan_to_num(np.asarray(score), nan=np.inf).reshape(num, -1)
    return each.argmin(axis=1) + np.arange(num) * each.shape[1]
