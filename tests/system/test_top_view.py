"""Four fisheye cameras as one top view: the pose comes out of the same solver to centimetres."""

import numpy as np
import pytest

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.alignment.scene import FrameSearch
from semloc_jax.datasets import open_drive
from semloc_jax.evaluation import pose_errors
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.inputs.priors import prior_source
from semloc_jax.localization.frame_by_frame import localize_frames
from semloc_jax.maps import read_map


@pytest.fixture(scope="module")
def garage(garage_dir):
    return open_drive(garage_dir)


@pytest.mark.slow
def test_poses_from_the_top_view(garage):
    config = LocalizeConfig(search=FrameSearch(num_hypotheses=64))
    prior = prior_source("truth", garage, sigma_xy_m=0.2, sigma_heading_deg=1.0)
    found = localize_frames(garage, read_map(garage.map_path), "ipm:sem", prior, garage.frames[12:31:18], config=config)
    assert len(found) == 2
    for result in found:
        assert result.localized
        errors = pose_errors(result.T_map_base, garage.truth_at(result.frame))
        assert max(abs(errors["lateral_m"]), abs(errors["longitudinal_m"])) < 0.03
        assert abs(errors["heading_deg"]) < 0.15


def test_one_mask_of_paint_only(garage):
    source = mask_source("ipm:sem", garage)
    (mask,) = source.masks(garage.frames[12])
    rig = source.seen_by(garage.rig)
    assert rig.names == ("top_view",)
    assert mask.shape == rig.cameras[0].resolution[::-1]
    assert np.isin(mask, list({*range(20), 255})).all()
    assert 0.1 < (mask != 255).mean() < 0.9
