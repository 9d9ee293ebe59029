"""Numbers that no sensor gives are refused where they enter: later they would be infinite in float32."""

import numpy as np
import pytest

from semloc_jax.datasets.pandaset import cuboids
from semloc_jax.datasets.pandaset.reader import _labelled_points
from semloc_jax.datasets.sensors import GnssTrack, Imu, WheelOdometry
from semloc_jax.errors import SemlocError

TIME_S, ONE = np.arange(3.0), np.ones((3, 3))
HUGE = [1e39, -1e39, np.inf, np.nan]


def _with(value: float, shape: tuple[int, ...]) -> np.ndarray:
    found = np.ones(shape)
    found.flat[0] = value
    return found


@pytest.mark.parametrize("value", HUGE)
@pytest.mark.parametrize(
    "made",
    [
        lambda value: GnssTrack(TIME_S, _with(value, (3, 3)), ONE),
        lambda value: WheelOdometry(TIME_S, np.ones(3), _with(value, (3,))),
        lambda value: WheelOdometry(TIME_S, _with(value, (3,)), np.ones(3)),
        lambda value: Imu(TIME_S, _with(value, (3, 3)), ONE),
        lambda value: Imu(TIME_S, ONE, _with(value, (3, 3))),
    ],
    ids=["place", "yaw rate", "speed", "rate", "acceleration"],
)
def test_one_huge_reading_is_refused(made, value):
    with pytest.raises(SemlocError, match="expected"):
        made(value)


@pytest.mark.parametrize("value", HUGE)
def test_boxes_and_points_beyond_the_earth_are_refused(tmp_path, monkeypatch, value):
    table = {name: np.array([value, 1.0]) for name in cuboids._NUMBERS} | {"label": ["Car", "Bus"]}
    monkeypatch.setattr(cuboids, "_read_table", lambda path: table)
    with pytest.raises(SemlocError, match="beyond the earth"):
        cuboids.read_cuboids(tmp_path / "00.pkl.gz")
    np.savez(tmp_path / "points.npz", data=_with(value, (4, 7))[:, ::-1])
    with pytest.raises(SemlocError, match="beyond the earth"):
        _labelled_points(tmp_path / "points.npz")
