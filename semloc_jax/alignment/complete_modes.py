"""All places that explain a frame, with probabilities (room: alignment; host).

In: one frame, its prior, distances to mask borders. Out: FoundModes: modes best first, what speaks for each of them.
Search and ranking go by evidence with a null; places at which the map repeats itself are proposed, solved and weighed
like all others; the ramp cost is what the solves descend on, no more.
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial

import jax
import numpy as np

from semloc_jax.alignment.agreement import NUM_KINDS, disagreement, kinds_apart
from semloc_jax.alignment.along_road import RoadPosterior, weighed_along_road, widened
from semloc_jax.alignment.candidates import SolvedPoses, along_weak, apart, not_near, solve_all
from semloc_jax.alignment.fault_modes import PLANE, joined
from semloc_jax.alignment.fault_search import FaultSearch
from semloc_jax.alignment.map_pieces import Pieces, PoseEvidence, Rates
from semloc_jax.alignment.modes import modes_in_map, weighed
from semloc_jax.alignment.pose import Prior
from semloc_jax.alignment.posterior import Ridges, spread, temper
from semloc_jax.alignment.result import FoundModes, ModeEvidence
from semloc_jax.alignment.same_pose import ONE_PLACE, ONE_TRACK, units_apart
from semloc_jax.alignment.search_steps import SearchSteps
from semloc_jax.alignment.single_frame import FrameInput, evidence_from, sharpest
from semloc_jax.alignment.walk import walked
from semloc_jax.geometry import rigid
from semloc_jax.residuals.noise import POSE_SHARE
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import SolveStatus

_widened = stored_program()(widened)
_BESIDE = 0.3
"""Poses of one optimum that are solved to the end are so many units apart."""


def beside_and_apart(Ts: np.ndarray, log_weight: np.ndarray, keep: int) -> np.ndarray:
    """Rows of the poses of one place to solve to the end, int[k]: some beside the best one, and the best of each other
    optimum. A place is as long as a street, and all that is beside the best one may be beside the wrong one."""
    return np.unique(np.concatenate([apart(Ts, log_weight, keep, units) for units in (_BESIDE, ONE_PLACE)]))


class ModeFinder(SearchSteps):
    """The places of one frame."""

    def find(self) -> FoundModes:
        """All places, best first."""
        ramps, in_view_px = self.by_ramps()
        solved = self.candidates(np.concatenate([self.coarse(), ramps]), in_view_px)
        Ts = np.asarray(solved.estimates.T_local_base, dtype=np.float64)
        pieces = self.pieces(Ts)
        found, rates = self._evidence_of(Ts, pieces, None)
        first = self.ridges(Ts, found, np.asarray(solved.estimates.status))
        leaders = Ts[first.best[:2]] if len(first.best) else self.T_prior[None]
        again = [*(self.aliases(T) for T in leaders), self.walked(leaders[0])]
        # A solve from beside a place that was found ends there.
        shifted = not_near(np.concatenate(again), Ts, ONE_TRACK)
        if len(shifted):
            more = self.candidates(shifted, in_view_px)
            pieces = pieces.joined(self.pieces(np.asarray(more.estimates.T_local_base, dtype=np.float64)))
            solved = jax.tree.map(lambda *leaves: np.concatenate(leaves), solved, more)
            Ts = np.asarray(solved.estimates.T_local_base, dtype=np.float64)
            found, rates = self._evidence_of(Ts, pieces, None)
        places = self.ridges(Ts, found, np.asarray(solved.estimates.status))
        return self.finished(solved, places, rates, in_view_px)

    def finished(
        self,
        solved: SolvedPoses,
        places: Ridges,
        rates: Rates,
        in_view_px: float,
    ) -> FoundModes:
        """The best places solved to the end, weighed and brought into the map frame."""
        config = self.config
        Ts = np.asarray(solved.estimates.T_local_base, dtype=np.float64)
        if not len(places.best):
            return FoundModes((), SolveStatus.NO_EVIDENCE, 0)
        best = Ts[places.best[0]]
        own = np.flatnonzero((places.home == 0) & (places.log_weight > -config.within_nats))
        own = own[beside_and_apart(Ts[own], places.log_weight[own], config.num_final)]
        covariance = np.asarray(solved.estimates.covariance[places.best[0]], dtype=np.float64)
        restarts = best @ along_weak(covariance, config.lever_m, config.restarts, config.restart_step_m)
        centre = np.asarray(self.road.place(best[None])[0], np.float32)
        centre = Prior(centre, np.asarray(self.wide_sigma, np.float32))
        _, grain = sharpest(np.asarray(best, np.float32), self.frame, centre, self.frame_config)
        frame = self.frame._replace(grain=grain)
        road_through = partial(self._road_through, frame=frame, prior=centre)
        road = road_through(best)
        beside = np.asarray(road.Ts_local_base, dtype=np.float64)[np.isfinite(road.scores)]
        others = Ts[places.best[1 : config.num_final + 1]]
        starts = np.concatenate([Ts[own], beside, restarts, others])
        whole = np.ones((1, len(frame.samples.label)), bool)
        solved = solve_all(
            starts, self.road, self.wide_sigma, frame, in_view_px, self.frame_config, self.final_align, whole
        )
        Ts_end = np.asarray(solved.estimates.T_local_base, dtype=np.float64)
        pieces = self.pieces(Ts_end)
        found, rates = self._evidence_of(Ts_end, pieces, rates)
        last = self.ridges(Ts_end, found, np.asarray(solved.estimates.status))
        if not len(last.best):
            return FoundModes((), SolveStatus.NO_EVIDENCE, 0)
        found = self._in_map(solved, Ts_end, (pieces, found), last, rates, road_through, in_view_px)
        found = replace(found, margin_nats=min(places.margin_nats, last.margin_nats))
        return self._with_faults(found, frame, rates, in_view_px)

    def _with_faults(self, found: FoundModes, frame: FrameInput, rates: Rates, in_view_px: float) -> FoundModes:
        """The places with what may be wrong with the best one."""
        if not found.modes:
            return found
        best, plane = found.modes[0], np.ix_(PLANE, PLANE)
        sound = best.covariance[plane]
        search = FaultSearch(self, frame, self.local.from_map(best.T_map_base, np.float64), in_view_px)
        doubt, faults = search.weighed(sound, rates, self.faults)
        covariance = best.covariance.copy()
        covariance[plane] = joined(sound, faults)
        best = replace(best, covariance=covariance, evidence=replace(best.evidence, **asdict(doubt)))
        return replace(found, modes=(best, *found.modes[1:]), sound=sound, faults=tuple(faults))

    def walked(self, T_local_base: np.ndarray) -> np.ndarray:
        """Places along the road through a pose that fit as well, see `alignment.walk`."""
        centre = self.road.place(T_local_base[None])[0]
        prior = Prior(np.asarray(centre, np.float32), np.asarray(self.wide_sigma, np.float32))
        through = partial(self._road_through, frame=self.frame, prior=prior)
        reach_m = self.frame_config.along_road.reach_m
        return walked(T_local_base, float(self.sigma[0]), reach_m, self.road.place, through)

    def _road_through(self, T_local_base: np.ndarray, frame: FrameInput, prior: Prior) -> RoadPosterior:
        """Places along the road through a pose."""
        T = np.asarray(T_local_base, np.float32)
        closer = evidence_from(T, frame, self.frame_config.polish_view)
        config = self.frame_config
        return jax.device_get(
            weighed_along_road(T, closer, prior, config.search_align, config.along_road, config.search.chunk)
        )

    def _in_map(
        self,
        solved: SolvedPoses,
        Ts: np.ndarray,
        seen: tuple[Pieces, PoseEvidence],
        places: Ridges,
        rates: Rates,
        road_through: Callable[[np.ndarray], RoadPosterior],
        in_view_px: float,
    ) -> FoundModes:
        config = self.config
        members = np.flatnonzero((places.home == 0) & (places.log_weight > -config.within_nats))
        # Evidence and ramp cost know the same masks by other means: neither alone decides between neighbours, and their
        # sum would count every border twice.
        held = 0.5 * (places.log_weight[members] - np.asarray(solved.score, dtype=np.float64)[members])
        converged = np.asarray(solved.estimates.status)[members] == SolveStatus.CONVERGED
        chosen = int(members[np.argmax(np.where(converged | ~converged.any(), held, -np.inf))])
        near = units_apart(Ts[members], Ts[chosen]) < ONE_PLACE
        modes = []
        for place, leader in enumerate(places.best):
            rows, nats = (members[near], -held[near]) if place == 0 else (np.array([leader]), np.zeros(1))
            local = modes_in_map(weighed(solved.estimates, rows, nats), self.local, ONE_PLACE)
            if not local:
                continue
            covariance, row = local[0].covariance, int(leader)
            if place == 0:
                # Through the pose that is told: one that candidates proposed may lie in a valley beside it.
                along = self._spread_along(Ts[chosen], road_through(Ts[chosen]), rates)
                moments = spread(Ts[chosen], Ts[members], held).diagonal()
                covariance, contradiction = self._covariance(covariance, Ts[chosen], along, moments, in_view_px)
                row = chosen
            evidence = self._mode_evidence(Ts[row], row, seen, rates, int(solved.estimates.status[row]))
            if place == 0:
                evidence = replace(evidence, **contradiction)
            weight = float(places.probability[place])
            modes.append(replace(local[0], weight=weight, covariance=covariance, evidence=evidence))
        confirmed = int((units_apart(Ts, Ts[chosen]) < ONE_TRACK).sum()) - 1
        return FoundModes(tuple(modes), SolveStatus(int(solved.estimates.status[chosen])), confirmed)

    def _covariance(
        self, of_noise: np.ndarray, T_local_base: np.ndarray, along: np.ndarray, moments: np.ndarray, in_view_px: float
    ) -> tuple[np.ndarray, dict[str, float]]:
        """Covariance of the best pose, and whether kinds of elements agree about it.

        As long along the road as its valley; forward, to the left and in heading no smaller than the poses of its place
        and the halves of the map scatter.

        Args:
            of_noise: float[6 6], as the noise model has it.
            T_local_base: The pose.
            along: Of `_spread_along`.
            moments: float[3], of the poses of its place.
            in_view_px: Length of contour in view.
        """
        plane = np.array(PLANE)
        told, promised = (_widened((c * of_noise).astype(np.float32), along) for c in (POSE_SHARE, 1.0))
        # Halves are solved with few samples: they are held against what the noise model promises for them.
        known = np.maximum(moments, np.asarray(promised).diagonal()[plane])
        of_halves, contradiction = self.disagreement(T_local_base, in_view_px, known)
        covariance = np.array(told, dtype=np.float64)
        covariance[plane, plane] = np.maximum.reduce([moments, covariance.diagonal()[plane], of_halves])
        return covariance, contradiction

    def disagreement(
        self, T_local_base: np.ndarray, in_view_px: float, variance: np.ndarray
    ) -> tuple[np.ndarray, dict[str, float]]:
        """Variance of the best pose by those of halves of the map, and whether kinds of elements agree about it."""
        # All of it once more as well, with as few samples: like is compared with like.
        part = np.arange(len(self.parts))
        solved = self.solved_with_few(np.repeat(T_local_base[None], len(part), axis=0), in_view_px, part)
        Ts = np.asarray(solved.estimates.T_local_base, dtype=np.float64)
        first = len(part) - NUM_KINDS
        covariance = np.asarray(solved.estimates.covariance, dtype=np.float64)[first:][:, PLANE][:, :, PLANE]
        return disagreement(Ts[0], Ts[1:first], variance), asdict(kinds_apart(Ts[first:], covariance))

    def _spread_along(self, T_local_base: np.ndarray, road: RoadPosterior, rates: Rates) -> np.ndarray:
        """Second moment of the posterior over places along the road about a pose, in its right tangent, float32[6 6].

        Solves end at local minima, dashes or not: where the sides of lines are all there is, the masks are flat between
        them, and only the prior would say where the vehicle is. Evidence and ramp cost know the same masks by other
        means and count half each; where variances are `POSE_SHARE` of what the noise model has, nats are worth more.
        """
        places = np.asarray(road.places, dtype=np.float64)
        found, _ = self.evidence(np.concatenate([places, T_local_base[None]]), rates)
        tempered = temper(found.block_nats, len(places), self.config.posterior)
        nats = found.block_nats.sum(axis=1)
        evidence = (tempered * (nats - nats[-1]))[:-1]
        log_masks = 0.5 * (evidence + np.asarray(road.log_masks, np.float64)) / POSE_SHARE
        log_weight = log_masks + np.asarray(road.log_prior, np.float64)
        log_weight = np.where(np.isfinite(log_weight), log_weight, -1e9)
        share = np.exp(log_weight - log_weight.max())
        away = rigid.log(np.linalg.inv(T_local_base) @ places)
        return np.einsum("k,ki,kj->ij", share / share.sum(), away, away).astype(np.float32)

    def _mode_evidence(
        self, T: np.ndarray, row: int, seen: tuple[Pieces, PoseEvidence], rates: Rates, status: int
    ) -> ModeEvidence:
        pieces, found = seen
        offset_px = self.null.border_offset_px(pieces.of_pose(row), rates) / self.unit_px
        return ModeEvidence(
            nats=float(found.nats[row]),
            nats_per_piece=float(found.nats[row] / max(found.observations[row], 1e-9)),
            explained=float(found.explained[row]),
            left_over=float(found.left_over[row]),
            border_offset_px=offset_px,
            log_prior=float(self.log_prior(T[None])[0]),
            status=SolveStatus(status),
        )
