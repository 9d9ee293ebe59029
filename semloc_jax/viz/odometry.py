"""A way without a map beside the true one, and how it drifted (room: viz).

In: poses in odom, true poses, standard deviations, counts. Out: a Figure.
"""

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.geometry import rigid
from semloc_jax.viz.style import new_figure, plain_axes

ESTIMATE, TRUTH, SPREAD = "#1565c0", "#43a047", "#90caf9"
_ROWS = (("ahead", 0), ("left", 1), ("up", 2))


def odometry_picture(
    estimate: Trajectory,
    sigma_m: Float[np.ndarray, "n 3"],
    speed_mps: Float[np.ndarray, " n"],
    num_landmarks: Float[np.ndarray, " n"],
    truth: Float[np.ndarray, "n 4 4"] | None,
) -> Figure:
    """The way from above; beside it the error with two standard deviations (or the height), speed and landmarks.

    Args:
        estimate: Poses in the frame odom.
        sigma_m: Standard deviations ahead, left and up; NaN where unknown.
        speed_mps: Of the estimate.
        num_landmarks: That held each pose; NaN where unknown.
        truth: True poses in any frame; the first is laid on the first of the estimate.
    """
    figure = new_figure(10.0, 5.6)
    num_rows = 5 if truth is not None else 3
    grid = figure.add_gridspec(num_rows, 2, width_ratios=(1.0, 1.1))
    time_s, T = estimate.time_s - estimate.time_s[0], estimate.T_map_base
    above = plain_axes(figure.add_subplot(grid[:, 0]))
    beside = [plain_axes(figure.add_subplot(grid[row, 1])) for row in range(num_rows)]
    if truth is not None:
        T_true = T[0] @ rigid.inverse(truth[0]) @ truth
        above.plot(T_true[:, 0, 3], T_true[:, 1, 3], color=TRUTH, linewidth=2.5, label="truth")
        off = np.einsum("nji,nj->ni", T_true[:, :3, :3], T[:, :3, 3] - T_true[:, :3, 3])
        for axes, (name, index) in zip(beside, _ROWS, strict=False):
            axes.fill_between(
                time_s, -2 * sigma_m[:, index], 2 * sigma_m[:, index], color=SPREAD, alpha=0.5, linewidth=0
            )
            axes.plot(time_s, off[:, index], color=ESTIMATE, linewidth=1.2)
            axes.set_ylabel(f"{name} [m]")
        beside[0].set_title("error, with twice its stated standard deviation", loc="left", fontsize=9)
    else:
        beside[0].plot(time_s, T[:, 2, 3], color=ESTIMATE, linewidth=1.2)
        beside[0].set_ylabel("height [m]")
    above.plot(T[:, 0, 3], T[:, 1, 3], color=ESTIMATE, linewidth=1.4, label="odometry")
    above.plot(*T[0, :2, 3], "o", color=ESTIMATE, markersize=5)
    _equal(above, T)
    above.set_xlabel("x of odom [m]")
    above.set_ylabel("y of odom [m]")
    above.legend(frameon=False, fontsize=8)
    beside[-2].plot(time_s, speed_mps, color=ESTIMATE, linewidth=1.2)
    beside[-2].set_ylabel("speed [m/s]")
    beside[-1].plot(time_s, num_landmarks, color=ESTIMATE, linewidth=1.2)
    beside[-1].set_ylabel("landmarks")
    beside[-1].set_ylim(bottom=0)
    beside[-1].set_xlabel("time since the first pose [s]")
    for axes in beside[:-1]:
        axes.tick_params(labelbottom=False)
    return figure


def _equal(axes, T: np.ndarray) -> None:
    """The same scale on both axes, and room beside a straight way."""
    low, high = T[:, :2, 3].min(axis=0), T[:, :2, 3].max(axis=0)
    half = 0.5 * max(float((high - low).max()) * 1.1, 5.0)
    middle = 0.5 * (low + high)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")
