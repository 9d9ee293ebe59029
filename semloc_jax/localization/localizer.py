"""Follow a vehicle through a drive: predict, align, judge, fuse; know when lost, find it again (room: localization;
host).

In: TrackerState, FrameFeatures. Out: the next TrackerState and a TrackResult. `Localizer.step` is pure: what it knows
is in the state, the map and the motion log.
"""

import zlib
from collections.abc import Sequence
from functools import partial

import numpy as np

from semloc_jax.alignment.explicit.frame import SeenShapes
from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.alignment.mask_image import mask_image
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.same_pose import ONE_TRACK, units_apart
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Frame
from semloc_jax.fusion import clock, noise_scale
from semloc_jax.fusion.clock import CameraTimeLog, unknown_offset
from semloc_jax.fusion.measurements import FusedPose, Fusion, GnssMeasurement, PoseMeasurement
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.fusion.window import SlidingWindow
from semloc_jax.localization import elsewhere, health, innovations, map_faults, passed_over, phase, rivals, watch
from semloc_jax.localization.acquisition import Acquisition, Area
from semloc_jax.localization.beginning import acquired, new_track
from semloc_jax.localization.explicit_alignment import ExplicitAligner, Trust
from semloc_jax.localization.explicit_start import ExplicitAcquisition
from semloc_jax.localization.following import FrameReport, corrected, grain_after, seen, stance_after, weighed
from semloc_jax.localization.frame_alignment import FrameAligner
from semloc_jax.localization.frame_in_map import FrameInMap
from semloc_jax.localization.initialization import newest, no_fixes
from semloc_jax.localization.judging import judged
from semloc_jax.localization.learning import with_learned
from semloc_jax.localization.map_window import GRID_M, MapWindows
from semloc_jax.localization.moved_elements import moved_elements
from semloc_jax.localization.predicting import predicted, way_since
from semloc_jax.localization.stage_timer import StageTimer
from semloc_jax.localization.track_config import TrackConfig
from semloc_jax.localization.track_state import (
    FrameFeatures,
    Track,
    TrackerState,
    TrackResult,
    TrackStatus,
)
from semloc_jax.maps import SemanticMap, SharedSigmas, with_map_accuracy
from semloc_jax.perception import ClassTable
from semloc_jax.perception.primitives import primitives_of
from semloc_jax.residuals.pose_terms import Terms

_SEARCH_REACH_M = 3.0
"""What a search needs of the map beyond its prior: a tracked vehicle is known better; less map is less work."""


class Localizer:
    """Follows a vehicle in one map with one class table."""

    def __init__(
        self,
        semantic_map: SemanticMap,
        table: ClassTable,
        motion: MotionLog,
        fusion: Fusion | None = None,
        config: TrackConfig | None = None,
        area: Area | None = None,
    ):
        """Prepare a map.

        Args:
            semantic_map: The map.
            table: What the ids of the masks mean.
            motion: Wheel and inertial samples; it may grow during the drive.
            fusion: How measurements become a pose over time; None for the sliding window.
            config: None for the defaults.
            area: Where the vehicle is, for drives without satellite fixes; searched exhaustively.

        Raises:
            SemlocError: no class of the map is visible in masks of this table.
        """
        self.map, self.motion, self.fusion = semantic_map, motion, fusion or SlidingWindow()
        self.config, self.area = config or TrackConfig(), area
        channels = FrameLocalizer(semantic_map, table, LocalizeConfig())
        self.table, self.channel_of_label = channels.shown, channels.channel_of_label
        scene = self.config.scene
        radius_m = scene.search_radius_m - _SEARCH_REACH_M
        self.windows = MapWindows(semantic_map, radius_m, scene.sample_spacing_m, scene.sample_capacity)
        self.is_explicit = self.config.association == "explicit"
        kind = ExplicitAligner if self.is_explicit else FrameAligner
        self.aligner = kind(semantic_map, self.windows, self.channel_of_label, scene, self.config.alignment)
        self._map_sigmas = SharedSigmas(semantic_map.walk(), scene.map_sigma, on_earth=scene.place_in == "earth")
        searching = ExplicitAcquisition if self.is_explicit else Acquisition
        self.acquisition = searching(self.aligner, motion, self.config.acquisition)

    def start(self) -> TrackerState:
        """The state of a vehicle that may be anywhere."""
        return TrackerState(
            time_s=np.float64(-np.inf),
            status=np.int64(TrackStatus.INITIALIZING),
            tracks=(),
            coasting=(),
            searched_s=np.float64(-np.inf),
            fixes=no_fixes(),
            trust=map_faults.full_trust(self.map.num_elements),
            counters=health.no_counts(),
            stance=np.zeros(3),
            digest=np.uint32(0),
            driven_m=np.float64(0.0),
            noise=noise_scale.unknown_noise(),
            clock=unknown_offset(clock.BELIEFS),
        )

    def template(self) -> TrackerState:
        """A state with one track and one that coasts: the shapes of everything a checkpoint holds."""
        track = new_track(self.fusion, PoseMeasurement(0.0, np.eye(4), np.eye(6)), 0.0)
        return self.start()._replace(tracks=(track,), coasting=(track.fusion,))

    def features(
        self,
        frame: Frame,
        masks: Sequence[np.ndarray],
        rig: Rig,
        fixes: Sequence[GnssMeasurement] = (),
        guess: PosePrior | None = None,
        terms: Terms = (),
    ) -> FrameFeatures:
        """What a frame shows, without the map: the stage that can run ahead of the localization.

        Args:
            frame: The frame (time, id).
            masks: Class ids of every camera.
            rig: Cameras of the masks.
            fixes: Satellite fixes since the frame before.
            guess: First guess of the pose, where something else knows it.
            terms: Other measurements of the pose at the time of the frame, see `pose_term`; the fusion must be made for
                their kinds: `SlidingWindow(terms=...)`.
        """
        image = mask_image(masks, self.table, self.config.scene.cost_maps)
        shows_something = any(mask.size and mask.min() != mask.max() for mask in masks)
        usable = float(np.mean(np.asarray(image.usable.mask))) if shows_something else 0.0
        digest = 0
        for mask in masks:
            digest = zlib.crc32(np.ascontiguousarray(mask), digest)
        return FrameFeatures(
            frame_id=frame.id,
            time_s=frame.time_s,
            rig=rig,
            image=image,
            fixes=tuple(fixes),
            usable_share=usable,
            digest=digest,
            guess=guess,
            terms=tuple(terms),
            shapes=SeenShapes.by(rig, [primitives_of(mask, self.table) for mask in masks])
            if self.is_explicit
            else None,
        )

    def step(self, state: TrackerState, frame: FrameFeatures) -> tuple[TrackerState, TrackResult]:
        """The state and the verdict after one more frame.

        A frame that does not come after the one before costs itself only: the state stays, and the result has no pose
        but the reason. Fixes without a finite place or a positive standard deviation are left out.
        """
        unusable = passed_over.because(state, frame)
        if unusable is not None:
            return state, passed_over.result(state, frame, unusable)
        frame = frame._replace(fixes=tuple(fix for fix in frame.fixes if fix.is_usable))
        timer, before_s = StageTimer(), float(state.time_s)
        motion = CameraTimeLog(self.motion, state.clock)
        before = self.fusion.pose(state.tracks[0].fusion) if state.tracks else None
        is_same_image = np.isfinite(before_s) and frame.digest == int(state.digest)
        state = predicted(state, frame, self.fusion, motion, self.config.health)
        way_m = way_since(before_s, before, state, self.fusion, motion)
        state = state._replace(driven_m=np.float64(state.driven_m + way_m if is_same_image else 0.0))
        timer.lap("predict")
        trust = self.trust_in(state)
        if state.driven_m > self.config.health.frozen_m:
            views = [
                FrameReport(None, True, False, ("the image has not changed while the vehicle moved",))
                for _ in state.tracks
            ]
        else:
            in_map = FrameInMap(frame, self.aligner, trust, state, self.config.health)
            views = [seen(track, self.fusion, in_map) for track in state.tracks]
        timer.lap("align")
        state, view = self._fused(state, views, way_m)
        if view is not None and view.innovation is not None:
            fit = innovations.learned(state.innovations, view.innovation.chi2, view.difference, view.covariance)
            state = state._replace(innovations=fit)
        if view is not None and view.found is not None:
            state = state._replace(matched=view.found.matched)
        in_map = FrameInMap(frame, self.aligner, trust, state, self.config.health)
        if len(state.tracks) == 1 and view is not None and view.is_accepted:
            fused = self.fusion.pose(state.tracks[0].fusion)
            state = with_learned(state, view, fused, motion, before, way_m)
            sums = watch.looked(state.watch, view, fused, in_map, way_m, self.config.watch)
            state = state._replace(watch=sums)
        timer.lap("fuse")
        state = rivals.joined(state, view, in_map, self.fusion)
        state = elsewhere.with_nats_elsewhere(state, view, in_map, self.fusion)
        state = self._given_up(state)
        if not state.tracks and state.driven_m <= self.config.health.frozen_m:
            state = acquired(state, frame, self.acquisition, self.area, self.fusion, self.config)
            timer.lap("acquire")
        return self._judged(state, view, frame, way_m, timer)

    def trust_in(self, state: TrackerState) -> Trust:
        """Weights of elements of the map; explicit ones count from the second frame on in which they are matched."""
        weights = partial(map_faults.weights, state.trust, self.config.trust)
        if not len(state.matched):
            return weights
        return lambda rows: weights(rows) * np.isin(rows, state.matched)

    def _fused(
        self, state: TrackerState, views: list[FrameReport], way_m: float
    ) -> tuple[TrackerState, FrameReport | None]:
        """Every track corrected and weighed, best first; and the result of the frame for the best one."""
        if not views:
            return state, None
        pairs = [
            corrected(t, v, self.fusion, way_m, state.noise, self.config.follow)
            for t, v in zip(state.tracks, views, strict=True)
        ]
        tracks = weighed([t for t, _ in pairs], [v for _, v in pairs], self.config.follow)
        poses = [self.fusion.pose(t.fusion) for t in tracks]
        against = phase.nats_of_tracks(poses, [int(t.num_accepted) for t in tracks], state.fixes)
        total = [float(t.penalty) + nats for t, nats in zip(tracks, against, strict=True)]
        order = np.argsort(total, kind="stable")
        best, view = tracks[order[0]], pairs[order[0]][1]
        if order[0] != 0:
            state = state.at_another_place()
        kept = [best]
        for k in order[1:]:
            if total[k] - total[order[0]] < self.config.win_nats and not self._is_one_of(tracks[k], kept):
                kept.append(tracks[k])
        counters, trust = health.counted(state.counters, view.is_occluded, view.is_accepted), state.trust
        counters = counters._replace(off_map=counters.off_map + 1 if view.is_off_map else np.int64(0))
        if len(kept) == 1 and view.is_accepted:
            found = view.found
            trust = map_faults.updated(trust, found.visible_px, found.missed_px, self.config.trust, found.rows)
            road = self.config.scene.road
            # Where the map leaves the road open, a stance over it says little.
            covariance = found.measurement.covariance + np.diag([0.0, 0.0, *found.road_spread, 0.0]) ** 2
            stance = stance_after(state.stance, found.stance, covariance, road, self.config.follow)
            state = state._replace(stance=stance)
        if view.is_accepted:
            grain = grain_after(np.asarray(state.grain), view.found.grain, float(best.num_accepted), self.config.follow)
            state = state._replace(grain=grain)
        return state._replace(tracks=tuple(kept), counters=counters, trust=trust), view

    def _is_one_of(self, track: Track, kept: list[Track]) -> bool:
        """Whether a track is where another one is."""
        T = self.fusion.pose(track.fusion).T_map_base
        return any(units_apart(T, self.fusion.pose(k.fusion).T_map_base) < ONE_TRACK for k in kept)

    def _given_up(self, state: TrackerState) -> TrackerState:
        """The state without tracks where the vehicle is lost: the best confirmed one continues by dead reckoning."""
        if not state.tracks:
            return state
        best = state.tracks[0]
        is_confirmed = best.num_accepted >= self.config.confirm_frames
        if is_confirmed and len(state.tracks) == 1:
            if health.lost_because(state.counters, self.config.health):
                if state.counters.conflicts >= self.config.health.max_conflicts:
                    state = state._replace(fixes=newest(state.fixes, int(state.counters.conflicts)))
                return state._replace(tracks=(), coasting=(best.fusion,), status=np.int64(TrackStatus.LOST))
            return state._replace(coasting=())
        if best.num_refused >= self.config.drop_refused or state.counters.off_map > 0:
            return state._replace(tracks=())
        return state

    def _judged(
        self, state: TrackerState, view: FrameReport | None, frame: FrameFeatures, way_m: float, timer: StageTimer
    ) -> tuple[TrackerState, TrackResult]:
        """The status of the frame with its reasons."""
        fused = self._output(state)
        map_sigma = self._map_sigmas.at(np.zeros(2) if fused is None else fused.T_map_base[:2, 3])
        why = partial(self._why_no_start, state, frame.guess)
        verdict = judged(state, view, fused, frame.rig, way_m, map_sigma, self.config, why)
        state = state._replace(status=np.int64(verdict.status), doubted=verdict.doubted)
        if fused is not None:
            self.windows.prepare(fused.T_map_base[:3, 3] + GRID_M * fused.T_map_base[:3, 0])
            fused = fused._replace(covariance=with_map_accuracy(fused.covariance, *map_sigma))
            fused = fused.moved(*verdict.move).less_sure(*verdict.left_open)
        found = view.found if view is not None else None
        return state, TrackResult(
            frame_id=frame.frame_id,
            time_s=frame.time_s,
            status=verdict.status,
            reasons=verdict.reasons,
            fused=fused,
            protection=verdict.protection,
            measured=found.measurement if found else None,
            accepted=view.is_accepted if view is not None else False,
            chi2=view.innovation.chi2 if view is not None and view.innovation else np.nan,
            cost=found.cost if found else np.nan,
            coverage=found.coverage if found else np.nan,
            inlier_ratio=found.inlier_ratio if found else np.nan,
            num_tracks=len(state.tracks),
            clock_offset_s=float(state.clock.offset_s),
            times_ms=timer.times_ms,
            held=verdict.held,
            misleading=verdict.misleading,
            moved=moved_elements(state.watch, self.config.watch),
        )

    def _why_no_start(self, state: TrackerState, guess: PosePrior | None) -> str:
        """What keeps the vehicle from being found, and what would help."""
        is_by_fixes = guess is None and self.area is None
        why = self.acquisition.why_not(state.fixes, float(state.time_s)) if is_by_fixes else ""
        found_none = (
            "a search around where it should be found no pose that explains the masks; is the map, its place or "
        )
        return why or found_none + "the class table another? 'semloc check-calib' shows it"

    def _output(self, state: TrackerState) -> FusedPose | None:
        """The pose in the map that goes out; None where there is none."""
        known = (*(track.fusion for track in state.tracks[:1]), *state.coasting)
        return self.fusion.pose(known[0]) if known else None
