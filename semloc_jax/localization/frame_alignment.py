"""A frame held against the map from a predicted pose (room: localization; host).

In: FrameFeatures, prediction with covariance, trust in map elements. Out: Alignment: the pose the masks alone measure,
its covariance, its quality.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from semloc_jax.alignment.class_profiles import class_profiles
from semloc_jax.alignment.longitudinal import is_searched as is_searched_along
from semloc_jax.alignment.pose import Prior
from semloc_jax.alignment.scene import SceneConfig
from semloc_jax.alignment.single_frame import FrameInput
from semloc_jax.alignment.tracking_step import (
    ELEMENT_CAPACITY,
    TrackAlignConfig,
    TrackedFrame,
    align_predicted,
    align_with_rigs,
    profile_beside,
)
from semloc_jax.cameras import Rig
from semloc_jax.fusion.measurements import PoseMeasurement
from semloc_jax.geometry import rigid
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.localization.map_window import MapWindow, MapWindows
from semloc_jax.localization.track_state import FrameFeatures
from semloc_jax.maps import RoadSpread, SemanticMap
from semloc_jax.runtime.memory import once_for_each
from semloc_jax.structs import SolveStatus

_FREE = 1e3
"""Factor on a sigma of the prior that leaves a direction free."""


@dataclass(frozen=True)
class AlignmentConfig:
    """How a prediction becomes the prior of a solve, and its answer a measurement. All values are ours."""

    prior_inflation: float = 3.0
    """Factor on the sigma of the prediction in the prior of a solve: the fusion alone uses the prediction fully."""
    min_sigma_along_m: float = 0.25
    """The basin of a solve. Along the road, where few ends of dashes hold the pose, a tighter prediction would hold it
    instead, and its error would count as a measurement in every frame."""
    min_sigma_across_m: float = 0.08
    min_sigma_heading_deg: float = 0.3
    max_sigma_m: float = 2.0
    max_sigma_heading_deg: float = 5.0
    min_information: float = 1e-3
    """Least information of the masks in any direction, in units of the prior's."""


class Alignment(NamedTuple):
    """What the masks of one frame measure."""

    measurement: PoseMeasurement
    """Pose, with the covariance that the masks and the road alone give it."""
    status: SolveStatus
    cost: float
    coverage: float
    inlier_ratio: float
    score: float
    """Cost of evidence and prior [nats]."""
    in_view_px: float
    moved_m: float
    """Correction along the road before the solve [m]."""
    information_eigenvalues: Float[np.ndarray, "6"]
    visible_px: Float[np.ndarray, " element"]
    """Contour seen of each element around the place [px]."""
    missed_px: Float[np.ndarray, " element"]
    grain: float = 1.0
    """Of the masks of this frame alone, see `NoiseModel.grain`."""
    stance: Float[np.ndarray, "3"] = np.zeros(3)
    """Height [m], roll and pitch [rad] of the vehicle over the road, as measured."""
    road_spread: RoadSpread = RoadSpread()
    """How far the road there may be from the plane that the stance is over."""
    rows: Int[np.ndarray, " element"] = np.arange(0)
    """Which elements of the map these are, ascending."""
    matched: Int[np.ndarray, " match"] = np.arange(0)
    """Elements that an explicit shape was associated with, ascending; none where contours are compared."""


class FrameAligner:
    """Aligns frames with one map."""

    def __init__(
        self,
        semantic_map: SemanticMap,
        windows: MapWindows,
        channel_of_label,
        scene: SceneConfig,
        config: AlignmentConfig,
    ):
        """Prepare a map, its windows and the channels of its labels."""
        self.map, self.windows, self.scene, self.config = semantic_map, windows, scene, config
        base = TrackAlignConfig()
        self.step = replace(base, view=scene.view_of(base.view), align=scene.align_of(base.align))
        self.channel_of_label = jnp.asarray(channel_of_label)
        # Kept here, not for the process: arrays of the device go with the tracker.
        self._on_device, self._side_by_side = once_for_each(_on_device), once_for_each(_side_by_side)
        # A frame is solved several times from one place.
        self._road_at = lru_cache(maxsize=8)(self._road_at)

    def frame_input(self, frame: FrameFeatures, window: MapWindow) -> FrameInput:
        """The frame with the samples of a window."""
        return FrameInput(window.samples, self._on_device(frame.rig), self.channel_of_label, *frame.image)

    def align(
        self,
        frame: FrameFeatures,
        T_map_predicted: Float[np.ndarray, "4 4"],
        covariance: Float[np.ndarray, "6 6"],
        last_sigma_along_m: float,
        trust: Callable[[np.ndarray], np.ndarray],
        stance: Float[np.ndarray, "3"],
        grain: Float[np.ndarray, ""],
    ) -> Alignment:
        """The pose of a frame near its prediction.

        Args:
            frame: Cost maps and cameras.
            T_map_predicted: Predicted pose.
            covariance: Its covariance (right tangent).
            last_sigma_along_m: Sigma along the road that the masks of the last frame gave alone [m].
            trust: Weights of the elements of the map that rows name.
            stance: Height [m], roll and pitch [rad] of the vehicle over the road of the map.
            grain: Of the masks, see `NoiseModel.grain`.

        Raises:
            SemlocError: the map has no road near the prediction.
        """
        ready = self._prepared(frame, T_map_predicted, covariance, trust, stance, grain)
        sigma_along = np.sqrt(np.float32(covariance[0, 0]))
        is_searched = np.asarray(is_searched_along(float(sigma_along), last_sigma_along_m, self.step.search))
        found: TrackedFrame = jax.device_get(align_predicted(*ready.solved, sigma_along, is_searched, self.step))
        answer = self._answer(found, frame.time_s, ready)
        stance = rigid.log(rigid.inverse(ready.T_road) @ answer.measurement.T_map_base)[2:5]
        return answer._replace(stance=stance, road_spread=ready.spread)

    def align_again(
        self,
        rigs: tuple[Rig, ...],
        wider_m: Sequence[float],
        asked: Sequence[int],
        frame: FrameFeatures,
        T_map_base: Float[np.ndarray, "4 4"],
        covariance: Float[np.ndarray, "6 6"],
        trust: Callable[[np.ndarray], np.ndarray],
        stance: Float[np.ndarray, "3"],
        grain: Float[np.ndarray, ""],
    ) -> tuple[Float[np.ndarray, " rig"], Float[np.ndarray, "rig 4 4"]]:
        """Scores [nats] and poses of a frame solved near a pose with other calibrations; further arguments as `align`.

        Args:
            rigs: At most `MOST_RIGS` of the same camera models. What a program needs of them is made once for each
                tuple, by its identity.
            wider_m: By how much the road is taken to be wider with each of them than the map has it.
            asked: Which of them.

        Raises:
            SemlocError: the map has no road near the pose.
        """
        ready = self._prepared(frame, T_map_base, covariance, trust, stance, grain)
        first, widths = np.zeros(MOST_RIGS, np.int32), np.zeros(MOST_RIGS, np.float32)
        first[: len(asked)], widths[: len(wider_m)] = asked, wider_m
        sigma_along, num = np.sqrt(np.float32(covariance[0, 0])), np.int32(len(asked))
        known = sigma_along, self._side_by_side(rigs), widths, first, num, self.step
        found = jax.device_get(align_with_rigs(*ready.solved, *known))
        Ts = ready.local.to_map(found.Ts_local_base[list(asked)])
        return found.scores[list(asked)].astype(np.float64), np.stack([rigid.normalised(T) for T in Ts])

    def costs_beside(
        self,
        frame: FrameFeatures,
        T_map_base: Float[np.ndarray, "4 4"],
        moves: Float[np.ndarray, "n 3"],
        trust: Callable[[np.ndarray], np.ndarray],
        stance: Float[np.ndarray, "3"],
        grain: Float[np.ndarray, ""],
    ) -> Float[np.ndarray, " n"]:
        """Cost [nats] of the masks at a pose after each move (forward [m], left [m], turned [rad]), not refined; other
        arguments as `align`."""
        ready = self._prepared(frame, T_map_base, np.eye(6), trust, stance, grain)
        T, prior, *rest = ready.solved
        free = Prior(T, prior.sigma * np.array([_FREE, _FREE, 1.0, 1.0, 1.0, _FREE], np.float32))
        level = np.asarray(self.step.rank_level)
        return np.asarray(profile_beside(T, np.asarray(moves, np.float32), free, *rest, self.step, level))

    def costs_of_classes(
        self,
        frame: FrameFeatures,
        T_map_base: Float[np.ndarray, "4 4"],
        moves: Float[np.ndarray, "n 3"],
        stance: Float[np.ndarray, "3"],
        grain: Float[np.ndarray, ""],
        level: int,
    ) -> Float[np.ndarray, "4 n"]:
        """Costs [nats] of parts of the map, each alone, at a pose and beside it; see `class_profiles`."""
        ready = self._prepared(frame, T_map_base, np.eye(6), _full_trust, stance, grain)
        is_standing = ready.window.is_standing[:ELEMENT_CAPACITY]
        stands = np.zeros(ELEMENT_CAPACITY, np.float32)
        stands[: len(is_standing)] = is_standing
        T = np.asarray(ready.local.from_map(T_map_base, np.float64), np.float32)
        known = np.asarray(moves, np.float32), ready.inputs, stands
        return np.asarray(class_profiles(T, *known, self.step, level), np.float64)

    def _prepared(
        self,
        frame: FrameFeatures,
        T_map_predicted: Float[np.ndarray, "4 4"],
        covariance: Float[np.ndarray, "6 6"],
        trust: Callable[[np.ndarray], np.ndarray],
        stance: Float[np.ndarray, "3"],
        grain: Float[np.ndarray, ""],
    ) -> "_Prepared":
        """Everything that a program needs to know; arguments as `align`."""
        T_road, spread = self.road_under(T_map_predicted)
        T_start, window = self.standing(T_road, stance)
        index = window.rows[:ELEMENT_CAPACITY]
        local_trust = np.ones(ELEMENT_CAPACITY, np.float32)
        local_trust[: len(index)] = trust(index)
        inputs = self.frame_input(frame, window)._replace(grain=np.asarray(grain, np.float32))
        T_local_base = window.local_map.frame.from_map(T_start, np.float64).astype(np.float32)
        sigma = self.prior_sigma(covariance, spread)
        return _Prepared(T_road, spread, window, index, sigma, T_local_base, inputs, local_trust)

    def standing(self, T_road: np.ndarray, stance: np.ndarray) -> tuple[np.ndarray, MapWindow]:
        """The pose of a vehicle with this stance where it would stand on the road without, and the map there."""
        T = T_road @ rigid.exp(np.array([0.0, 0.0, *stance, 0.0]))
        return T, self.windows.around(T[:3, 3])

    def on_road(self, T_map_base: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """The pose of a vehicle that stands on the road of the map at the same place with the same heading."""
        return self.road_under(T_map_base)[0]

    def road_under(self, T_map_base: Float[np.ndarray, "4 4"]) -> tuple[Float[np.ndarray, "4 4"], RoadSpread]:
        """`on_road`, and how far the road there is from a plane."""
        heading = float(np.arctan2(T_map_base[1, 0], T_map_base[0, 0]))
        return self._road_at(*T_map_base[:3, 3].tolist(), heading)

    def _road_at(self, x: float, y: float, z: float, heading: float) -> tuple[Float[np.ndarray, "4 4"], RoadSpread]:
        return self.map.road_under(x, y, heading, near_z_m=z)

    def prior_sigma(self, covariance: Float[np.ndarray, "6 6"], spread: RoadSpread) -> Float[np.ndarray, "6"]:
        """Standard deviations (x, y, z [m], roll, pitch, yaw [rad]) that hold a solve on a road of this spread."""
        config = self.config
        predicted = config.prior_inflation * np.sqrt(np.diagonal(covariance))
        along = np.clip(predicted[0], config.min_sigma_along_m, config.max_sigma_m)
        across = np.clip(predicted[1], config.min_sigma_across_m, config.max_sigma_m)
        yaw = np.clip(predicted[5], *np.deg2rad([config.min_sigma_heading_deg, config.max_sigma_heading_deg]))
        return np.array([along, across, *self.scene.road.on(spread), yaw])

    def _answer(self, found: TrackedFrame, time_s: float, ready: "_Prepared") -> Alignment:
        estimate = found.estimate
        T = ready.local.to_map(estimate.T_local_base)
        # The parts of a line that the window cuts belong to one element.
        rows, part_of = np.unique(ready.index, return_inverse=True)
        num = len(ready.index)
        visible, missed = (
            np.bincount(part_of, of_part[:num].astype(np.float64), len(rows))
            for of_part in (found.elements.visible_px, found.elements.missed_px)
        )
        covariance = masks_covariance(estimate.covariance.astype(np.float64), ready.sigma, self.config.min_information)
        covariance = covariance + found.spread.astype(np.float64)
        # No surer along the road than the valley that the pose lies in is long.
        valley = found.valley.astype(np.float64)
        covariance += max(1.0 - covariance[0, 0] / max(valley[0, 0], 1e-12), 0.0) * valley
        return Alignment(
            measurement=PoseMeasurement(time_s, rigid.normalised(T), covariance),
            status=SolveStatus(int(estimate.status)),
            cost=float(estimate.cost),
            coverage=float(estimate.coverage),
            inlier_ratio=float(estimate.inlier_ratio),
            score=float(found.score),
            in_view_px=float(found.in_view_px),
            moved_m=float(found.moved_m),
            information_eigenvalues=estimate.information_eigenvalues.astype(np.float64),
            visible_px=visible,
            missed_px=missed,
            rows=rows,
            grain=float(self.step.align.noise.grain(float(found.typical_px))),
        )


class _Prepared(NamedTuple):
    """A frame at a place of the map, ready for a program."""

    T_road: Float[np.ndarray, "4 4"]
    """The pose on the road of the map there."""
    spread: RoadSpread
    """How far that road may be from a plane."""
    window: MapWindow
    index: Int[np.ndarray, " part"]
    """Which element of the map each element of the window is a part of."""
    sigma: Float[np.ndarray, "6"]
    """Of the prior [m, rad]."""
    T_local_base: Float[np.ndarray, "4 4"]
    """Start, and centre of the prior, relative to the local origin."""
    inputs: FrameInput
    trust: Float[np.ndarray, " element"]

    @property
    def local(self) -> LocalFrame:
        """Frame of the solver."""
        return self.window.local_map.frame

    @property
    def solved(self) -> tuple[np.ndarray, Prior, FrameInput, np.ndarray]:
        """What every solve takes: start, prior, frame, trust."""
        prior = Prior(self.T_local_base, self.sigma.astype(np.float32))
        return self.T_local_base, prior, self.inputs, self.trust


MOST_RIGS = 5
"""Calibrations that one call solves a frame with at most."""


def _side_by_side(rigs: tuple[Rig, ...]) -> Rig:
    """Calibrations of the same camera models as one, with a leading axis on every leaf; filled with the first."""
    filled = [*rigs, *[rigs[0]] * (MOST_RIGS - len(rigs))]
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack([np.asarray(leaf) for leaf in leaves])), *filled)


def _on_device(rig: Rig) -> Rig:
    """The rig as arrays of the device: its many numbers are brought there once, not for every program."""
    return jax.tree.map(jnp.asarray, rig)


def _full_trust(rows: np.ndarray) -> np.ndarray:
    return np.ones(len(rows))


_OF_ROAD = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 0.0])
"""Directions in which the prior is the road of the map, not the prediction."""


def masks_covariance(
    covariance: Float[np.ndarray, "6 6"], sigma: Float[np.ndarray, "6"], min_information: float
) -> Float[np.ndarray, "6 6"]:
    """Covariance that masks and road give a pose whose estimate also used a prediction.

    The information of the prediction is taken off again; a direction that only the prediction held is left with
    `min_information` of it, so that the fusion hardly listens there.

    Args:
        covariance: Of the estimate (right tangent).
        sigma: Standard deviations of the prior of the solve.
        min_information: Least information of any direction, in units of the prior's.
    """
    scaled = np.linalg.inv(covariance / np.outer(sigma, sigma)) - np.diag(1.0 - _OF_ROAD)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    inverse = (vectors / np.maximum(values, min_information)) @ vectors.T
    return inverse * np.outer(sigma, sigma)
