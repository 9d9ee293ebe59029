"""Top view of all cameras: painted lines land where they are, what hides the road is left out."""

import numpy as np
import pytest

from semloc_jax.cameras import BevCamera
from semloc_jax.errors import SemlocError
from semloc_jax.perception import load_class_table
from semloc_jax.perception.surround import SurroundView, ground_table, top_view
from semloc_jax.structs import ElementClass
from tests.perception.four_fisheyes import four_fisheyes, painted

PAINT, PILLAR, EGO = 15, 23, 8


@pytest.fixture(scope="module")
def rig():
    return four_fisheyes()


def places(bev, T_base_bev):
    """Place (x, y) [m] in the base frame of each pixel of a top view."""
    u, v = np.meshgrid(np.arange(float(bev.width)), np.arange(float(bev.height)))
    scale = 1.0 / float(bev.fx)
    return np.stack([T_base_bev[0, 3] + (bev.cy - v) * scale, T_base_bev[1, 3] + (bev.cx - u) * scale], axis=-1)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0])
def test_a_line_lands_within_half_a_pixel(rig, angle_deg):
    bev, T_base_bev = top_view(rig, range_m=6.0, metres_per_px=0.04)
    across = np.array([-np.sin(np.deg2rad(angle_deg)), np.cos(np.deg2rad(angle_deg))])
    at_m, half_m = 2.2 if angle_deg < 60 else -5.0, 0.15

    def offset(ground):
        return ground @ across - at_m

    top = SurroundView.of(rig, bev, T_base_bev).stitch(painted(rig, lambda ground: np.abs(offset(ground)) < half_m))
    away = offset(places(bev, T_base_bev))
    found = top == PAINT
    assert found.sum() * 0.04**2 > 0.5
    assert abs(away[found].mean()) < 0.02
    # Both edges within half a pixel of 0.04 m: the line is as wide as it is painted to 0.04 m of 0.3 m.
    beside = (np.abs(away) < 0.5) & (top != 255)
    assert found[beside].sum() / (np.abs(away) < half_m)[beside].sum() == pytest.approx(1.0, abs=0.13)
    assert not found[np.abs(away) > half_m + 0.25].any()


def test_a_road_above_the_plane_is_stated_by_its_height(rig):
    bev, T_base_bev = top_view(rig, range_m=6.0, metres_per_px=0.04)
    masks = painted(rig, lambda ground: np.abs(ground[..., 1] - 3.0) < 0.15, height_m=0.1)
    for height_m, off_m in ((0.1, 0.0), (0.0, 0.25)):  # 2 m from a camera 0.9 m high: 2 * 0.9 / (0.9 - 0.1) - 2
        road = T_base_bev.copy()
        road[2, 3] += height_m
        top, ground = SurroundView.of(rig, bev, road).stitch(masks), places(bev, T_base_bev)
        abreast = np.abs(ground[..., 0] - 1.9) < 0.8
        assert abs(ground[(top == PAINT) & abreast, 1].mean() - 3.0 - off_m) < 0.02


def test_each_pixel_is_taken_from_the_camera_that_sees_it_finest(rig):
    bev, T_base_bev = top_view(rig, range_m=6.0, metres_per_px=0.04)
    view = SurroundView.of(rig, bev, T_base_bev)
    masks = [np.full((480, 640), number, np.uint8) for number in range(4)]
    top, ground = view.stitch(masks), places(bev, T_base_bev)
    for number, place in enumerate(((5.5, 0.0), (1.9, 2.5), (-2.5, 0.0), (1.9, -2.5))):
        near = np.linalg.norm(ground - place, axis=-1) < 0.3
        assert (top[near] == number).all()
    assert (top == 255).any()  # under the car


def test_what_hides_the_road_is_left_out_or_seen_by_the_next_camera(rig):
    bev, T_base_bev = top_view(rig, range_m=6.0, metres_per_px=0.04)
    view = SurroundView.of(rig, bev, T_base_bev)
    masks = painted(rig, lambda ground: np.abs(ground[..., 1]) < 9.0)
    masks[0][:] = PILLAR
    table = ground_table(load_class_table("drive"))
    before, top = view.stitch(masks), view.stitch(masks, table.unusable_ids)
    assert (before == PILLAR).any()
    assert set(np.unique(top)) <= {1, PAINT, 255}
    assert (top[before == PILLAR] == PAINT).any()
    assert (top[before == PAINT] == PAINT).all()
    assert (view.stitch([masks[0]] * 4, table.unusable_ids) == 255).all()


def test_only_paint_has_channels_and_the_rest_hides_the_road():
    table = ground_table(load_class_table("drive"))
    assert {channel.name for channel in table.channels} == {
        "lane_marking",
        "stop_line",
        "crosswalk",
        "road_mark",
        "slot_line",
        "speed_bump",
    }
    assert table.channel_of(ElementClass.PILLAR) == -1
    assert {4, 5, 6, 20, PILLAR, 25, 26, EGO, 7, 255} <= set(table.unusable_ids)
    assert not {0, 1, 2, 3, 10, PAINT} & set(table.unusable_ids)
    with pytest.raises(SemlocError, match="no paint on the road"):
        ground_table(load_class_table("cityscapes"))


def test_one_mask_for_each_camera(rig):
    with pytest.raises(SemlocError, match="given 1 masks; expected one for each of 4"):
        view = SurroundView.of(rig, BevCamera.covering(5, 5, 5, 5, 0.1), top_view(rig)[1])
        view.stitch([np.zeros((480, 640), np.uint8)])
