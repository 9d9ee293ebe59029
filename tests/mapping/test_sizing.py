"""Lengths and widths of what is drawn are those that masks show, whatever the pose."""

import numpy as np
import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.mapping.element_pulls import ElementPulls, PullConfig, Pulls
from semloc_jax.mapping.joint import place_of
from semloc_jax.mapping.sides import resized, side_of, strip_of
from semloc_jax.mapping.sizing import sized
from semloc_jax.maps import MapElement, read_map
from semloc_jax.structs import ElementClass

FRAMES = np.array([rigid.planar_pose(x, 0.0, 0.05 * x, 0.0) for x in np.linspace(0.0, 5.0, 6)])
BORDER_SIGMA_M = 0.01


def dash(length_m, width_m, at=(9.0, 2.0), true_ends=(True, True)):
    x, y = at
    points = [[x - 0.5 * length_m, y, 0.0], [x + 0.5 * length_m, y, 0.0]]
    return MapElement("d", ElementClass.LANE_MARKING, points, width_m=width_m, style="dashed", true_ends=true_ends)


def bar(length_m, width_m):
    x, y = 0.5 * length_m, 0.5 * width_m
    points = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]]) + [9.0, 2.0, 0.0]
    return MapElement("d", ElementClass.CROSSWALK, points, closed=True)


def pulls_of(drawn, true, off=(0.0, 0.0), sides=(0, 1, 2, 3)):
    """Every frame shows some sides of the true strip, at another place in each frame: its pose is that wrong."""
    own, its = strip_of(drawn), strip_of(true)
    half = [0.5 * own.length_m, 0.5 * own.length_m, 0.5 * own.width_m, 0.5 * own.width_m]
    grown = 0.5 * np.array([its.length_m - own.length_m] * 2 + [its.width_m - own.width_m] * 2)
    found = []
    for k, T in enumerate(FRAMES):
        T_base_element = rigid.inverse(T) @ place_of(drawn)
        force, information = np.zeros((4, 6)), np.zeros((4, 6, 6))
        for s in sides:
            n = np.append(own.normals[s], 0.0)
            arm = half[s] * n
            # How far the border goes out where the element moves by its right tangent; its middle, and a bit of turn.
            row = np.concatenate([n, np.cross(arm, n)]) @ np.linalg.inv(rigid.adjoint(T_base_element))
            wanted_m = grown[s] + n[:2] @ (np.array(off) * (-1) ** k)
            # Moving the element out by 1 m is moving the vehicle by -row: nothing pulls where it is out by wanted_m.
            force[s] = row * wanted_m / BORDER_SIGMA_M**2
            information[s] = np.outer(row, row) / BORDER_SIGMA_M**2
        found.append(Pulls((drawn.id,), force[None], information[None]))
    return found


@pytest.mark.parametrize("off", [(0.0, 0.0), (0.04, 0.06)])
def test_a_strip_gets_the_size_that_all_frames_show_whatever_their_poses(off):
    for drawn, true in ((dash(4.2, 0.19), dash(4.0, 0.15)), (bar(2.9, 0.47), bar(3.0, 0.45))):
        found, left = sized([drawn], pulls_of(drawn, true, off), FRAMES)
        size = strip_of(found[0])
        # The size as drawn is believed to 20 cm, six frames to 1 cm each.
        assert size.length_m == pytest.approx(strip_of(true).length_m, abs=1e-3)
        assert size.width_m == pytest.approx(strip_of(true).width_m, abs=1e-3)
        np.testing.assert_allclose(size.middle, strip_of(drawn).middle, atol=1e-9)
        if off == (0.0, 0.0):
            still = np.abs([each.force for each in left]).max()
            assert still < 0.01 * np.abs([each.side_force for each in left]).max() + 1.0


def test_what_frames_show_from_one_side_only_keeps_its_size():
    drawn, true = dash(4.2, 0.19), dash(4.0, 0.15)
    for sides in ((0, 2), (1, 3), (0,)):
        (found,), _ = sized([drawn], pulls_of(drawn, true, sides=sides), FRAMES)
        assert (found.width_m, strip_of(found).length_m) == pytest.approx((0.19, 4.2), abs=1e-12)


def test_a_piece_of_a_line_has_a_width_and_no_length():
    drawn, true = dash(4.2, 0.19, true_ends=(True, False)), dash(4.0, 0.15)
    (found,), _ = sized([drawn], pulls_of(drawn, true), FRAMES)
    assert strip_of(found).length_m == pytest.approx(4.2, abs=1e-9)
    assert found.width_m == pytest.approx(0.15, abs=1e-3)


def test_sides_are_told_by_their_normals_and_places():
    strip = strip_of(bar(3.0, 0.5))
    np.testing.assert_array_equal(side_of(strip.normals, strip.normals, np.tile(strip.along, (4, 1))), [0, 1, 2, 3])
    barbs = -strip.along[None], 0.9 * strip.along[None], strip.along[None]
    assert side_of(*barbs) == 1, "the back of the head of an arrow goes forward with its tip"
    found = strip_of(resized(bar(3.0, 0.5), -0.2, 0.04))
    assert (found.length_m, found.width_m) == pytest.approx((2.8, 0.54))


def test_exact_masks_tell_the_widths_of_a_drawn_road(simulated_road):
    """Lines drawn 3 cm too wide, 6 frames: within 4 mm of the true ones in the median, with poses 3 cm to the side."""
    drive = open_drive(simulated_road)
    source, semantic_map = mask_source("sem", drive), read_map(drive.map_path)
    lines = [e for e in semantic_map.elements if e.label == ElementClass.LANE_MARKING and e.width_m > 0]
    drawn = [resized(e, 0.0, 0.03) for e in lines]
    frames = drive.frames[:6]
    Ts = np.array([drive.truth_at(f) @ rigid.planar_pose(0.0, 0.03 * (-1) ** f.index, 0.0, 0.0) for f in frames])
    pulling = ElementPulls(semantic_map.with_elements(drawn), source.table, PullConfig(range_m=20.0))
    rig = source.seen_by(frames[0].rig.select(source.cameras))
    pulls = [pulling.of(source.masks(f), rig, T) for f, T in zip(frames, Ts, strict=True)]
    found, _ = sized(drawn, pulls, Ts)
    off_m = np.array([new.width_m - true.width_m for new, true in zip(found, lines, strict=True)])
    changed = np.abs(off_m - 0.03) > 0.005
    assert changed.sum() >= 2
    assert np.median(np.abs(off_m[changed])) < 0.004


def test_an_arrow_has_the_box_around_it_and_what_stands_upright_has_none():
    arrow = np.array([[0.0, 0.1], [2.0, 0.1], [2.0, 0.3], [3.0, 0.0], [2.0, -0.3], [2.0, -0.1], [0.0, -0.1]])
    mark = MapElement("a", ElementClass.ROAD_MARK, np.column_stack([arrow, np.zeros(7)]), closed=True)
    assert strip_of(mark)[2:] == pytest.approx((3.0, 0.6))
    assert strip_of(resized(mark, 0.1, -0.05))[2:] == pytest.approx((3.1, 0.55))
    assert strip_of(MapElement("p", ElementClass.POLE, [[0, 0, 0], [0, 0, 3]], radius_m=0.1)) is None
    assert strip_of(MapElement("s", ElementClass.PARKING_SLOT, bar(5.0, 2.5).points, closed=True)) is None
