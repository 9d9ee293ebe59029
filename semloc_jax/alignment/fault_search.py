"""A frame solved with other lenses and without kinds of elements (room: alignment; host).

In: a frame, the steps of a search in it, the pose that was found. Out: LensDoubt, every FaultMode.
A wrong lens and elements that were moved are paid with another place along the road, often behind a ridge of the cost
that no solve crosses from the pose that was found: they are tried from places before and behind it.
"""

from collections.abc import Sequence

import numpy as np

from semloc_jax.alignment.agreement import NUM_KINDS
from semloc_jax.alignment.candidates import planar, solve_all
from semloc_jax.alignment.fault_modes import PLANE, FaultConfig, FaultMode, places_without
from semloc_jax.alignment.lens_doubt import LensDoubt, ThroughLens, doubted
from semloc_jax.alignment.map_pieces import Rates
from semloc_jax.alignment.posterior import temper
from semloc_jax.alignment.search_steps import SearchSteps
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

    def __init__(self, steps: SearchSteps, frame: FrameInput, T_map_base: np.ndarray, in_view_px: float):
        """The frame has its grain; the pose is relative to the local origin."""
        self.steps, self.frame, self.T, self.in_view_px = steps, frame, T_map_base, in_view_px
        self.whole = np.ones((1, len(frame.samples.label)), bool)

    def weighed(self, covariance: np.ndarray, rates: Rates, config: FaultConfig) -> tuple[LensDoubt, list[FaultMode]]:
        """The lens that the frame speaks for; the poses with other lenses, and those that the map has without lane
        lines and without what stands. The covariance is that of the pose."""
        doubt, of_lenses = doubted(self.frame.rig, self._through, covariance, config)
        return doubt, [*of_lenses, *self._kinds(rates, config)]

    def _through(self, rigs: Sequence[Rig]) -> list[ThroughLens]:
        """The best pose through each of some cameras, the stated ones first; the kinds are solved in the same call."""
        steps, ahead, num = self.steps, self._starts(_LENS_STARTS_M), len(rigs)
        parts, beside = self._kind_parts(), self._starts(_KIND_STARTS_M)
        lens = np.concatenate([np.repeat(np.arange(num), len(ahead)), np.zeros(len(parts) * len(beside), int)])
        part = np.concatenate([np.zeros(num * len(ahead), int), np.repeat(parts, len(beside))])
        starts = np.concatenate([np.tile(ahead, (num, 1, 1)), np.tile(beside, (len(parts), 1, 1))])
        found = steps.solved_with_few(starts, self.in_view_px, part, rigs, lens)
        few, self._without = found.rows(slice(num * len(ahead))), found.rows(slice(num * len(ahead), None))
        # Few samples rank places roughly: from the pose itself it is solved to the end as well.
        others = np.asarray(few.estimates.T_map_base, np.float64)[_least_of_each(few.score, num)]
        starts = np.stack([np.repeat(self.T[None], num, axis=0), others], axis=1).reshape(-1, 4, 4)
        known = steps.road, steps.wide_sigma, self.frame, self.in_view_px, steps.frame_config
        lens = np.repeat(np.arange(num), 2)
        solved = solve_all(starts, *known, steps.final_align, self.whole, rigs=rigs, lens=lens)
        Ts = np.asarray(solved.estimates.T_map_base, np.float64)
        return [ThroughLens(float(solved.score[row]), Ts[row]) for row in _least_of_each(solved.score, num)]

    def _kind_parts(self) -> np.ndarray:
        """The parts of the map without each of the kinds."""
        return len(self.steps.parts) - NUM_KINDS + 1 + 2 * np.arange(len(_KINDS))

    def _kinds(self, rates: Rates, config: FaultConfig) -> list[FaultMode]:
        """The poses that the map has without lane lines, and without what stands."""
        rests = self._kind_parts()
        part = np.repeat(rests, len(_KIND_STARTS_M))
        Ts = np.asarray(self._without.estimates.T_map_base, np.float64)
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
        nats = self.steps.null.evidence(pieces, rates).block_nats
        return ((nats.sum(axis=1) - nats[0].sum()) * temper(nats, 0, self.steps.config.posterior))[1:]

    def _starts(self, ahead_m: np.ndarray) -> np.ndarray:
        return self.steps.road.place(self.T @ planar(ahead_m, np.zeros_like(ahead_m), np.zeros_like(ahead_m)))


def _least_of_each(score: np.ndarray, num: int) -> np.ndarray:
    """Rows of the least of the scores of each of `num` groups that follow one another, int[num]."""
    each = np.nan_to_num(np.asarray(score), nan=np.inf).reshape(num, -1)
    return each.argmin(axis=1) + np.arange(num) * each.shape[1]
