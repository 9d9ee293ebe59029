"""Drives rendered on real maps, localized frame by frame: a Lanelet2 road of lines and dashes, a motorway with posts.

Nothing but paint lies across the road there, so ends of dashes say how far along it the vehicle is. Measured with exact
masks on seed 0, 4 frames a second: Karlsruhe within 1.7 cm to the side, 27 cm along, 0.11 deg; e6mini 0.9 cm, 33 cm,
0.08 deg. The bounds are about twice that to the side, and what a local street allows for a pose called localized.
"""

import numpy as np
import pytest

from semloc_jax.evaluation import pose_errors
from semloc_jax.localization.frame_by_frame import localize_frames
from semloc_jax.maps import read_map
from semloc_jax.simulation import RouteWish, SimulationConfig, simulate_on_map
from semloc_jax.structs import SolveStatus

MAPS = {
    "karlsruhe": "maps_lanelet2_karlsruhe/lanelet2_maps/res/mapping_example.osm",
    "e6mini": "maps_opendrive_esmini/resources/xodr/e6mini.xodr",
}


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("name", MAPS)
def test_a_drive_on_a_real_map_is_localized(name, data_dir, tmp_path):
    path = data_dir / MAPS[name]
    if not path.exists():
        pytest.skip(f"no map {path}")
    config = SimulationConfig(rate_hz=1.0, has_images=False)
    drive = simulate_on_map(path, 0, tmp_path / "drive", RouteWish(length_m=66.0), config)
    results = localize_frames(drive, read_map(drive.map_path), "sem", "gnss")
    assert len(results) == 6
    # Where no end of a dash is near, a frame says that it does not know how far along it is.
    sure = [result for result in results if result.localized]
    assert len(sure) >= 5, [result.reasons for result in results]
    assert all(result.status == SolveStatus.WEAK_DIRECTION for result in results if not result.localized)
    truth = np.stack([drive.truth_at(result.frame) for result in sure])
    found = pose_errors(np.stack([result.T_map_base for result in sure]), truth)
    assert np.median(np.abs(found["lateral_m"])) < 0.015
    assert np.abs(found["lateral_m"]).max() < 0.04
    assert np.abs(found["heading_deg"]).max() < 0.25
    assert np.abs(found["longitudinal_m"]).max() < 0.5
    # No pose is surer of itself than it may be.
    for error, sigma in (("lateral_m", "sigma_lateral_m"), ("longitudinal_m", "sigma_longitudinal_m")):
        stated = np.array([getattr(result.modes[0], sigma) for result in sure])
        assert np.abs(found[error] / stated).max() < 3.5
