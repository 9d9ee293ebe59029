"""A crowned road beside the way is told by short marks that many frames show, and by nothing else."""

import cv2
import numpy as np
import pytest

from semloc_jax import camera_from_K, mounted
from semloc_jax.mapping.mark_looks import MarkLooks
from semloc_jax.mapping.profile_by_marks import road_profile
from semloc_jax.mapping.road_heights import RoadHeights
from semloc_jax.mapping.road_profile import RoadProfile
from semloc_jax.mapping.road_table import RoadTable
from semloc_jax.mapping.sightings import RayTable
from semloc_jax.perception import load_class_table

EYE = np.array([1.5, 0.2, 1.8])
DASHED = 11


def straight_way(num=60, step_m=0.7):
    Ts = np.tile(np.eye(4), (num, 1, 1))
    Ts[:, 0, 3] = step_m * np.arange(num)
    return Ts


def looks_at(marks, Ts, noise_rad=0.003, seed=0):
    """Looks at marks [m] of the map from all poses that have them within 9 m: their bearings and pitches are noisy."""
    rng = np.random.default_rng(seed)
    frames, downs = [], []
    for frame, T in enumerate(Ts):
        off = marks - T[:3, 3] - EYE
        off = off[np.linalg.norm(off[:, :2], axis=1) < 9.0]
        bearing, pitch = np.arctan2(off[:, 1], off[:, 0]), np.arctan2(-off[:, 2], np.hypot(off[:, 0], off[:, 1]))
        bearing, pitch = (angle + rng.normal(0.0, noise_rad, len(off)) for angle in (bearing, pitch))
        ahead = 1.0 / np.tan(pitch)
        downs.append(np.column_stack([ahead * np.cos(bearing), ahead * np.sin(bearing), -np.ones(len(off))]))
        frames.append(np.full(len(off), frame))
    down = np.concatenate(downs)
    return MarkLooks(np.concatenate(frames), np.tile(EYE, (len(down), 1)), down)


def row_of_marks(left_m, height_m, gap_m=1.2, from_m=0.0, to_m=45.0):
    x = np.arange(from_m, to_m, gap_m)
    return np.column_stack([x, np.full(len(x), left_m), np.full(len(x), height_m)])


@pytest.mark.parametrize(("left_m", "height_m"), [(5.5, -0.2), (-4.5, -0.12), (4.0, 0.15)])
def test_an_even_row_of_marks_tells_its_height(left_m, height_m):
    """Marks of one gap meet their neighbours at other heights, too, but not from every place."""
    Ts = straight_way()
    profile = road_profile(looks_at(row_of_marks(left_m, height_m), Ts), Ts)
    found = profile.at(np.arange(len(Ts)), np.full(len(Ts), left_m))
    np.testing.assert_allclose(found, height_m, atol=0.03)
    lane = profile.at(np.zeros(31, int), np.linspace(-1.5, 1.5, 31))
    assert np.abs(lane).max() < 0.005


@pytest.mark.parametrize("marks", [row_of_marks(5.5, 0.0), row_of_marks(5.5, -0.2, to_m=1.3), np.zeros((0, 3))])
def test_level_few_or_no_marks_tell_no_profile(marks):
    Ts = straight_way()
    assert road_profile(looks_at(marks, Ts), Ts) is None


def test_marks_all_over_the_road_tell_no_profile():
    """Looks at noise meet as often at any height."""
    Ts, rng = straight_way(), np.random.default_rng(3)
    noise = np.column_stack([rng.uniform(0, 45, 900), rng.uniform(2, 8, 900), np.zeros(900)])
    looks = looks_at(noise, Ts)
    chosen = rng.random(len(looks.frame)) < 0.05  # each is seen once or twice
    assert road_profile(looks.where(chosen), Ts) is None


def test_far_from_the_marks_the_road_is_the_plane_of_the_vehicle():
    Ts = straight_way(num=400)
    profile = road_profile(looks_at(row_of_marks(5.5, -0.2, to_m=40.0), Ts), Ts)
    assert profile.at(np.array([20]), np.array([5.5]))[0] == pytest.approx(-0.2, abs=0.03)
    assert profile.at(np.array([399]), np.array([5.5]))[0] == pytest.approx(0.0, abs=1e-6)


def test_a_place_that_lies_lower_is_looked_at_where_it_is():
    """A camera 1.8 m up shows what lies 0.2 m low at 5.5 m nearer on the plane, and back again."""
    Ts = straight_way()
    left_m = np.arange(-9.0, 9.1, 0.75)
    profile = RoadProfile(left_m, np.tile(np.where(left_m > 3.0, -0.2, 0.0), (len(Ts), 1)))
    heights = RoadHeights.of(Ts, 20, 25.0, profile)
    at = np.array([[4.0, 5.5], [4.0, 1.0]], np.float32)
    np.testing.assert_allclose(heights.at(at), [-0.2, 0.0], atol=1e-6)
    camera = camera_from_K([[400.0, 0, 399.5], [0, 400.0, 299.5], [0, 0, 1]], (800, 600))
    table = RoadTable.of(camera, mounted(tuple(EYE), yaw_deg=60.0, down_deg=15.0), 12.0, 0.05)
    rows = table.rows_of(at[:1].astype(np.float64), heights)
    assert rows[0] >= 0
    np.testing.assert_allclose(table.on_road(heights)[rows[0]], at[0], atol=0.05)
    drawn_m, true_m = (np.linalg.norm(place - EYE[:2]) for place in (table.xy_base[rows[0]], at[0]))
    assert drawn_m == pytest.approx(true_m * 1.8 / 2.0, abs=0.05)


def test_a_mask_shows_the_middle_of_a_short_mark_and_nothing_else():
    """A spot of 0.3 m at 5 m; a long line, a spot beside a vehicle and one that the border cuts say nothing."""
    camera = camera_from_K([[600.0, 0, 399.5], [0, 600.0, 199.5], [0, 0, 1]], (800, 600))
    T_base_cam = mounted(tuple(EYE))
    mask = np.ones((600, 800), np.uint8)

    def paint(xy, value=DASHED):
        corners = np.column_stack([xy, np.zeros(len(xy))])
        uv, _ = camera.project((corners - T_base_cam[:3, 3]) @ T_base_cam[:3, :3])
        cv2.fillPoly(mask, [np.rint(np.asarray(uv)).astype(np.int32)], value)

    def square(x, y, half=0.15):
        return np.array([[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]])

    paint(square(7.0, 1.0))
    paint(square(7.5, -1.0))
    paint(square(7.5, -1.35, 0.2), 7)
    paint(np.array([[6.0, 2.0], [12.0, 2.0], [12.0, 2.15], [6.0, 2.15]]))
    mask[400:412, :9] = DASHED
    looks = MarkLooks.of([(3, mask, RayTable.of(camera, T_base_cam))], load_class_table("drive"))
    assert looks.frame.tolist() == [3]
    np.testing.assert_allclose(looks.on_plane(0.0)[0], [7.0, 1.0, 0.0], atol=0.06)
