"""Shapes of what is drawn are those that masks show, whatever the pose."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.mapping.element_pulls import ElementPulls, PullConfig, Pulls, pieces_of
from semloc_jax.mapping.joint import place_of
from semloc_jax.mapping.sides import NUM_SIDES, moved_out, side_at, sides_of
from semloc_jax.mapping.sizing import SizeConfig, sized
from semloc_jax.maps import MapElement, SemanticMap, read_map
from semloc_jax.structs import ElementClass

FRAMES = np.array([rigid.planar_pose(x, 0.0, 0.05 * x, 0.0) for x in np.linspace(0.0, 5.0, 6)])
BORDER_SIGMA_M = 0.01


def dash(length_m, width_m):
    x, y = 9.0, 2.0
    points = [[x - 0.5 * length_m, y, 0.0], [x + 0.5 * length_m, y, 0.0]]
    return MapElement("d", ElementClass.LANE_MARKING, points, width_m=width_m, style="dashed")


def bar(length_m, width_m):
    x, y = 0.5 * length_m, 0.5 * width_m
    points = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]]) + [9.0, 2.0, 0.0]
    return MapElement("d", ElementClass.CROSSWALK, points, closed=True)


def arrow(stretch=1.0):
    points = np.array([[0.0, 0.1], [2.0, 0.1], [2.0, 0.3], [3.0, 0.0], [2.0, -0.3], [2.0, -0.1], [0.0, -0.1]])
    points = np.column_stack([9.0 + stretch * points[:, 0], 2.0 + points[:, 1], np.zeros(7)])
    return MapElement("d", ElementClass.ROAD_MARK, points, closed=True)


def pulls_of(drawn, out_m, off=(0.0, 0.0), shown=None):
    """Every frame shows some sides, each so far out, at another place in each frame: its pose is that wrong."""
    sides = sides_of(drawn)
    found = []
    for k, T in enumerate(FRAMES):
        T_base_element = rigid.inverse(T) @ place_of(drawn)
        force, information = np.zeros((1, NUM_SIDES, 6)), np.zeros((1, NUM_SIDES, 6, 6))
        for s in range(len(out_m)) if shown is None else shown:
            n = np.append(sides.outward[s], 0.0)
            for end in (-0.1, 0.1):  # two places on the side, so that it holds a turn
                arm = np.append(sides.middle[s] + end * np.array([-n[1], n[0]]), 0.0) - place_of(drawn)[:3, 3]
                # How far the border goes out where the element moves by its right tangent.
                row = np.concatenate([n, np.cross(arm, n)]) @ np.linalg.inv(rigid.adjoint(T_base_element))
                wanted_m = out_m[s] + n[:2] @ (np.array(off) * (-1) ** k)
                # Moving the element is moving the vehicle the other way: nothing pulls where it is out by wanted_m.
                force[0, s] += row * wanted_m / BORDER_SIGMA_M**2
                information[0, s] += np.outer(row, row) / BORDER_SIGMA_M**2
        found.append(Pulls((drawn.id,), force, information))
    return found


@pytest.mark.parametrize("off", [(0.0, 0.0), (0.04, 0.06)])
@pytest.mark.parametrize(
    ("drawn", "true", "out_m"),
    [
        (dash(4.2, 0.19), dash(4.0, 0.15), [-0.1, -0.1, -0.02, -0.02]),
        (bar(2.9, 0.47), bar(3.0, 0.45), [-0.01, 0.05, -0.01, 0.05]),
    ],
)
def test_a_strip_gets_the_size_that_all_frames_show_whatever_their_poses(drawn, true, out_m, off):
    (found,), left = sized([drawn], pulls_of(drawn, out_m, off), FRAMES)
    # Each side as drawn is believed to 10 cm, six frames to 1 cm each.
    np.testing.assert_allclose(found.points, true.points, atol=1e-3)
    assert found.width_m == pytest.approx(true.width_m, abs=1e-3)
    if off == (0.0, 0.0):
        still = np.abs([each.force for each in left]).max()
        assert still < 0.01 * np.abs([each.side_force for each in left]).max() + 1.0


def test_an_arrow_that_was_drawn_too_long_along_the_way_is_as_long_as_it_looks():
    drawn, true = arrow(1.04), arrow()
    sides, its = sides_of(drawn), sides_of(true)
    out_m = ((its.middle - sides.middle) * sides.outward).sum(axis=1)
    (found,), _ = sized([drawn], pulls_of(drawn, out_m, (0.05, -0.03)), FRAMES)
    length_m = [np.ptp(e.points[:, 0]) for e in (drawn, found, true)]
    assert length_m[0] - length_m[2] > 0.11
    # Its sides keep their directions: a quarter of what it was too long is left.
    assert abs(length_m[1] - length_m[2]) < 0.03
    assert np.ptp(found.points[:, 1]) == pytest.approx(0.6, abs=0.015)


def test_what_frames_show_from_one_side_only_keeps_its_shape():
    drawn = dash(4.2, 0.19)
    for shown in ((0, 2), (1, 3), (0,)):
        (found,), _ = sized([drawn], pulls_of(drawn, [-0.1, -0.1, -0.02, -0.02], shown=shown), FRAMES)
        np.testing.assert_allclose(found.points, drawn.points, atol=1e-3)
        assert found.width_m == pytest.approx(0.19, abs=1e-4)


def test_every_border_belongs_to_a_side_and_a_shape_is_no_motion():
    sides = sides_of(dash(4.0, 0.2))
    np.testing.assert_array_equal(side_at(sides, sides.middle + 0.1, sides.outward), [0, 1, 2, 3])
    sides = sides_of(arrow())
    ring = arrow().points[:, :2]
    third = ring + (np.roll(ring, -1, axis=0) - ring) / 3.0
    np.testing.assert_array_equal(side_at(sides, third, sides.outward), range(7))
    for moved in (np.array([0.3, -0.2]), np.array([1.0, 0.0])):
        np.testing.assert_allclose((sides.outward @ moved) @ sides.shapes, 0.0, atol=1e-9)
    assert sides.shapes.shape == (7, 4)
    out = moved_out(bar(3.0, 0.5), np.array([0.02, 0.1, 0.02, 0.1]))
    np.testing.assert_allclose(out.points, bar(3.2, 0.54).points, atol=1e-9)


def test_what_stands_upright_is_logical_or_has_many_corners_has_no_sides():
    turn = np.linspace(0.0, 2.0 * np.pi, 31)[:-1]
    round_mark = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(30)])
    for element in (
        MapElement("p", ElementClass.POLE, [[0, 0, 0], [0, 0, 3]], radius_m=0.1),
        MapElement("s", ElementClass.PARKING_SLOT, bar(5.0, 2.5).points, closed=True),
        MapElement("r", ElementClass.ROAD_MARK, round_mark, closed=True),
        MapElement("c", ElementClass.CURB, [[0, 0, 0], [5, 0, 0]]),
    ):
        assert sides_of(element) is None
        assert moved_out(element, np.zeros(4)) is element


def test_exact_masks_tell_the_widths_of_a_drawn_road(simulated_road):
    """Lines drawn 3 cm too wide, three frames of a small camera, poses 3 cm off: one step takes most of it out."""
    drive = open_drive(simulated_road)
    source, semantic_map = mask_source("sem", drive), read_map(drive.map_path)
    painted = [e for e in semantic_map.elements if e.label == ElementClass.LANE_MARKING and e.width_m > 0]
    lines = [piece for element in painted for piece in pieces_of(element)]
    drawn = [replace(e, width_m=e.width_m + 0.03) for e in lines]
    frames = drive.frames
    Ts = np.array([drive.truth_at(f) @ rigid.planar_pose(0.0, 0.03 * (-1) ** f.index, 0.0, 0.0) for f in frames])
    pulling = ElementPulls(SemanticMap(tuple(drawn)), source.table, PullConfig())
    rig = source.seen_by(frames[0].rig.select(source.cameras))
    pulls = [pulling.of(source.masks(f), rig, T) for f, T in zip(frames, Ts, strict=True)]
    found, _ = sized(drawn, pulls, Ts, SizeConfig(min_frames=1))
    off_m = np.array([new.width_m - true.width_m for new, true in zip(found, lines, strict=True)])
    changed = np.abs(off_m - 0.03) > 0.005
    assert changed.sum() >= 5
    assert np.median(np.abs(off_m[changed])) < 0.012
    assert np.abs(off_m[changed]).max() < 0.02
