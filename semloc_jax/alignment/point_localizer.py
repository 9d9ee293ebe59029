"""The light semantic localizer of the literature: contours on the road laid on the map by ICP (room: alignment; host).

In: a SemanticMap, masks, cameras, a PosePrior. Out: LocalizationResult with one mode; nothing asks for a second place.
Masks are closed, contours of 50 px and more become features with a type and a confidence, features go to the top view,
and nearest points of one type are brought onto each other in the plane. A baseline beside `FrameLocalizer`.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.class_icp import ClassPoints, IcpConfig, IcpResult, align_points
from semloc_jax.alignment.pose_prior import PosePrior, RoadSigmas
from semloc_jax.alignment.result import LocalizationResult, Mode
from semloc_jax.cameras import Camera, Rig
from semloc_jax.datasets import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.maps import SemanticMap, sample
from semloc_jax.perception import ClassTable
from semloc_jax.perception.mask_features import FeatureConfig, mask_features
from semloc_jax.perception.road_projection import CalibratedRoad, RoadProjection
from semloc_jax.perception.surround import PAINT
from semloc_jax.structs import SolveStatus

_PLANE = np.ix_([0, 1, 5], [0, 1, 5])


@dataclass(frozen=True)
class PointLocalizerConfig:
    """How a frame is laid on the map. The values of `features` and the limits of the ICP are the literature's."""

    features: FeatureConfig = field(default_factory=FeatureConfig)
    icp: IcpConfig = field(default_factory=lambda: IcpConfig(gates_m=(3.0, 1.0, 0.3)))
    """From the reach of satellite fixes to that of AVP-SLAM."""
    road: RoadSigmas = field(default_factory=RoadSigmas)
    range_m: float = 20.0
    """Contours farther away on the road are too coarse; ours."""
    spacing_m: float = 0.1
    """Distance of the points of map and masks; ours."""
    min_inlier_ratio: float = 0.6
    max_rms_m: float = 0.15


class PointLocalizer:
    """Localizes single frames in one map with one class table by nearest points in the top view."""

    def __init__(
        self,
        semantic_map: SemanticMap,
        table: ClassTable,
        config: PointLocalizerConfig | None = None,
        roads: Mapping[str, RoadProjection] | None = None,
    ):
        """Prepare a map.

        Args:
            semantic_map: the map.
            table: of the masks.
            config: None for the defaults.
            roads: pixels to the road, by camera; None, or a camera that is not in it: by the calibration.

        Raises:
            SemlocError: no paint of the map is visible in masks of this table.
        """
        self.map, self.table = semantic_map, table
        self.config, self.roads = config or PointLocalizerConfig(), roads or {}
        self._calibrated: dict[str, CalibratedRoad] = {}
        if not any(table.channel_of(label) >= 0 and label in PAINT for label in semantic_map.labels):
            raise SemlocError(
                f"map {semantic_map.name}: has no paint that class table {table.name} shows; expected lane markings, "
                "stop lines, crosswalks, arrows or slot lines, all that a top view holds"
            )

    def localize(
        self, frame: Frame | None, masks: Sequence[np.ndarray], prior: PosePrior, rig: Rig | None = None
    ) -> LocalizationResult:
        """The pose of one frame; arguments as `FrameLocalizer.localize` has them."""
        started = time.perf_counter()
        T_map_prior = prior.on_road(self.map)
        seen = self.seen(masks, rig or frame.rig)
        around = self.around(T_map_prior)
        prepared = time.perf_counter()
        times = {"evidence": prepared - started}
        if not len(seen.xy) or not len(around.xy):
            reasons = (f"{len(seen.xy)} points of contours on the road and {len(around.xy)} of the map around it",)
            return LocalizationResult(
                frame, T_map_prior, T_map_prior, SolveStatus.NO_EVIDENCE, False, reasons, times=times
            )
        icp = align_points(seen, around, np.eye(4), self.config.icp)
        T = T_map_prior @ icp.T_target_source
        T = self.map.road_pose(
            float(T[0, 3]), float(T[1, 3]), float(np.arctan2(T[1, 0], T[0, 0])), float(T_map_prior[2, 3])
        )
        status, reasons = self._verdict(icp)
        mode = Mode(
            weight=1.0,
            T_map_base=T,
            covariance=self._covariance(icp, prior),
            score=0.0,
            cost=min(icp.rms_m / self.config.icp.gates_m[-1], 1.0),
            coverage=1.0,
            inlier_ratio=icp.inlier_ratio,
            weak_direction=np.zeros(6),
        )
        times["solve"] = time.perf_counter() - prepared
        return LocalizationResult(frame, T, T_map_prior, status, not reasons, reasons, (mode,), times)

    def seen(self, masks: Sequence[np.ndarray], rig: Rig) -> ClassPoints:
        """What the masks show on the road, in the base frame; the label is the channel, the weight the confidence."""
        parts = []
        for mask, camera, T_base_cam, name in zip(
            masks, rig.cameras, np.asarray(rig.T_base_cam), rig.names, strict=True
        ):
            road = self.roads.get(name) or self._by_calibration(name, camera, T_base_cam)
            for feature in mask_features(mask, self.table, self.config.features):
                xy, valid = road.on_road(feature.uv)
                xy = xy[valid & (np.linalg.norm(xy, axis=1) <= self.config.range_m)]
                points = ClassPoints.of(xy, np.full(len(xy), feature.channel))
                parts.append(points._replace(weight=np.full(len(xy), max(feature.confidence, 1e-3))))
        thin = ClassPoints.joined(parts).thinned(self.config.spacing_m)
        return thin._replace(weight=np.minimum(thin.weight, 1.0))

    def _by_calibration(self, name: str, camera: Camera, T_base_cam: np.ndarray) -> CalibratedRoad:
        """The road of a camera: made once, unless the camera moves in the rig."""
        known = self._calibrated.get(name)
        if known is None or not np.array_equal(known.T_base_cam, T_base_cam):
            known = self._calibrated[name] = CalibratedRoad(camera, T_base_cam)
        return known

    def around(self, T_map_near: Float[np.ndarray, "4 4"]) -> ClassPoints:
        """Contours of the paint of the map around a pose, in its base frame."""
        local_map = self.map.query(T_map_near[:3, 3], self.config.range_m + 2.0 * self.config.icp.gates_m[0])
        samples = sample(local_map, self.config.spacing_m)
        label = np.asarray(samples.label)
        is_paint = np.isin(label, [int(name) for name in PAINT]) & np.asarray(samples.valid)
        channel = self.table.channel_by_class[label]
        rows = np.flatnonzero(is_paint & (channel >= 0))
        T_base_local = rigid.inverse(local_map.frame.from_map(T_map_near, np.float64))
        p = np.asarray(samples.p_map, np.float64)[rows] @ T_base_local[:3, :3].T + T_base_local[:3, 3]
        return ClassPoints.of(p[:, :2], channel[rows])

    def _verdict(self, icp: IcpResult) -> tuple[SolveStatus, tuple[str, ...]]:
        """The simple verdict of the literature: partners for most points, near ones."""
        config, reasons = self.config, []
        if icp.inlier_ratio < config.min_inlier_ratio:
            reasons.append(f"{icp.inlier_ratio:.0%} of the points have a partner in the map")
        if icp.rms_m > config.max_rms_m:
            reasons.append(f"partners are {icp.rms_m:.2f} m apart")
        if reasons:
            return SolveStatus.POOR_FIT, tuple(reasons)
        if not icp.converged:
            return SolveStatus.MAX_STEPS, ("the ICP did not come to rest",)
        return SolveStatus.CONVERGED, ()

    def _covariance(self, icp: IcpResult, prior: PosePrior) -> np.ndarray:
        """Of the ICP in the plane, where it tells one, else of the prior; of the road for the rest."""
        road = self.config.road.on(self.map.road_spread(prior.on_road(self.map)))
        sigma = np.array([prior.sigma_xy_m, prior.sigma_xy_m, *road, prior.sigma_heading_rad])
        covariance = np.diag(sigma**2)
        if np.isfinite(icp.covariance).all():
            covariance[_PLANE] = icp.covariance
        return covariance
