"""The rendered drives, localized frame by frame against their exact poses.

Measured on every 15th frame of the road (medians): exact masks 0.13 cm to the side, 0.26 cm along; masks like a
network's 0.47 cm and 1.6 cm; with their sign below 0.1 cm. Garage, every 10th frame: below 0.25 cm with exact masks.
"""

import numpy as np
import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.evaluation import pose_errors
from semloc_jax.inputs.priors import prior_source
from semloc_jax.localization.frame_by_frame import localize_frames
from semloc_jax.maps import read_map

pytestmark = [pytest.mark.data, pytest.mark.slow]


def poses_of(drive, masks, prior, every):
    """Errors [m, deg] of every n-th frame, and the share that was localized."""
    results = localize_frames(drive, read_map(drive.map_path), masks, prior, slice(None, None, every))
    truth = np.stack([drive.truth_at(result.frame) for result in results])
    found = pose_errors(np.stack([result.T_map_base for result in results]), truth)
    return found, np.mean([result.localized for result in results])


@pytest.fixture(scope="module")
def road(road_dir):
    drive = open_drive(road_dir)
    return {masks: poses_of(drive, masks, "gnss", 15) for masks in ("sem", "sem_net")}


@pytest.mark.parametrize(("masks", "lateral_cm", "longitudinal_cm"), [("sem", 0.2, 0.6), ("sem_net", 1.0, 4.0)])
def test_every_frame_of_the_road_is_localized(road, masks, lateral_cm, longitudinal_cm):
    found, recall = road[masks]
    assert recall == 1.0
    assert 100 * np.median(np.abs(found["lateral_m"])) <= lateral_cm
    assert 100 * np.median(np.abs(found["longitudinal_m"])) <= longitudinal_cm
    assert np.abs(found["lateral_m"]).max() < 0.08
    assert np.median(np.abs(found["heading_deg"])) < 0.05


@pytest.mark.parametrize("masks", ["sem", "sem_net"])
def test_errors_to_the_side_have_no_bias(road, masks):
    """Half a pixel of an unseen shift of the masks would be a centimetre."""
    found, _ = road[masks]
    assert abs(100 * np.median(found["lateral_m"])) < 0.3


def test_four_fisheyes_find_the_pose_from_a_metre_and_five_degrees(garage_dir):
    drive = open_drive(garage_dir)
    prior = prior_source("truth", drive, sigma_xy_m=1.0, sigma_heading_deg=5.0)
    found, recall = poses_of(drive, "sem", prior, 10)
    assert recall == 1.0
    assert 100 * np.hypot(found["lateral_m"], found["longitudinal_m"]).max() < 2.0
    assert np.abs(found["heading_deg"]).max() < 0.1
