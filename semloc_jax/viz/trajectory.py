"""Errors of a trajectory over time, and a way without a map beside the true one (room: viz).

In: estimated and reference trajectories. Out: a Figure.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.metrics import ALERT_LIMITS, ErrorLimit, pose_errors
from semloc_jax.evaluation.trajectory import Trajectory, associate
from semloc_jax.geometry import rigid
from semloc_jax.viz.style import new_figure, plain_axes

ROWS = (("lateral_m", "lateral", "m"), ("longitudinal_m", "longitudinal", "m"), ("heading_deg", "heading", "deg"))
INSIDE, OUTSIDE, LIMIT, GUESS = "#1565c0", "#d50000", "#43a047", "#90a4ae"


def errors_over_time(
    estimate: Trajectory,
    reference: Trajectory,
    max_difference_s: float = 0.02,
    limit: ErrorLimit = ALERT_LIMITS[0],
    missed_s: Sequence[float] = (),
    prior: Trajectory | None = None,
) -> Figure:
    """Signed lateral, longitudinal and heading errors over time, with the band of one alert limit.

    Dots beyond the limit are red, and drawn at the edge with a triangle where they would leave the picture.

    Args:
        estimate: Estimated poses.
        reference: True poses.
        max_difference_s: Poses belong together when their times differ by no more than this.
        limit: The alert limit.
        missed_s: Times of frames without a pose, marked at the foot of the figure.
        prior: First guesses, drawn in grey.

    Raises:
        SemlocError: no estimate belongs to any reference time.
    """
    index_est, index_ref = associate(estimate.time_s, reference.time_s, max_difference_s)
    if len(index_est) == 0:
        raise SemlocError(
            f"errors over time: no two poses are within {max_difference_s} s; expected the same clock; check the times"
        )
    errors = pose_errors(estimate.T_map_base[index_est], reference.T_map_base[index_ref])
    time_s = estimate.time_s[index_est]
    guesses = _errors_of(prior, reference, max_difference_s)
    figure = new_figure(9.0, 5.6)
    grid = figure.subplots(len(ROWS), 1, sharex=True)
    for axes, (key, name, unit) in zip(grid, ROWS, strict=True):
        bound = getattr(limit, key)
        _draw_row(plain_axes(axes), time_s, errors[key], bound)
        if guesses is not None:
            _draw_guesses(axes, guesses[0], guesses[1][key])
            axes.set_title(
                f"grey: first guesses, median {np.median(np.abs(guesses[1][key])):.3g} {unit}", loc="left", fontsize=8
            )
        size = np.abs(errors[key])
        axes.set_ylabel(f"{name} [{unit}]", fontsize=9)
        text = f"median {np.median(size):.3f}   p95 {np.percentile(size, 95):.3f}   limit ±{bound:g} {unit}"
        axes.set_title(text, loc="right", fontsize=8)
    for time in missed_s:
        grid[-1].axvline(time, ymax=0.06, color=OUTSIDE, linewidth=1.0)
    grid[-1].set_xlabel(f"time [s]{'   (red ticks: no pose)' if len(missed_s) else ''}", fontsize=9)
    return figure


def _errors_of(prior: Trajectory | None, reference: Trajectory, max_difference_s: float):
    """Times and errors of the first guesses; None without any."""
    if prior is None or len(prior) == 0:
        return None
    index, index_ref = associate(prior.time_s, reference.time_s, max_difference_s)
    return prior.time_s[index], pose_errors(prior.T_map_base[index], reference.T_map_base[index_ref])


def _draw_guesses(axes, time_s: np.ndarray, error: np.ndarray) -> None:
    """First guesses inside of the range of the row; a triangle at its edge for those beyond."""
    reach = axes.get_ylim()[1]
    inside = np.abs(error) <= reach
    axes.scatter(time_s[inside], error[inside], s=10, marker="x", color=GUESS, linewidths=0.8, zorder=2)
    for sign, marker in ((1.0, "^"), (-1.0, "v")):
        far = sign * error > reach
        axes.scatter(time_s[far], np.full(far.sum(), sign * 0.9 * reach), s=18, marker=marker, color=GUESS, zorder=2)


def _draw_row(axes, time_s: np.ndarray, error: np.ndarray, bound: float) -> None:
    # The robust range of what is there, never less than a little more than the limit: one wild pose hides nothing.
    reach = max(1.3 * bound, 1.5 * float(np.percentile(np.abs(error), 90, method="lower")))
    axes.axhspan(-bound, bound, color=LIMIT, alpha=0.10, linewidth=0)
    for side in (-bound, bound):
        axes.axhline(side, color=LIMIT, linewidth=0.8, linestyle=(0, (4, 3)))
    axes.axhline(0.0, color="#90a4ae", linewidth=0.6)
    axes.plot(time_s, np.clip(error, -reach, reach), color=INSIDE, linewidth=0.7, alpha=0.5)
    outside = np.abs(error) > bound
    axes.scatter(time_s[~outside], error[~outside], s=9, color=INSIDE, linewidths=0, zorder=3)
    near = outside & (np.abs(error) <= reach)
    axes.scatter(time_s[near], error[near], s=12, color=OUTSIDE, linewidths=0, zorder=3)
    for sign, marker in ((1.0, "^"), (-1.0, "v")):
        far = sign * error > reach
        axes.scatter(time_s[far], np.full(far.sum(), sign * 0.96 * reach), s=22, marker=marker, color=OUTSIDE, zorder=3)
    axes.set_ylim(-reach, reach)


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
