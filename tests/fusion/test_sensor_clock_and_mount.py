"""The clock and the mount of an inertial sensor as states of the window."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.fusion.inertial_states import AT
from tests.fusion.inertial_world import World
from tests.fusion.test_inertial_window import CONFIG, NUM, begun, difference

LATE_S, TURNED_DEG = 0.02, np.array([0.6, -0.6, 0.53])
FREE = replace(CONFIG, mount_sigma_deg=1.0, delay_sigma_s=0.02)


@pytest.mark.slow
def test_clock_and_mount_are_found_without_a_map():
    """20 ms late and turned by 1 deg about an oblique axis: 1 ms and 0.1 deg after 20 s, and the window says so."""
    off, sigma = [], []
    for seed in range(4):
        world = World(seed=seed, num_slots=40, mount_deg=tuple(TURNED_DEG), delay_s=LATE_S)
        window, moments, truth = begun(seed, 200, world=world, config=FREE)
        for k in range(NUM, 200):
            estimate = window.add(moments[k])
        off.append(difference(estimate.state, truth, 199))
        sigma.append(np.sqrt(np.diag(estimate.covariance)))
    off, sigma = np.array(off), np.array(sigma)
    assert 1e3 * np.abs(off[:, AT["delay"]]).mean() < 1.0, "[ms]"
    assert np.rad2deg(np.abs(off[:, AT["mount"]])).mean() < 0.1, "[deg]"
    both = (off / sigma)[:, AT["mount"].start : AT["delay"].stop]
    # Sixteen numbers: their mean square is below 1.7 in 95 of 100 cases.
    assert np.mean(both**2) < 1.7, "not surer than it may be"
