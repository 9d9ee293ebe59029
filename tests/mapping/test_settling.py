"""Elements are laid where the frames have them, whatever one frame says, and lines bend piece by piece."""

import numpy as np

from semloc_jax.geometry import rigid
from semloc_jax.mapping.element_pulls import Pulls, pieces_of
from semloc_jax.mapping.joint import place_of
from semloc_jax.mapping.settling import SettleConfig, settled
from semloc_jax.mapping.slots import Divider
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

FRAMES = np.array([rigid.planar_pose(float(x), 0.3 * np.sin(x), 0.1 * np.cos(x), 0.0) for x in range(6)])
INFORMATION = np.diag([4e4, 4e4, 1e4, 1e3, 1e3, 4e4])
ONCE = SettleConfig(rounds=1)


def line(points, name="slot_line_0"):
    return MapElement(name, ElementClass.SLOT_LINE, points, width_m=0.1)


def told_by(true_of, frames=FRAMES, information=INFORMATION):
    """Holds exact frames against elements: the vehicle is pulled to where the element would lie right."""

    def pulls_at(elements, reach_px):
        found = []
        for T_map_base in frames:
            force = []
            for element in elements:
                there, here = place_of(true_of(element)), place_of(element)
                there[:2, :2] = turn_of(element, true_of(element))
                T_seen = rigid.inverse(there) @ T_map_base
                force.append(information @ rigid.log(rigid.inverse(T_seen) @ rigid.inverse(here) @ T_map_base))
            ids, of_each = [e.id for e in elements], np.array([information] * len(elements))
            found.append(Pulls.of_wholes(ids, np.array(force), of_each))
        return found

    return pulls_at


def turn_of(old, new):
    before, after = (e.points[-1, :2] - e.points[0, :2] for e in (old, new))
    angle = np.arctan2(after[1], after[0]) - np.arctan2(before[1], before[0])
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def test_an_element_goes_where_all_frames_have_it():
    true = line([[3.0, 2.0, 0.0], [3.2, 6.0, 0.0]])
    T = rigid.planar_pose(0.05, -0.03, 0.004, 0.0)
    drawn = true.with_points(true.points @ T[:3, :3].T + T[:3, 3])
    (found,) = settled([drawn], told_by(lambda _: true), FRAMES, ONCE)
    assert np.abs(drawn.points - true.points).max() > 0.025
    # The place where it was drawn is believed to 10 cm, six frames to 2 mm together.
    np.testing.assert_allclose(found.points, true.points, atol=1e-3)


def test_one_frame_that_is_wrong_does_not_take_it_along():
    true = line([[3.0, 2.0, 0.0], [3.2, 6.0, 0.0]])

    def pulls_at(elements, reach_px):
        pulls = told_by(lambda _: true)(elements, reach_px)
        off = INFORMATION @ np.array([0.3, 0.3, 0.0, 0.0, 0.0, 0.0])
        last = pulls[-1]
        return [*pulls[:-1], Pulls.of_wholes(last.ids, last.force + off, last.information)]

    (found,) = settled([true], pulls_at, FRAMES, ONCE)
    # Least squares would put it a sixth of 42 cm aside.
    assert np.linalg.norm(found.points - true.points, axis=1).max() < 0.015


def test_what_two_frames_pull_stays():
    drawn, true = line([[3.0, 2.0, 0.0], [3.2, 6.0, 0.0]]), line([[3.05, 2.0, 0.0], [3.25, 6.0, 0.0]])
    (found,) = settled([drawn], told_by(lambda _: true, FRAMES[:2]), FRAMES[:2], ONCE)
    assert found is drawn


def test_a_long_line_bends_piece_by_piece():
    """24 m drawn straight that lie on an arc with 9 cm of rise: 1 cm is left, from 9."""
    x = np.linspace(0.0, 24.0, 25)
    drawn = line(np.column_stack([x, np.full(25, 2.0), np.zeros(25)]))
    rise = lambda x: 2.0 + 0.09 * (1.0 - ((x - 12.0) / 12.0) ** 2)  # noqa: E731

    def true_of(piece):
        points = piece.points.copy()
        points[:, 1] = rise(points[:, 0])
        # The chord of the piece at its mean place: what a rigid body may do.
        slope = (points[-1, 1] - points[0, 1]) / (points[-1, 0] - points[0, 0])
        points[:, 1] = points[:, 1].mean() + slope * (points[:, 0] - points[:, 0].mean())
        return piece.with_points(points)

    (found,) = settled([drawn], told_by(true_of), FRAMES, ONCE)
    assert len(pieces_of(drawn)) == 6
    assert np.abs(found.points[:, 1] - rise(x)).max() < 0.01
    assert np.abs(found.points[:, 0] - x).max() < 0.002


def test_a_divider_goes_with_its_line():
    old, T = line([[3.0, 2.0, 0.0], [3.0, 7.0, 0.0]]), rigid.planar_pose(0.02, -0.03, 0.01, 0.0)
    new = old.with_points(old.points @ T[:3, :3].T + T[:3, 3])
    divider = Divider(old.id, np.array([3.1, 2.1]), np.array([0.0, 1.0]), 5.0, True, 0.0)
    moved = divider.moved_with(old, new)
    np.testing.assert_allclose(moved.mouth, T[:2, :2] @ divider.mouth + T[:2, 3], atol=1e-9)
    np.testing.assert_allclose(moved.inward, T[:2, :2] @ divider.inward, atol=1e-9)
    longer = new.with_points(new.points + np.array([[0.0, -0.04, 0.0], [0.0, 0.04, 0.0]]))
    moved = divider.moved_with(old, longer)
    np.testing.assert_allclose(moved.mouth, T[:2, :2] @ divider.mouth + T[:2, 3] - [0.0, 0.04], atol=1e-3)
