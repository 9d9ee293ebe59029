"""The velocity that a window gives away: its derivative, how long its error lasts, and 2 s without images."""

import numpy as np
import pytest

from semloc_jax.fusion.inertial_states import AT, STATE
from semloc_jax.fusion.seen_velocity import _by_state, seen_velocity
from semloc_jax.geometry import rigid
from tests.fusion.inertial_windows import NUM, begun, difference

DARK_FRAMES = 20
"""2 s."""


def test_derivative_of_the_velocity_is_the_finite_difference():
    window, _, _ = begun(0, NUM)
    state = window.state(-1)

    def in_base(error):
        T = state.T_map_base @ rigid.exp(error[:6])
        return T[:3, :3].T @ (state.velocity_map + error[AT["velocity"]])

    steps = 1e-6 * np.eye(STATE)
    found = np.stack([(in_base(step) - in_base(-step)) / 2e-6 for step in steps], axis=1)
    assert found == pytest.approx(_by_state(state), abs=1e-8)


def test_an_error_lasts_as_long_as_newest_and_oldest_state_share_it():
    window, moments, _ = begun(0, NUM + 1)
    estimate = window.add(moments[NUM])
    over_s = estimate.time_s - estimate.oldest_s
    assert over_s == pytest.approx(0.5)
    level, sigma = np.eye(4), np.full(STATE, 0.1)
    level_state = estimate.state._replace(T_map_base=level, velocity_map=np.zeros(3))
    shared = np.zeros((STATE, STATE))
    shared[AT["velocity"], AT["velocity"]] = np.diag([0.5, -0.1, 1.0]) * 0.01
    ends = {"state": level_state, "oldest": level_state, "covariance": np.diag(sigma**2), "across_oldest": shared}
    seen = seen_velocity(estimate._replace(**ends))
    assert seen.lasting_sigma == pytest.approx(0.1)
    # Half is left after 0.5 s; nothing; all of it, of which a window of half a second knows no longer than a minute.
    assert seen.lasts_s == pytest.approx([over_s / np.log(2.0), 0.1, 60.0])


def test_two_seconds_in_the_dark_cost_what_is_stated_and_the_corners_after_them_count_again():
    """No corner for 2 s at 9 m/s, after 1.2 s with a speed known to 0.1 m/s: decimetres, and the speed is seen again
    half a second later."""
    in_the_dark, after = [], []
    for seed in range(3):
        first, num = NUM + 6, NUM + 6 + DARK_FRAMES + 6
        window, moments, truth = begun(seed, num)
        for k in range(NUM, num):
            tracks = moments[k].tracks
            is_dark = first <= k < first + DARK_FRAMES
            # Tracks that were followed before the dark are new ones after it.
            later = 100_000 * (k >= first)
            tracks = tracks._replace(id=np.where(is_dark | (tracks.id < 0), -1, tracks.id + later))
            estimate = window.add(moments[k]._replace(tracks=tracks))
            if k == first + DARK_FRAMES - 1:
                off = difference(estimate.state, truth, k)[:3]
                assert np.linalg.norm(off) < 0.6 and estimate.num_landmarks == 0
                in_the_dark.append(off @ np.linalg.solve(estimate.covariance[:3, :3], off) / 3)
        seen = seen_velocity(estimate)
        off = seen.velocity_base - truth["pose"][-1, :3, :3].T @ truth["velocity"][-1]
        after.append(np.mean((off / np.hypot(seen.lasting_sigma, seen.sigma)) ** 2))
        assert estimate.num_landmarks > 10 and seen.lasting_sigma[1] < 0.05
    assert np.mean(in_the_dark) < 2.1 and np.mean(after) < 2.1, "97.5 % of the means of nine squares"
