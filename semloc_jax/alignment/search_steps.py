"""One frame with what a search of its places needs: nulls, candidates, solves, evidence (room: alignment; host).

In: one frame, its prior, distances to mask borders. Out: SearchSteps, which `complete_modes` puts together.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np

from semloc_jax.alignment.agreement import halves, kinds
from semloc_jax.alignment.aliases import alias_shifts
from semloc_jax.alignment.border_cells import BorderCells
from semloc_jax.alignment.candidates import (
    BATCH,
    SolvedPoses,
    apart,
    coarse_gain,
    coarse_samples,
    coarse_search,
    lattice_in_window,
    null_poses,
    planar,
    solve_all,
    spread_out,
    thinned,
    wide_sigma,
)
from semloc_jax.alignment.evidence_null import EvidenceNull, best_rates
from semloc_jax.alignment.fault_modes import FaultConfig
from semloc_jax.alignment.hypotheses import search_from
from semloc_jax.alignment.map_pieces import Pieces, PoseEvidence, Rates
from semloc_jax.alignment.mode_search import ALIAS_SIGMAS, CompleteModesConfig, FrameImage, half_window_m
from semloc_jax.alignment.observed import Borders, ObserveConfig
from semloc_jax.alignment.pose import Prior, total_weight
from semloc_jax.alignment.posterior import Ridges, log_prior, ridges, same_ridge
from semloc_jax.alignment.road_patch import RoadPatch
from semloc_jax.alignment.same_pose import ONE_OPTIMUM
from semloc_jax.alignment.seen_samples import COARSE_BATCH, SeenSamples, seen_from
from semloc_jax.alignment.single_frame import FrameInput, SingleFrameConfig, evidence_from, search_starts
from semloc_jax.cameras import Rig
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import MapSamples, SolveStatus

_total_weight = stored_program()(total_weight)


class SearchSteps:
    """What is known of one frame, and the steps of a search in it."""

    def __init__(
        self,
        frame: FrameInput,
        image: FrameImage,
        prior: Prior,
        road: RoadPatch,
        local: LocalFrame,
        config: CompleteModesConfig,
        frame_config: SingleFrameConfig,
        faults: FaultConfig,
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
            faults: How often calibration and map are wrong.
        """
        self.frame, self.borders, self.image_size, self.unit_px = frame, image.borders, image.size, image.unit_px
        self.prior, self.road, self.local, self.config, self.frame_config = prior, road, local, config, frame_config
        self.faults = faults
        align = frame_config.polish_align
        self.align = replace(align, levels=config.levels, max_steps=config.max_steps)
        self.final_align = replace(align, max_steps=config.final_max_steps, tolerance=config.final_tolerance)
        self.T_prior = np.asarray(prior.T_local_base, dtype=np.float64)
        self.sigma = np.asarray(prior.sigma, dtype=np.float64)
        # The prior of a solve must not pull.
        self.wide_sigma = wide_sigma(self.sigma, config.least_sigma_m, np.deg2rad(config.least_sigma_deg))
        self.channel_of_label = np.asarray(frame.channel_of_label)
        self.samples = thinned(frame.samples, self.channel_of_label, config.num_samples)
        self.host_samples = jax.tree.map(np.asarray, self.samples)
        self.channel = self.channel_of_label[self.host_samples.label]
        label = np.where(self.channel >= 0, self.host_samples.label, -1)
        self.parts = np.concatenate([halves(self.host_samples.element, config.agreement), kinds(label)])
        view = frame_config.search_view
        limits = view.max_range_m, frame.rig.finer * view.min_ground_px_per_m, 48.0 * self.unit_px
        self.observe_config = ObserveConfig(*limits, path=view.path)
        self.fields = Borders(
            self.borders.signed_px,
            np.float32(self.borders.stride),
            np.asarray(frame.usable.mask),
            np.float32(frame.usable.stride),
        )
        self.half_xy_m = half_window_m(float(self.sigma[0]), config)
        least_rad = np.deg2rad(frame_config.min_reach_deg)
        self.half_heading_rad = max(config.window_heading_sigmas * float(self.sigma[5]), least_rad)
        corners = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (0.5, 0), (-0.5, 0), (0, 0)]) * self.half_xy_m
        spanning = self.T_prior @ planar(corners[:, 0], corners[:, 1], 0.0)
        wrong = null_poses(BATCH - len(corners), self.T_prior, frame_config.seed)
        self.spanning = self.observed(self.road.place(spanning))
        self.null = self._by_chance(wrong)

    def _by_chance(self, Ts_wrong: np.ndarray) -> EvidenceNull:
        """What poses that are wrong explain of the masks, by every n-th sample."""
        few = jax.tree.map(lambda leaf: leaf[:: self.config.null_every], self.host_samples)
        usable = self.frame.usable
        cells = BorderCells.of(
            self.borders,
            np.unique(self.channel[self.channel >= 0]),
            np.asarray(usable.mask),
            float(usable.stride),
            self.observe_config.cell_px,
            self.image_size,
        )
        return EvidenceNull(
            self.observed(self.road.place(Ts_wrong), few),
            self.channel,
            np.maximum(self.host_samples.element, 0),
            self.unit_px,
            self.config.null,
            self.config.null_every,
            cells,
        )

    def observed(self, Ts: np.ndarray, samples: MapSamples | None = None, rig: Rig | None = None) -> SeenSamples:
        """What each pose sees of all samples that evidence is counted of, or of others, or through other cameras."""
        samples, rig = self.host_samples if samples is None else samples, self.frame.rig if rig is None else rig
        return seen_from(Ts, samples, rig, self.channel_of_label, self.fields, self.observe_config)

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
        samples = coarse_samples(self.spanning, self.host_samples, self.channel, self.unit_px)
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
        evidence = evidence_from(self.prior.T_local_base, self.frame, self.frame_config.search_view)
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
        ends = np.asarray(found.estimates.T_local_base, dtype=np.float64)
        return found.rows(apart(ends, -found.score.astype(np.float64), len(ends), ONE_OPTIMUM))

    def solved_with_few(
        self,
        Ts: np.ndarray,
        in_view_px: float,
        part: np.ndarray | None = None,
        rigs: Sequence[Rig] = (),
        lens: np.ndarray | None = None,
    ) -> SolvedPoses:
        """Every start refined with few samples, each with its part of the map and through its cameras."""
        frame = self.frame._replace(samples=self.samples)
        view = replace(self.frame_config.polish_view, capacity=self.config.view_samples)
        config = replace(self.frame_config, polish_view=view)
        known = self.road, self.wide_sigma, frame, in_view_px, config, self.align
        return solve_all(Ts, *known, self.parts, part, rigs, lens)

    def pieces(self, Ts: np.ndarray, part: np.ndarray | None = None) -> Pieces:
        """The pieces of map, or of the samples bool[p] of a part of it, that each pose sees."""
        seen = self.observed(Ts)
        seen = seen if part is None else seen.only(part)
        return self.null.pieces(seen, self.image_size, self.observe_config.cell_px)

    def evidence(self, Ts: np.ndarray, rates: Rates | None = None) -> tuple[PoseEvidence, Rates]:
        """Evidence of poses, with rates of the frame as the best of them has it where none are given."""
        return self._evidence_of(Ts, self.pieces(Ts), rates)

    def _evidence_of(self, Ts: np.ndarray, pieces: Pieces, rates: Rates | None) -> tuple[PoseEvidence, Rates]:
        if rates is None:
            prior = self.log_prior(Ts)
            first = self.null.total_nats(pieces, self.null.start_rates()) + prior
            rates = best_rates(self.null, pieces, prior, np.argsort(-first, kind="stable")[:6])
        return self.null.evidence(pieces, rates), rates

    def ridges(self, Ts: np.ndarray, found: PoseEvidence, status: np.ndarray) -> Ridges:
        """Places among poses; solves that saw nothing are none."""
        bad = np.isin(status, (SolveStatus.NO_EVIDENCE, SolveStatus.NOT_FINITE))
        nats = np.where(bad[:, None], np.nan, found.block_nats)
        return ridges(Ts, nats, self.log_prior(Ts), self.config.posterior)

    def _alias_reach_m(self) -> float:
        """How far along the road the map is compared with itself: no farther than the prior can be wrong [m]."""
        aliases = self.config.aliases
        reach_m = np.clip(ALIAS_SIGMAS * self.sigma[0], min(aliases.least_reach_m, aliases.along_m), aliases.along_m)
        return float(np.ceil(reach_m))

    def aliases(self, T_local_base: np.ndarray) -> np.ndarray:
        """Poses at which the map looks as it does from this one."""
        samples = self.host_samples
        rows = samples.valid & (self.channel >= 0)
        rows &= np.hypot(*(samples.p_map[:, :2] - T_local_base[:2, 3]).T) < self.observe_config.max_range_m
        shifts = alias_shifts(
            samples.p_map[rows, :2].astype(np.float64),
            samples.tangent_map[rows, :2].astype(np.float64),
            self.channel[rows],
            samples.length_m[rows].astype(np.float64),
            T_local_base,
            replace(self.config.aliases, along_m=self._alias_reach_m()),
        )
        moved = T_local_base @ planar(shifts[:, 0], shifts[:, 1], 0.0)
        return self.road.place(moved)
