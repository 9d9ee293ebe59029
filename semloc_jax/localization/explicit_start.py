"""Find the vehicle in a compact map: from one sign, then from all that fits (room: localization; host).

In: one frame and what is known of its place. Out: poses to follow side by side, as `Acquisition` has them.
"""

import numpy as np

from semloc_jax.alignment.explicit.frame import ExplicitFrame
from semloc_jax.alignment.explicit.start import explicit_starts
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.result import Mode
from semloc_jax.alignment.same_pose import ONE_TRACK, units_apart
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.localization.acquisition import Acquisition
from semloc_jax.localization.explicit_alignment import EXPLICIT, landmarks_of
from semloc_jax.localization.track_state import FrameFeatures


class ExplicitAcquisition(Acquisition):
    """Searches of one map by its landmarks."""

    def around(self, frame: FrameFeatures, prior: PosePrior) -> tuple[Mode, ...]:
        """Every answer of one frame around a prior of one heading, best first."""
        try:
            T_map_prior = prior.on_road(self.aligner.map)
        except SemlocError:
            return ()  # no road there: outside of the map
        window = self.aligner.windows.around(T_map_prior[:3, 3])
        local, landmarks = window.local_map.frame, landmarks_of(window)
        road = self.aligner.scene.road.on(self.aligner.map.road_spread(T_map_prior))
        sigma = np.array([prior.sigma_xy_m, prior.sigma_xy_m, *road, prior.sigma_heading_rad])
        T_prior = local.from_map(T_map_prior, np.float64)
        found = explicit_starts(frame.shapes, landmarks, T_prior, sigma, EXPLICIT)
        weights = np.exp(-np.array([answer.nats for answer in found]) + min((a.nats for a in found), default=0.0))
        modes: list[Mode] = []
        for answer, weight in zip(found, weights / max(weights.sum(), 1e-12), strict=True):
            mode = _mode(answer, local.to_map(answer.pose.T_local_base), float(weight))
            if not any(units_apart(mode.T_map_base, other.T_map_base) < ONE_TRACK for other in modes):
                modes.append(mode)
        return self.worth_following(modes)


def _mode(answer: ExplicitFrame, T_map_base: np.ndarray, weight: float) -> Mode:
    expected_px = max(float(answer.expected_px.sum()), 1e-9)
    return Mode(
        weight=weight,
        T_map_base=rigid.normalised(T_map_base),
        covariance=answer.pose.covariance,
        score=answer.nats,
        cost=float((answer.expected_px * answer.missed).sum()) / expected_px,
        coverage=1.0,
        inlier_ratio=float(answer.expected_px[answer.missed < 1.0].sum()) / expected_px,
        weak_direction=np.zeros(6),
    )
