"""A frame held against a compact map: explicit shapes associated with landmarks (room: localization; host).

In: FrameFeatures with primitives, prediction with covariance. Out: Alignment, as `FrameAligner` has it.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.alignment.explicit.frame import ExplicitConfig, ExplicitFrame, SeenShapes, explicit_frame
from semloc_jax.alignment.explicit.landmarks import Landmark, compact_landmarks
from semloc_jax.cameras import Rig
from semloc_jax.fusion.measurements import PoseMeasurement
from semloc_jax.geometry import rigid
from semloc_jax.localization.frame_alignment import Alignment, FrameAligner, masks_covariance
from semloc_jax.localization.map_window import MapWindow
from semloc_jax.localization.track_state import FrameFeatures

EXPLICIT = ExplicitConfig()
"""No drive needed other values."""
Trust = Callable[[np.ndarray], np.ndarray]


class ExplicitAligner(FrameAligner):
    """Aligns frames with the landmarks of one map; costs beside a pose are still those of the contours."""

    def align(
        self,
        frame: FrameFeatures,
        T_map_predicted: Float[np.ndarray, "4 4"],
        covariance: Float[np.ndarray, "6 6"],
        last_sigma_along_m: float,
        trust: Trust,
        stance: Float[np.ndarray, "3"],
        grain: Float[np.ndarray, ""],
    ) -> Alignment:
        """The pose of a frame near its prediction; see `FrameAligner.align`. Landmarks without trust do not move it."""
        T_road = self.on_road(T_map_predicted)
        T_start, window = self.standing(T_road, stance)
        local = window.local_map.frame
        spread = self.map.road_spread(T_road)
        sigma = self.prior_sigma(covariance, spread)
        landmarks = landmarks_of(window)
        rows = self.map.rows_of(window.element_ids[mark.element] for mark in landmarks)
        found = explicit_frame(
            frame.shapes,
            landmarks,
            trust(rows) > 0.0,
            local.from_map(T_start, np.float64),
            sigma,
            EXPLICIT,
        )
        T = rigid.normalised(local.to_map(found.pose.T_local_base))
        own = masks_covariance(found.pose.covariance, sigma, self.config.min_information)
        answer = _alignment(found, PoseMeasurement(frame.time_s, T, own), rows)
        return answer._replace(stance=rigid.log(rigid.inverse(T_road) @ T)[2:5], road_spread=spread)

    def align_again(
        self,
        rigs: tuple[Rig, ...],
        wider_m: Sequence[float],
        asked: Sequence[int],
        frame: FrameFeatures,
        T_map_base: Float[np.ndarray, "4 4"],
        covariance: Float[np.ndarray, "6 6"],
        trust: Trust,
        stance: Float[np.ndarray, "3"],
        grain: Float[np.ndarray, ""],
    ) -> tuple[Float[np.ndarray, " rig"], Float[np.ndarray, "rig 4 4"]]:
        """Scores and poses of a frame with other calibrations; see `FrameAligner.align_again`. Landmarks stay where the
        map has them: scores with another width of the road are NaN."""
        parts = T_map_base, covariance, 0.0, trust, stance, grain
        primitives = frame.shapes.primitives
        seen = [frame._replace(rig=rigs[k], shapes=SeenShapes.by(rigs[k], primitives)) for k in asked]
        found = [self.align(one, *parts) for one in seen]
        scores = np.array([np.nan if wider_m[k] else one.score for k, one in zip(asked, found, strict=True)])
        return scores, np.stack([one.measurement.T_map_base for one in found])


def landmarks_of(window: MapWindow) -> tuple[Landmark, ...]:
    """The landmarks of a window of the map."""
    return compact_landmarks(window.local_map)


def _alignment(found: ExplicitFrame, measurement: PoseMeasurement, rows: Int[np.ndarray, " landmark"]) -> Alignment:
    """What a frame says, in the words of the contours."""
    # The parts of a line that the window cuts belong to one element.
    elements, part_of = np.unique(rows, return_inverse=True)
    visible, missed = np.zeros(len(elements)), np.zeros(len(elements))
    np.add.at(visible, part_of, found.expected_px)
    np.add.at(missed, part_of, found.expected_px * found.missed)
    expected = max(float(visible.sum()), 1e-9)
    is_matched = np.zeros(len(elements), bool)
    is_matched[part_of[[match.landmark for match in found.matches]]] = True
    share = float(found.expected_px[found.missed < 1.0].sum()) / expected
    return Alignment(
        measurement=measurement,
        status=found.pose.status,
        cost=float(missed.sum()) / expected,
        coverage=1.0 if visible.any() else 0.0,
        inlier_ratio=share,
        score=found.nats,
        in_view_px=float(visible.sum()),
        moved_m=0.0,
        information_eigenvalues=np.linalg.eigvalsh(np.linalg.inv(measurement.covariance)),
        visible_px=visible,
        missed_px=missed,
        rows=elements,
        matched=elements[is_matched],
    )
