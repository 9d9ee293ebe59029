"""All places that explain a frame, with probabilities (room: alignment; host).

In: one frame, its prior, distances to mask borders. Out: FoundModes: modes best first, what speaks for each of them.
Search and ranking go by evidence with a null; places at which the map repeats itself are proposed, solved and weighed
like all others; the ramp cost is what the solves descend on, no more.
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.agreement import NUM_KINDS, disagreement, halves, kinds, kinds_apart
from semloc_jax.alignment.aliases import alias_shifts
from semloc_jax.alignment.along_road import RoadPosterior, weighed_along_road, widened
from semloc_jax.alignment.border_cells import BorderCells
from semloc_jax.alignment.candidates import (
    BATCH,
    COARSE_BATCH,
    SolvedPoses,
    along_weak,
    apart,
    coarse_gain,
    coarse_samples,
    coarse_search,
    filled,
    lattice_in_window,
    not_near,
    null_poses,
    planar,
    solve_all,
    spread_out,
    thinned,
    wide_sigma,
)
from semloc_jax.alignment.evidence_null import EvidenceNull, best_rates
from semloc_jax.alignment.hypotheses import search_from
from semloc_jax.alignment.lens_doubt import doubted
from semloc_jax.alignment.map_pieces import Pieces, PoseEvidence, Rates
from semloc_jax.alignment.mode_search import ALIAS_SIGMAS, CompleteModesConfig, FrameImage, half_window_m
from semloc_jax.alignment.modes import modes_in_map, weighed
from semloc_jax.alignment.observed import Borders, ObserveConfig, Observed, observe
from semloc_jax.alignment.pose import Prior, total_weight
from semloc_jax.alignment.posterior import Ridges, log_prior, ridges, same_ridge, spread, temper
from semloc_jax.alignment.result import FoundModes, ModeEvidence
from semloc_jax.alignment.road_patch import RoadPatch
from semloc_jax.alignment.same_pose import ONE_OPTIMUM, ONE_PLACE, ONE_TRACK, units_apart
from semloc_jax.alignment.single_frame import FrameInput, SingleFrameConfig, evidence_from, search_starts, sharpest
from semloc_jax.cameras import Rig
from semloc_jax.geometry import rigid
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.residuals.noise import POSE_SHARE
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import MapSamples, SolveStatus

_widened = stored_program()(widened)
_total_weight = stored_program()(total_weight)


PLANE = (0, 1, 5)
"""Forward, left and heading among the coordinates of a tangent."""


class ModeFinder:
    """The places of one frame."""

    def __init__(
        self,
        frame: FrameInput,
        image: FrameImage,
        prior: Prior,
        road: RoadPatch,
        local: LocalFrame,
        config: CompleteModesConfig,
        frame_config: SingleFrameConfig,
    ):
        """Prepare a frame: what its masks look like from poses that are wrong.

        Args:
            frame: Map samples, cost maps, cameras.
            image: What is known of its masks beyond the cost maps.
            prior: Prior pose and sigmas, relative to the local origin.
            road: The road within `half_window_m` of it.
            local: The local frame.
            config: Constants.
            frame_config: Views, levels and the search by ramps.
        """
        self.frame, self.borders, self.image_size, self.unit_px = frame, image.borders, image.size, image.unit_px
        self.prior, self.road, self.local, self.config, self.frame_config = prior, road, local, config, frame_config
        align = frame_config.polish_align
        self.align = replace(align, levels=config.levels, max_steps=config.max_steps)
        self.final_align = replace(align, max_steps=config.final_max_steps, tolerance=config.final_tolerance)
        self.T_prior = np.asarray(prior.T_map_base, dtype=np.float64)
        self.sigma = np.asarray(prior.sigma, dtype=np.float64)
        # The prior of a solve must not pull.
        self.wide_sigma = wide_sigma(self.sigma, config.least_sigma_m, np.deg2rad(config.least_sigma_deg))
        self.samples = thinned(frame.samples, np.asarray(frame.channel_of_label), config.num_samples)
        self.channel = np.asarray(frame.channel_of_label)[np.asarray(self.samples.label)]
        label = np.where(self.channel >= 0, np.asarray(self.samples.label), -1)
        self.parts = np.concatenate([halves(np.asarray(self.samples.element), config.agreement), kinds(label)])
        view = frame_config.search_view
        self.observe_config = ObserveConfig(view.max_range_m, view.min_ground_px_per_m, 48.0 * self.unit_px)
        self.fields = Borders(
            jnp.asarray(self.borders.signed_px),
            np.float32(self.borders.stride),
            frame.usable.mask,
            np.float32(frame.usable.stride),
        )
        self.half_xy_m = half_window_m(float(self.sigma[0]), config)
        least_rad = np.deg2rad(frame_config.min_reach_deg)
        self.half_heading_rad = max(config.window_heading_sigmas * float(self.sigma[5]), least_rad)
        corners = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (0.5, 0), (-0.5, 0), (0, 0)]) * self.half_xy_m
        spanning = self.T_prior @ planar(corners[:, 0], corners[:, 1], 0.0)
        wrong = null_poses(BATCH - len(corners), self.T_prior, frame_config.seed)
        self.spanning = self.observed(self.road.place(spanning))
        few = jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[:: config.null_every], self.samples))
        self.null = EvidenceNull(
            self.observed(self.road.place(wrong), few),
            self.channel,
            np.maximum(np.asarray(self.samples.element), 0),
            self.unit_px,
            config.null,
            config.null_every,
            BorderCells.of(
                self.borders,
                np.unique(self.channel[self.channel >= 0]),
                np.asarray(frame.usable.mask),
                float(frame.usable.stride),
                self.observe_config.cell_px,
                self.image_size,
            ),
        )

    def observed(self, Ts: np.ndarray, samples: MapSamples | None = None) -> Observed:
        """What each pose sees of all samples that evidence is counted of, or of others, on the host."""
        samples, parts = self.samples if samples is None else samples, []
        for first in range(0, len(Ts), BATCH):
            own = Ts[first : first + BATCH]
            seen = observe(
                jnp.asarray(filled(own, BATCH), jnp.float32),
                np.int32(len(own)),
                samples,
                self.frame.rig,
                self.frame.channel_of_label,
                self.fields,
                self.observe_config,
            )
            parts.append(jax.tree.map(lambda leaf, own=own: np.asarray(leaf)[: len(own)], seen))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)

    def log_prior(self, Ts: np.ndarray) -> np.ndarray:
        """Log prior of each pose."""
        return log_prior(Ts, self.T_prior, max(float(self.sigma[0]), 1e-3), max(float(self.sigma[5]), 1e-4))

    def coarse(self) -> np.ndarray:
        """Poses of a wide first look that differ, best first."""
        config = self.config
        sigma_m = float(self.sigma[0])
        batches = 1 if sigma_m <= 1.0 else 2 if sigma_m <= 5.0 else 12
        Ts = lattice_in_window(batches * COARSE_BATCH, self.T_prior, self.half_xy_m, self.half_heading_rad)
        Ts = self.road.place(Ts)
        samples = coarse_samples(self.spanning, self.samples, self.channel, self.unit_px)
        usable = np.asarray(self.frame.usable.mask)
        gain = coarse_gain(self.null, self.borders, usable, config.coarse_scale_px * self.unit_px)
        best, nats = coarse_search(
            Ts, samples, self.frame, gain, 2 * self.borders.stride, self.log_prior(Ts), self.observe_config
        )
        Ts = Ts[best]
        num_ridges = config.num_ridges * (1 if sigma_m <= 5.0 else 2)
        ridges = spread_out(nats, num_ridges, lambda row: same_ridge(Ts[row], Ts, config.posterior))
        return Ts[np.union1d(apart(Ts, nats, config.num_coarse, config.apart), ridges)]

    def by_ramps(self) -> tuple[np.ndarray, float]:
        """Poses of the search by ramp costs, and the length of contour in view [px]."""
        evidence = evidence_from(self.prior.T_map_base, self.frame, self.frame_config.search_view)
        config = self.frame_config
        # Its later stages refine, which the solves of all candidates do as well.
        search = replace(config.search, stages=config.search.stages[:2])
        Ts, scores = search_from(search_starts(self.prior, config), evidence, self.prior, config.search_align, search)
        Ts = np.asarray(Ts, dtype=np.float64)
        chosen = apart(Ts, -np.asarray(scores, dtype=np.float64), self.config.num_ramps, self.config.apart)
        return Ts[chosen], float(_total_weight(evidence.views))

    def candidates(self, Ts: np.ndarray, in_view_px: float) -> SolvedPoses:
        """Every start refined with few samples; of solves that end at one optimum the best."""
        found = self.solved_with_few(Ts, in_view_px)
        ends = np.asarray(found.estimates.T_map_base, dtype=np.float64)
        return found.rows(apart(ends, -found.score.astype(np.float64), len(ends), ONE_OPTIMUM))

    def solved_with_few(self, Ts: np.ndarray, in_view_px: float, part: np.ndarray | None = None) -> SolvedPoses:
        """Every start refined with few samples, each with its part of the map."""
        frame = self.frame._replace(samples=self.samples)
        view = replace(self.frame_config.polish_view, capacity=self.config.view_samples)
        config = replace(self.frame_config, polish_view=view)
        return solve_all(Ts, self.road, self.wide_sigma, frame, in_view_px, config, self.align, self.parts, part)

    def pieces(self, Ts: np.ndarray) -> Pieces:
        """The pieces of map that each pose sees."""
        return self.null.pieces(self.observed(Ts), self.image_size, self.observe_config.cell_px)

    def evidence(self, Ts: np.ndarray, rates: Rates | None = None) -> tuple[PoseEvidence, Rates]:
        """Evidence of poses, with rates of the frame as the best of them has it where none are given."""
        return self._evidence_of(Ts, self.pieces(Ts), rates)

    def _evidence_of(self, Ts: np.ndarray, pieces: Pieces, rates: Rates | None) -> tuple[PoseEvidence, Rates]:
        if rates is None:
            prior = self.log_prior(Ts)
            first = self.null.evidence(pieces, self.null.start_rates()).block_nats.sum(axis=1) + prior
            rates = best_rates(self.null, pieces, prior, np.argsort(-first, kind="stable")[:6])
        return self.null.evidence(pieces, rates), rates

    def ridges(self, Ts: np.ndarray, found: PoseEvidence, status: np.ndarray) -> Ridges:
        """Places among poses; solves that saw nothing are none."""
        bad = np.isin(status, (SolveStatus.NO_EVIDENCE, SolveStatus.NOT_FINITE))
        nats = np.where(bad[:, None], np.nan, found.block_nats)
        return ridges(Ts, nats, self.log_prior(Ts), self.config.posterior)

    def find(self) -> FoundModes:
        """All places, best first."""
        ramps, in_view_px = self.by_ramps()
        solved = self.candidates(np.concatenate([self.coarse(), ramps]), in_view_px)
        Ts = np.asarray(solved.estimates.T_map_base, dtype=np.float64)
        seen = self.observed(Ts)
        found, rates = self._evidence_of(Ts, self.null.pieces(seen, self.image_size, self.observe_config.cell_px), None)
        first = self.ridges(Ts, found, np.asarray(solved.estimates.status))
        leaders = Ts[first.best[:2]] if len(first.best) else self.T_prior[None]
        # A solve from beside a place that was found ends there.
        shifted = not_near(np.concatenate([self.aliases(T) for T in leaders]), Ts, ONE_TRACK)
        if len(shifted):
            more = self.candidates(shifted, in_view_px)
            also = self.observed(np.asarray(more.estimates.T_map_base, dtype=np.float64))
            solved, seen = (
                jax.tree.map(lambda *leaves: np.concatenate(leaves), *pair) for pair in ((solved, more), (seen, also))
            )
            Ts = np.asarray(solved.estimates.T_map_base, dtype=np.float64)
        pieces = self.null.pieces(seen, self.image_size, self.observe_config.cell_px)
        found, rates = self._evidence_of(Ts, pieces, None)
        places = self.ridges(Ts, found, np.asarray(solved.estimates.status))
        return self.finished(solved, places, rates, in_view_px)

    def _alias_reach_m(self) -> float:
        """How far along the road the map is compared with itself: no farther than the prior can be wrong [m]."""
        aliases = self.config.aliases
        reach_m = np.clip(ALIAS_SIGMAS * self.sigma[0], min(aliases.least_reach_m, aliases.along_m), aliases.along_m)
        return float(np.ceil(reach_m))

    def aliases(self, T_map_base: np.ndarray) -> np.ndarray:
        """Poses at which the map looks as it does from this one."""
        samples = jax.tree.map(np.asarray, self.samples)
        rows = samples.valid & (self.channel >= 0)
        rows &= np.hypot(*(samples.p_map[:, :2] - T_map_base[:2, 3]).T) < self.observe_config.max_range_m
        shifts = alias_shifts(
            samples.p_map[rows, :2].astype(np.float64),
            samples.tangent_map[rows, :2].astype(np.float64),
            self.channel[rows],
            samples.length_m[rows].astype(np.float64),
            T_map_base,
            replace(self.config.aliases, along_m=self._alias_reach_m()),
        )
        moved = T_map_base @ planar(shifts[:, 0], shifts[:, 1], 0.0)
        return self.road.place(moved)

    def finished(
        self,
        solved: SolvedPoses,
        places: Ridges,
        rates: Rates,
        in_view_px: float,
    ) -> FoundModes:
        """The best places solved to the end, weighed and brought into the map frame."""
        config = self.config
        Ts = np.asarray(solved.estimates.T_map_base, dtype=np.float64)
        if not len(places.best):
            return FoundModes((), SolveStatus.NO_EVIDENCE, 0)
        best = Ts[places.best[0]]
        own = np.flatnonzero((places.home == 0) & (places.log_weight > -config.within_nats))
        own = own[apart(Ts[own], places.log_weight[own], config.num_final, 0.3)]
        covariance = np.asarray(solved.estimates.covariance[places.best[0]], dtype=np.float64)
        restarts = best @ along_weak(covariance, config.lever_m, config.restarts, config.restart_step_m)
        centre = jnp.asarray(self.road.place(best[None])[0], jnp.float32)
        centre = Prior(centre, jnp.asarray(self.wide_sigma, jnp.float32))
        _, grain = sharpest(jnp.asarray(best, jnp.float32), self.frame, centre, self.frame_config)
        frame = self.frame._replace(grain=grain)
        road_through = partial(self._road_through, frame=frame, prior=centre)
        road = road_through(best)
        beside = np.asarray(road.Ts_map_base, dtype=np.float64)[np.isfinite(road.scores)]
        others = Ts[places.best[1 : config.num_final + 1]]
        starts = np.concatenate([Ts[own], beside, restarts, others])
        whole = np.ones((1, len(frame.samples.label)), bool)
        solved = solve_all(
            starts, self.road, self.wide_sigma, frame, in_view_px, self.frame_config, self.final_align, whole
        )
        Ts_end = np.asarray(solved.estimates.T_map_base, dtype=np.float64)
        pieces = self.pieces(Ts_end)
        found, rates = self._evidence_of(Ts_end, pieces, rates)
        last = self.ridges(Ts_end, found, np.asarray(solved.estimates.status))
        if not len(last.best):
            return FoundModes((), SolveStatus.NO_EVIDENCE, 0)
        found = self._in_map(solved, Ts_end, (pieces, found), last, rates, road_through, in_view_px)
        return self._with_doubt(found, frame, in_view_px)

    def _with_doubt(self, found: FoundModes, frame: FrameInput, in_view_px: float) -> FoundModes:
        """The places with what the best one says of the lenses."""
        if not found.modes:
            return found
        best, whole = found.modes[0], np.ones((1, len(frame.samples.label)), bool)
        start = self.local.from_map(best.T_map_base, np.float64)[None]

        def cost_through(rig: Rig) -> float:
            known = self.road, self.wide_sigma, frame._replace(rig=rig), in_view_px, self.frame_config
            return float(solve_all(start, *known, self.final_align, whole).score[0])

        evidence = replace(best.evidence, **asdict(doubted(frame.rig, cost_through)))
        return replace(found, modes=(replace(best, evidence=evidence), *found.modes[1:]))

    def _road_through(self, T_map_base: np.ndarray, frame: FrameInput, prior: Prior) -> RoadPosterior:
        """Places along the road through a pose."""
        T = jnp.asarray(T_map_base, jnp.float32)
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
        self, of_noise: np.ndarray, T_map_base: np.ndarray, along: np.ndarray, moments: np.ndarray, in_view_px: float
    ) -> tuple[np.ndarray, dict[str, float]]:
        """Covariance of the best pose, and whether kinds of elements agree about it.

        As long along the road as its valley; forward, to the left and in heading no smaller than the poses of its place
        and the halves of the map scatter.

        Args:
            of_noise: float[6 6], as the noise model has it.
            T_map_base: The pose.
            along: Of `_spread_along`.
            moments: float[3], of the poses of its place.
            in_view_px: Length of contour in view.
        """
        plane = np.array(PLANE)
        told, promised = (_widened((c * of_noise).astype(np.float32), along) for c in (POSE_SHARE, 1.0))
        # Halves are solved with few samples: they are held against what the noise model promises for them.
        known = np.maximum(moments, np.asarray(promised).diagonal()[plane])
        of_halves, contradiction = self.disagreement(T_map_base, in_view_px, known)
        covariance = np.array(told, dtype=np.float64)
        covariance[plane, plane] = np.maximum.reduce([moments, covariance.diagonal()[plane], of_halves])
        return covariance, contradiction

    def disagreement(
        self, T_map_base: np.ndarray, in_view_px: float, variance: np.ndarray
    ) -> tuple[np.ndarray, dict[str, float]]:
        """Variance of the best pose by those of halves of the map, and whether kinds of elements agree about it."""
        # All of it once more as well, with as few samples: like is compared with like.
        part = np.arange(len(self.parts))
        solved = self.solved_with_few(np.repeat(T_map_base[None], len(part), axis=0), in_view_px, part)
        Ts = np.asarray(solved.estimates.T_map_base, dtype=np.float64)
        first = len(part) - NUM_KINDS
        covariance = np.asarray(solved.estimates.covariance, dtype=np.float64)[first:][:, PLANE][:, :, PLANE]
        return disagreement(Ts[0], Ts[1:first], variance), asdict(kinds_apart(Ts[first:], covariance))

    def _spread_along(self, T_map_base: np.ndarray, road: RoadPosterior, rates: Rates) -> np.ndarray:
        """Second moment of the posterior over places along the road about a pose, in its right tangent, float32[6 6].

        Solves end at local minima, dashes or not: where the sides of lines are all there is, the masks are flat between
        them, and only the prior would say where the vehicle is. Evidence and ramp cost know the same masks by other
        means and count half each; where variances are `POSE_SHARE` of what the noise model has, nats are worth more.
        """
        places = np.asarray(road.places, dtype=np.float64)
        found, _ = self.evidence(np.concatenate([places, T_map_base[None]]), rates)
        tempered = temper(found.block_nats, len(places), self.config.posterior)
        nats = found.block_nats.sum(axis=1)
        evidence = (tempered * (nats - nats[-1]))[:-1]
        log_masks = 0.5 * (evidence + np.asarray(road.log_masks, np.float64)) / POSE_SHARE
        log_weight = log_masks + np.asarray(road.log_prior, np.float64)
        log_weight = np.where(np.isfinite(log_weight), log_weight, -1e9)
        share = np.exp(log_weight - log_weight.max())
        away = rigid.log(np.linalg.inv(T_map_base) @ places)
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
