"""The light localizer of the literature on a perfect mask: centimetres from a near guess, a simple verdict else."""

import numpy as np
import pytest

import semloc_jax as sj
from semloc_jax.alignment.point_localizer import PointLocalizer
from semloc_jax.errors import SemlocError
from semloc_jax.perception.road_projection import FourPointRoad
from semloc_jax.structs import SolveStatus

TRUTH = sj.planar_pose(2.6, -0.2, np.deg2rad(0.5))
TABLE = sj.load_class_table("drive")


def bar(x_m):
    return "stop_line", [[x_m, -1.9, 0], [x_m, 1.9, 0]], {"width_m": 0.5}


@pytest.fixture(scope="module")
def street():
    sides = [("lane_marking", [[0, y, 0], [40, y, 0]]) for y in (-2.0, 2.0)]
    return sj.map_from_arrays([*sides, bar(10.0), bar(14.0), bar(18.0)])


@pytest.fixture(scope="module")
def rig():
    camera = sj.camera_from_K([[400, 0, 319.5], [0, 400, 199.5], [0, 0, 1]], (640, 400))
    return sj.Rig([camera], [sj.mounted((1.6, 0.0, 1.4), down_deg=4.0)], ["front"])


@pytest.fixture(scope="module")
def masks(street, rig):
    return sj.render_masks(street, rig, TRUTH)


def guess(x_m, y_m, deg):
    return sj.PosePrior(2.6 + x_m, -0.2 + y_m, np.deg2rad(0.5 + deg), sigma_xy_m=1.0, sigma_heading_rad=0.05)


def test_the_pose_is_found_from_a_near_guess(street, rig, masks):
    result = PointLocalizer(street, TABLE).localize(None, masks, guess(0.4, -0.3, 1.0), rig)
    assert result.localized
    assert result.status == SolveStatus.CONVERGED
    off = np.linalg.inv(TRUTH) @ result.T_map_base
    assert abs(off[1, 3]) < 0.03
    assert abs(off[0, 3]) < 0.15  # lines hold the points back along them
    assert np.rad2deg(abs(np.arctan2(off[1, 0], off[0, 0]))) < 0.2
    (mode,) = result.modes
    assert 0.0 < mode.sigma_lateral_m < 0.1
    assert mode.inlier_ratio > 0.9


def test_four_clicked_points_do_without_the_calibration(street, rig, masks):
    corners = np.array([[6.0, 1.5], [6.0, -1.5], [15.0, -2.5], [15.0, 3.0]])
    T = np.asarray(rig.T_base_cam)[0]
    p_cam = (np.column_stack([corners, np.zeros(4)]) - T[:3, 3]) @ T[:3, :3]
    roads = {"front": FourPointRoad.of(np.asarray(rig.cameras[0].project(p_cam)[0], np.float64), corners)}
    wrong = sj.Rig(rig.cameras, [sj.mounted((1.6, 0.0, 1.4), down_deg=9.0)], ["front"])
    given = masks, guess(0.2, 0.1, 0.3), wrong
    found = PointLocalizer(street, TABLE, roads=roads).localize(None, *given)
    assert np.linalg.norm((found.T_map_base - TRUTH)[:2, 3]) < 0.1
    assert found.localized
    # With the mount that is wrong by 5 deg the same guess ends elsewhere, or is refused.
    other = PointLocalizer(street, TABLE).localize(None, *given)
    assert not other.localized or np.linalg.norm((other.T_map_base - TRUTH)[:2, 3]) > 0.1


def test_a_place_without_partners_is_refused_and_an_empty_mask_too(street, rig, masks):
    far = PointLocalizer(street, TABLE).localize(None, masks, guess(0.0, 15.0, 0.0), rig)
    assert far.status == SolveStatus.POOR_FIT
    assert far.reasons[0].startswith("0% of the points")
    empty = PointLocalizer(street, TABLE).localize(None, [np.full((400, 640), 1, np.uint8)], guess(0, 0, 0), rig)
    assert empty.status == SolveStatus.NO_EVIDENCE
    np.testing.assert_array_equal(empty.T_map_base, empty.T_map_prior)


def test_a_map_without_paint_is_refused():
    with pytest.raises(SemlocError, match="has no paint that class table drive shows"):
        PointLocalizer(sj.map_from_arrays([("pole", [[0, 0, 0], [0, 0, 5]])]), TABLE)
