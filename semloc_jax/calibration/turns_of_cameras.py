"""How a vehicle turns as its cameras see it, without any other sensor (room: calibration; host).

In: frames of a drive. Out: CameraTurns: mean angular rates between images, in the axes of the base.
Rotations come from the essential matrix of followed corners, so no gyroscope, speed or map takes part.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Frame
from semloc_jax.geometry import rigid
from semloc_jax.perception.sight_lines import SightLines
from semloc_jax.perception.tracks import CornerConfig, FeatureTracker, px_per_rad

_GATE_PX = 1.0
_LEAST_CORNERS = 25
_REFINED = 6
"""Steps of the last solve with all corners that agree."""
_LONGEST_S = 0.4
"""Corners are not followed over a longer time between images."""
_AHEAD = 0.3
"""Corners farther than 72 deg from the axis of a camera are left out: a plane of directions cannot hold them."""


class CameraTurns(NamedTuple):
    """Mean rates between two times each."""

    from_s: Float[np.ndarray, " n"]
    to_s: Float[np.ndarray, " n"]
    rate_base_radps: Float[np.ndarray, "n 3"]


def turns_of_cameras(frames: Sequence[Frame], camera: str) -> CameraTurns:
    """Rates of one camera over consecutive frames; pairs of frames that show no turn are left out."""
    tracker, rows = FeatureTracker(1, CornerConfig(gate_px=np.inf, by_first_look=False)), []
    before = None
    for frame in frames:
        rig = frame.rig.select([camera])
        tracks = tracker.step([cv2.cvtColor(frame.image(camera), cv2.COLOR_BGR2GRAY)], rig, np.eye(3))
        now = frame.time_s, dict(zip(tracks.id.tolist(), range(len(tracks.id)), strict=True)), tracks.sight
        if before is not None and 0.0 < now[0] - before[0] < _LONGEST_S:
            pairs = np.array([(before[1][i], s) for i, s in now[1].items() if i >= 0 and i in before[1]]).reshape(-1, 2)
            R_now_before = _rotation(before[2], now[2], pairs)
            if R_now_before is not None:
                rows.append(
                    (before[0], now[0], *_rate(R_now_before, np.asarray(rig.T_base_cam[0]), now[0] - before[0]))
                )
        before = now
    table = np.array(rows, float).reshape(-1, 5)
    return CameraTurns(table[:, 0], table[:, 1], table[:, 2:])


def _rotation(before: SightLines, now: SightLines, pairs: np.ndarray) -> Float[np.ndarray, "3 3"] | None:
    """R_now_before of a camera; None where too few corners agree."""
    if not len(pairs):
        return None
    rays = before.ray_cam[pairs[:, 0]], now.ray_cam[pairs[:, 1]]
    used = (rays[0][:, 2] > _AHEAD) & (rays[1][:, 2] > _AHEAD)
    if used.sum() < _LEAST_CORNERS:
        return None
    first, second = (r[used, :2] / r[used, 2:] for r in rays)
    gate = _GATE_PX / float(np.median(px_per_rad(now)[pairs[used, 1]]))
    E, inliers = cv2.findEssentialMat(first, second, np.eye(3), method=cv2.USAC_MAGSAC, prob=0.9999, threshold=gate)
    if E is None or E.shape != (3, 3):
        return None
    num, R, t, mask = cv2.recoverPose(E, first, second, np.eye(3), mask=inliers)
    if num < _LEAST_CORNERS:
        return None
    kept = mask[:, 0] > 0
    return _refined(R, t[:, 0], rays[0][used][kept], rays[1][used][kept], gate)


def _refined(
    R: np.ndarray, t: np.ndarray, before: np.ndarray, now: np.ndarray, gate_rad: float
) -> Float[np.ndarray, "3 3"]:
    """The rotation that, with a direction of motion, brings lines of sight nearest to their epipolar planes."""
    for _ in range(_REFINED):
        turned = before @ R.T
        lift = np.maximum(np.linalg.norm(np.cross(t, turned), axis=1), 1e-3)
        off = np.sum(now * np.cross(t, turned), axis=1) / lift
        across = np.linalg.svd(t[None])[2][1:]
        J = np.column_stack([np.cross(turned, np.cross(now, t)), np.cross(turned, now) @ across.T]) / lift[:, None]
        weight = 1.0 / (1.0 + (off / (0.5 * gate_rad)) ** 2)
        H = (J * weight[:, None]).T @ J
        step = -np.linalg.solve(H + 1e-9 * np.trace(H) * np.eye(5), J.T @ (weight * off))
        R = rigid.exp(np.concatenate([np.zeros(3), step[:3]]))[:3, :3] @ R
        t = t + step[3:] @ across
        t = t / np.linalg.norm(t)
    return R


def _rate(R_now_before: np.ndarray, T_base_cam: np.ndarray, step_s: float) -> Float[np.ndarray, "3"]:
    T = np.eye(4)
    T[:3, :3] = R_now_before.T
    return T_base_cam[:3, :3] @ rigid.log(T)[3:] / step_s
