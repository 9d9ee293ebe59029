"""Drift of a trajectory that knows no map, as KITTI measures it (room: evaluation; host).

In: estimated and reference trajectories. Out: list[Metric]: translation in percent of the way, rotation in deg/m.
Geiger, Lenz, Urtasun, CVPR 2012: errors of the motion over stretches of 100 to 800 m. Shorter drives are judged over
shorter stretches of their own, and say so: figures of other lengths are not comparable.
"""

import numpy as np
from jaxtyping import Float

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.metrics import Metric
from semloc_jax.evaluation.trajectory import Trajectory, associate
from semloc_jax.geometry import rigid
from semloc_jax.geometry.polyline import arc_length

KITTI_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
_SHORT_SHARES = (0.25, 0.5, 0.75)
"""Stretches of a drive that is shorter than 100 m, as shares of its way; ours."""
_STEP = 10
"""A stretch begins at every tenth pose, as in KITTI's program."""


def drift(estimate: Trajectory, reference: Trajectory, max_difference_s: float = 0.02) -> list[Metric]:
    """How far a trajectory drifts, in any frame of its own.

    Returns:
        `drift.translation` [%] and `drift.rotation` [deg/m], means over stretches; `drift.shortest` and
        `drift.longest` stretch [m]; `drift.end` [%]: distance of the last pose from the truth when the first poses
        are laid on each other, of the way; `drift.way` [m].

    Raises:
        SemlocError: fewer than two poses have a reference, or the vehicle did not move.
    """
    a, b = associate(estimate.time_s, reference.time_s, max_difference_s)
    if len(a) < 2:
        raise SemlocError(f"drift: {len(a)} poses have a reference at their time; expected at least 2; check the times")
    T_est, T_ref = estimate.T_map_base[a], reference.T_map_base[b]
    way_m = arc_length(T_ref[:, :3, 3])
    if way_m[-1] < 1.0:
        raise SemlocError(f"drift: the vehicle moved {way_m[-1]:.2f} m; expected at least 1 m")
    lengths = [length for length in KITTI_M if length <= way_m[-1]] or [share * way_m[-1] for share in _SHORT_SHARES]
    rows = np.concatenate([_stretches(T_est, T_ref, way_m, length) for length in lengths])
    off = rigid.log(rigid.inverse(rigid.inverse(T_ref[0]) @ T_ref[-1]) @ rigid.inverse(T_est[0]) @ T_est[-1])
    return [
        Metric("drift.translation", float(100.0 * rows[:, 0].mean()), "%", "lower", 0.1),
        Metric("drift.rotation", float(np.rad2deg(rows[:, 1].mean())), "deg/m", "lower", 0.001),
        Metric("drift.end", float(100.0 * np.linalg.norm(off[:3]) / way_m[-1]), "%", "lower", 0.1),
        Metric("drift.shortest", float(min(lengths)), "m", "report"),
        Metric("drift.longest", float(max(lengths)), "m", "report"),
        Metric("drift.way", float(way_m[-1]), "m", "report"),
    ]


def _stretches(T_est: np.ndarray, T_ref: np.ndarray, way_m: np.ndarray, length_m: float) -> Float[np.ndarray, "k 2"]:
    """Errors of the motion over stretches of one length: translation [m/m], rotation [rad/m]."""
    rows = []
    for first in range(0, len(way_m), _STEP):
        last = int(np.searchsorted(way_m, way_m[first] + length_m))
        if last >= len(way_m):
            break
        moved = rigid.inverse(T_ref[first]) @ T_ref[last], rigid.inverse(T_est[first]) @ T_est[last]
        error = rigid.inverse(moved[1]) @ moved[0]
        angle = np.linalg.norm(rigid.log(error)[3:])
        rows.append((np.linalg.norm(error[:3, 3]) / length_m, angle / length_m))
    return np.array(rows).reshape(-1, 2)
