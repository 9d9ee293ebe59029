"""From the solver's modes to modes in the map frame (room: alignment; host).

In: hypotheses.Modes, their local frame. Out: Mode list; poses that belong together are merged by their moments.
"""

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from semloc_jax.alignment.hypotheses import Modes, weigh
from semloc_jax.alignment.result import Mode
from semloc_jax.alignment.same_pose import ONE_OPTIMUM, units_apart
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import PoseEstimate

_weigh = stored_program()(weigh)
_SIZE = 64


def weighed(estimates: PoseEstimate, rows: np.ndarray, nats: np.ndarray) -> Modes:
    """Some estimates weighed against each other by their cost [nats]; padded, so that one program serves any number."""
    if len(rows) == 1:  # against nothing
        alone = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], estimates)
        return Modes(alone, np.asarray(nats, np.float32), np.ones(1, np.float32))
    padded = np.full(-(-len(rows) // _SIZE) * _SIZE, rows[0])
    padded[: len(rows)] = rows
    scores = np.full(len(padded), np.inf, np.float32)
    scores[: len(rows)] = nats
    return jax.device_get(_weigh(jax.tree.map(lambda leaf: leaf[padded], estimates), scores))


def modes_in_map(found: Modes, frame: LocalFrame, apart: float) -> tuple[Mode, ...]:
    """The filled modes, in the map frame, best first.

    Solves that ended in one optimum count once. Modes nearer than `apart` units (see `same_pose`) are one place whose
    pose is their weighted mean and whose covariance holds their spread: the masks cannot tell such modes apart.
    """
    found = jax.tree.map(lambda leaf: np.asarray(leaf, dtype=np.float64), found)
    estimates = found.estimates
    modes: list[Mode] = []
    for i in np.argsort(found.score, kind="stable"):
        if not np.isfinite(found.score[i]) or not np.isfinite(estimates.T_local_base[i]).all():
            continue
        T = frame.to_map(orthonormal(estimates.T_local_base[i]))
        if any(units_apart(T, mode.T_map_base) < ONE_OPTIMUM for mode in modes):
            continue
        modes.append(
            Mode(
                weight=float(found.weight[i]),
                T_map_base=T,
                covariance=estimates.covariance[i],
                score=float(found.score[i]),
                cost=float(estimates.cost[i]),
                coverage=float(estimates.coverage[i]),
                inlier_ratio=float(estimates.inlier_ratio[i]),
                weak_direction=estimates.weak_direction[i],
            )
        )
    return _normalised(_merged(modes, apart))


def orthonormal(T: np.ndarray) -> np.ndarray:
    """The rigid motion nearest to a float32 one, in float64."""
    T = T.copy()
    u, _, vt = np.linalg.svd(T[:3, :3])
    T[:3, :3] = u @ vt
    return T


def _merged(modes: list[Mode], apart: float) -> list[Mode]:
    """Clusters around the best modes, each one replaced by its weighted mean."""
    clusters: list[list[Mode]] = []
    for mode in modes:
        home = next((c for c in clusters if units_apart(mode.T_map_base, c[0].T_map_base) < apart), None)
        if home is None:
            clusters.append([mode])
        else:
            home.append(mode)
    return [_mean(cluster) for cluster in clusters]


def _mean(cluster: list[Mode]) -> Mode:
    best = cluster[0]
    total = sum(mode.weight for mode in cluster)
    if len(cluster) == 1 or total <= 0:
        return best
    shares = np.array([mode.weight / total for mode in cluster])
    steps = np.array([_step(best.T_map_base, mode.T_map_base) for mode in cluster])
    mean = shares @ steps
    spread = sum(s * (m.covariance + np.outer(d, d)) for s, m, d in zip(shares, cluster, steps - mean, strict=True))
    T = best.T_map_base.copy()
    T[:3, 3] += T[:3, :3] @ mean[:3]
    T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(mean[3:]).as_matrix()
    return Mode(total, T, spread, best.score, best.cost, best.coverage, best.inlier_ratio, best.weak_direction)


def _step(T_from: np.ndarray, T_to: np.ndarray) -> np.ndarray:
    """Small motion between two poses (translation [m], rotation vector [rad]) in the frame of the first."""
    T = np.linalg.inv(T_from) @ T_to
    return np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_rotvec()])


def _normalised(modes: list[Mode]) -> tuple[Mode, ...]:
    """Sorted by weight, weights summing to 1."""
    total = sum(mode.weight for mode in modes)
    scale = 1.0 / total if total > 0 else 0.0
    scaled = [
        Mode(
            m.weight * scale, m.T_map_base, m.covariance, m.score, m.cost, m.coverage, m.inlier_ratio, m.weak_direction
        )
        for m in modes
    ]
    return tuple(sorted(scaled, key=lambda mode: -mode.weight))
