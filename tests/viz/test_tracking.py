"""The picture of a tracked drive cannot hide a fault: curve and limits lie inside of the axes."""

import numpy as np
import pytest

from semloc_jax.localization.track_state import TrackStatus
from semloc_jax.viz.tracking import tracking_over_time


@pytest.mark.parametrize("worst_m", [0.02, 0.5, 13.5])
def test_the_axes_hold_the_whole_curve_and_the_limits(worst_m):
    time_s, limit_m = np.linspace(0.0, 5.0, 50), 0.29
    error = np.where(time_s < 4.0, 0.01, -worst_m)
    level = np.where(time_s < 1.0, np.inf, 0.2)
    status = [TrackStatus.TRACKING] * 50
    figure = tracking_over_time(
        time_s, status, {"longitudinal [m]": error}, {"longitudinal [m]": level}, {"longitudinal [m]": limit_m}
    )
    low, high = figure.axes[0].get_ylim()
    assert high == -low
    assert max(worst_m, limit_m) < high < 1.3 * max(worst_m, limit_m)
