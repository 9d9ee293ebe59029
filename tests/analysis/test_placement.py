"""CameraPlacement of a camera: the gradient is that of finite differences; what is turned, raised and zoomed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.analysis.placement import (
    CameraPlacement,
    PlacementConfig,
    mean_log_sigma,
    place_camera,
    placement_problem,
)
from semloc_jax.datasets import open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.maps import read_map
from semloc_jax.perception import load_class_table

TABLE = load_class_table("drive")
CONFIG = PlacementConfig()


@pytest.fixture(scope="module")
def drive(simulated_road):
    return open_drive(simulated_road)


@pytest.fixture(scope="module")
def places(drive):
    return np.stack([drive.truth_at(frame) for frame in drive.frames[::2]])


def _in_float64(tree):
    return jax.tree.map(
        lambda leaf: jnp.asarray(leaf, jnp.float64) if jnp.issubdtype(jnp.asarray(leaf).dtype, jnp.floating) else leaf,
        tree,
    )


@pytest.mark.slow
def test_gradient_is_that_of_finite_differences(drive, places):
    """By pitch, height and zoom within 0.1 %, in float64, away from the given camera as well."""
    problem = _in_float64(placement_problem(read_map(drive.map_path), drive.rig, TABLE, places[:1], CONFIG))

    def value(x):
        return mean_log_sigma(CameraPlacement(*x), problem, "front", CONFIG)

    slope = jax.jit(jax.grad(value))
    for x in (np.array([0.0, 0.0, 1.0]), np.array([4.0, 0.2, 0.8])):
        step = np.diag([1e-3, 1e-4, 1e-4])
        numeric = [float(value(x + h) - value(x - h)) / (2 * h.sum()) for h in step]
        np.testing.assert_allclose(slope(jnp.asarray(x)), numeric, rtol=1e-3, atol=1e-5)


def test_a_camera_is_turned_down_raised_and_zoomed(drive):
    rig = CameraPlacement(10.0, 0.3, 2.0).applied(drive.rig, "front")
    before, after = np.asarray(drive.rig.T_base_cam[0]), np.asarray(rig.T_base_cam[0])
    down_deg = np.rad2deg(np.arcsin(before[2, 2]) - np.arcsin(after[2, 2]))
    assert down_deg == pytest.approx(10.0, abs=0.01)
    assert after[2, 3] - before[2, 3] == pytest.approx(0.3)
    assert float(rig.cameras[0].fx) == pytest.approx(2 * float(drive.rig.cameras[0].fx))


def test_ranges_without_the_given_camera_are_refused(drive, places):
    with pytest.raises(SemlocError, match="ranges that hold the given camera"):
        place_camera(read_map(drive.map_path), drive.rig, TABLE, places, config=PlacementConfig(zoom=(1.2, 2.0)))
