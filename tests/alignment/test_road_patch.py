"""Poses on a road that is not one plane."""

import numpy as np
import pytest

from semloc_jax.alignment.candidates import planar
from semloc_jax.alignment.road_patch import RoadPatch
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.structs import ElementClass

ORIGIN = np.array([100.0, 200.0, 30.0])


def banked(y_m):
    """Height of a road whose bank grows to the left."""
    return 30.0 + 0.002 * y_m**2


def banked_map():
    lines = []
    for number, y in enumerate(np.arange(-16.0, 17.0, 1.0)):
        x = np.linspace(-40.0, 40.0, 81)
        points = np.column_stack([ORIGIN[0] + x, np.full(81, ORIGIN[1] + y), np.full(81, banked(y))])
        lines.append(MapElement(f"line_{number}", ElementClass.LANE_MARKING, points, width_m=0.12))
    return SemanticMap(tuple(lines))


def test_every_pose_stands_on_the_road_at_its_own_place():
    semantic_map = banked_map()
    T_prior = semantic_map.road_pose(*ORIGIN[:2], 0.0)
    patch = RoadPatch.around(semantic_map, T_prior, LocalFrame(ORIGIN), 12.0)
    y_m = np.array([0.0, 4.0, 8.0, -6.0])
    Ts = patch.place(planar(np.array([0.0, 3.0, -5.0, 7.0]), y_m, np.array([0.0, 0.3, -0.2, 2.0])))
    assert Ts[:, 2, 3] == pytest.approx(banked(y_m) - ORIGIN[2], abs=0.03)
    assert -Ts[:, 1, 2] / Ts[:, 2, 2] == pytest.approx(0.004 * y_m, abs=0.006)


def test_poses_stay_rigid_and_keep_place_and_heading():
    semantic_map = banked_map()
    patch = RoadPatch.around(semantic_map, semantic_map.road_pose(*ORIGIN[:2], 0.0), LocalFrame(ORIGIN), 12.0)
    given = planar(np.array([1.0, -9.0]), np.array([2.5, 30.0]), np.array([0.7, -2.5]))
    Ts = patch.place(given)
    assert Ts[:, :2, 3] == pytest.approx(given[:, :2, 3])
    assert np.arctan2(Ts[:, 1, 0], Ts[:, 0, 0]) == pytest.approx([0.7, -2.5])
    assert Ts[:, :3, :3] @ np.swapaxes(Ts[:, :3, :3], 1, 2) == pytest.approx(np.tile(np.eye(3), (2, 1, 1)), abs=1e-9)


def test_where_the_map_has_no_road_the_plane_of_the_prior_goes_on():
    semantic_map = banked_map()
    T = np.eye(4)
    T[:3, 3] = ORIGIN[0] + 500.0, ORIGIN[1], 31.0
    patch = RoadPatch.around(semantic_map, T, LocalFrame(ORIGIN), 4.0)
    assert patch.place(planar(np.array([501.0]), np.array([1.0]), np.zeros(1)))[0, 2, 3] == pytest.approx(1.0)
