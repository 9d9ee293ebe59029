"""Where a vehicle is if lens or map is wrong, against sums over all that could be."""

import numpy as np
import pytest

from semloc_jax.alignment.fault_modes import FaultConfig, FaultMode, joined, lens_mode, places_without, sign_mode

CONFIG = FaultConfig()
POSE = np.diag([0.1, 0.02, 0.001]) ** 2
STEP = 0.025
WAY = np.array([0.4, 0.0, 0.001])
"""How far the pose goes for one step of the lens."""


def frame_of(lens: float, told_to: float):
    """Gains of a frame whose lens is longer by this share and that tells lenses to so much."""
    cost = [0.5 * ((x - lens) / told_to) ** 2 for x in (0.0, STEP, -STEP)]
    return (cost[0] - cost[1], cost[0] - cost[2]), np.array([WAY, -WAY])


@pytest.mark.parametrize(("lens", "told_to"), [(0.0, 0.01), (-0.02, 0.012), (0.03, 0.02)])
def test_a_lens_is_summed_over_all_it_could_be(lens, told_to):
    """Against the integral over a lens that is off by two percent as a rule."""
    found = lens_mode(*frame_of(lens, told_to), POSE, STEP, "other lenses", CONFIG)
    x = np.linspace(-0.15, 0.15, 4001)
    weight = np.exp(-0.5 * ((x - lens) / told_to) ** 2 + 0.5 * (lens / told_to) ** 2 - 0.5 * (x / 0.02) ** 2)
    total = weight.sum() * (x[1] - x[0]) / (0.02 * np.sqrt(2.0 * np.pi))
    mean = (weight * x).sum() / weight.sum()
    variance = (weight * (x - mean) ** 2).sum() / weight.sum()
    assert found.odds == pytest.approx(0.01 * total, rel=1e-3)
    assert found.moved == pytest.approx(mean / STEP * WAY, abs=1e-4)
    assert found.covariance[0, 0] == pytest.approx(0.01 + variance / STEP**2 * 0.16, rel=1e-3)


def test_a_frame_that_says_nothing_of_lenses_leaves_them_as_probable_as_they_were():
    found = lens_mode((0.0, 0.0), np.array([WAY, -WAY]), POSE, STEP, "other lenses", CONFIG)
    assert found.odds == pytest.approx(found.prior, rel=1e-2)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(np.hypot(0.1, 0.02 / STEP * 0.4), rel=1e-2)
    assert sign_mode(np.nan, np.full(3, np.nan), POSE, "sign", CONFIG).odds < 1e-20
    assert sign_mode(7.0, WAY, POSE, "sign", CONFIG).odds == pytest.approx(0.01 * np.exp(7.0))


def places(gain, ahead_m, sigma_m):
    moved = np.array([[x, 0.0, 0.0] for x in ahead_m])
    covariance = np.tile(np.diag([sigma_m, 0.05, 0.002]) ** 2, (len(moved), 1, 1))
    return places_without(np.array(gain), moved, covariance, np.array([1.0, 1.0, 0.035]), 0.5, "posts", CONFIG)


def test_posts_that_may_stand_elsewhere_take_the_share_of_where_they_could():
    """The rest of the map fits 8 nats better two metres ahead, at a place held to 5 cm."""
    found = places([0.0, 8.0, 8.0, -3.0], [0.0, 2.0, 2.02, -0.5], 0.05)
    assert [fault.moved[0] for fault in found] == pytest.approx([2.0, 0.0, -0.5], abs=0.03)  # two starts, one place
    width = np.sqrt(2.0 * np.pi) * 0.05 / (4 * 0.5)
    assert found[0].odds == pytest.approx(CONFIG.moved_share * width * np.exp(8.0))
    assert found[0].odds > found[0].prior > found[1].odds


def test_a_rest_that_holds_nothing_and_places_that_are_no_number_say_nothing():
    assert places([0.0, 5.0], [0.0, 1.0], 0.9) == []
    assert places([np.nan, 5.0], [0.0, np.nan], 0.1) == []


def test_only_what_the_frame_speaks_for_widens_the_pose():
    quiet = FaultMode(0.001, 0.003, np.array([2.0, 0.0, 0.0]), POSE, "quiet")
    told = FaultMode(1.0, 0.003, np.array([2.0, 0.1, 0.0]), POSE, "told")
    assert joined(POSE, (quiet,)) == pytest.approx(POSE)
    wide = joined(POSE, (quiet, told))
    share = 1.0 / 2.001
    assert wide[0, 0] == pytest.approx(0.01 + share * 4.0) and wide[0, 1] == pytest.approx(share * 0.2)
