"""What masks say of single elements leads back to where the vehicle is."""

import numpy as np

from semloc_jax.datasets import open_drive
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.mapping.element_pulls import ElementPulls, PullConfig, pieces_of
from semloc_jax.maps import MapElement, read_map
from semloc_jax.structs import ElementClass


def test_pulls_lead_back_to_the_pose_and_name_what_was_moved(simulated_road):
    """Off by 5 cm to the side and 0.2 deg in exact masks: two steps lead back to 1 cm and 0.05 deg.

    With one line moved instead, its own pull says so, and the others say nothing.
    """
    drive = open_drive(simulated_road)
    frame, source = drive.frames[1], mask_source("sem", drive)
    semantic_map, T_true = read_map(drive.map_path), drive.truth_at(frame)
    masks, rig = source.masks(frame), source.seen_by(frame.rig.select(source.cameras))
    config = PullConfig(range_m=30.0)
    pulling = ElementPulls(semantic_map, source.table, config)
    prior = np.diag(1.0 / np.array([0.3, 0.5, 0.02, 0.002, 0.002, 0.05]) ** 2)
    T, left = T_true @ rigid.exp(np.array([0.0, 0.05, 0.0, 0.0, 0.0, np.deg2rad(0.2)])), []
    for _ in range(2):
        pulls = pulling.of(masks, rig, T)
        T = T @ rigid.exp(-np.linalg.solve(pulls.information.sum(axis=0) + prior, pulls.force.sum(axis=0)))
        left.append(rigid.log(rigid.inverse(T_true) @ T))
    assert abs(left[0][1]) < 0.02
    assert abs(left[1][1]) < 0.01
    assert abs(np.rad2deg(left[1][5])) < 0.05

    at_truth = pulling.of(masks, rig, T_true)
    sure = max(at_truth.ids, key=lambda name: at_truth.information[at_truth.ids.index(name), 1, 1])
    left_m = 0.05 * T_true[:3, 1]
    moved = [e.with_points(e.points + left_m) if e.id == sure else e for e in semantic_map.elements]
    pulls = ElementPulls(semantic_map.with_elements(moved), source.table, config).of(masks, rig, T_true)
    own = pulls.ids.index(sure)
    # To see the moved line where the mask has it, the vehicle would have to stand 5 cm farther left.
    told_m = -pulls.force[own, 1] / pulls.information[own, 1, 1]
    assert 0.03 < told_m < 0.07
    rest = [k for k in range(len(pulls.ids)) if k != own]
    information = pulls.information[rest].sum(axis=0)[1, 1]
    assert abs(pulls.force[rest].sum(axis=0)[1] / information) < 0.01


def test_a_straight_line_holds_nothing_along_itself(simulated_road):
    """Rough masks: along a line without ends no more than a thousandth of what it holds across (half of the information
    along a road was of this kind), and what is seen of all else leads 6 cm back along the road in two steps."""
    drive = open_drive(simulated_road)
    frame, source = drive.frames[1], mask_source("sem_net", drive)
    semantic_map, T_true = read_map(drive.map_path), drive.truth_at(frame)
    masks, rig = source.masks(frame), source.seen_by(frame.rig.select(source.cameras))
    pieces = [p for e in semantic_map.elements if not e.is_logical for p in pieces_of(e)]
    pulling = ElementPulls(semantic_map.with_elements(pieces), source.table, PullConfig(range_m=30.0, by_contours=True))
    T = T_true @ rigid.exp(np.array([0.06, 0.0, 0.0, 0.0, 0.0, 0.0]))
    pulls, by_id = pulling.of(masks, rig, T), {piece.id: piece for piece in pieces}
    lines = [k for k, name in enumerate(pulls.ids) if by_id[name].style == "solid" and not any(by_id[name].true_ends)]
    assert len(lines) >= 4
    for k in lines:
        piece = by_id[pulls.ids[k]]
        along = T[:3, :3].T @ (piece.points[-1] - piece.points[0])
        along = np.append(along / np.linalg.norm(along), np.zeros(3))
        across = np.array([-along[1], along[0], 0.0, 0.0, 0.0, 0.0])
        information = pulls.information[k]
        assert along @ information @ along < 1e-3 * (across @ information @ across)
    prior, left = np.diag(1.0 / np.array([1.0, 0.5, 0.02, 0.002, 0.002, 0.05]) ** 2), []
    for _ in range(2):
        pulls = pulling.of(masks, rig, T)
        T = T @ rigid.exp(-np.linalg.solve(pulls.information.sum(axis=0) + prior, pulls.force.sum(axis=0)))
        left.append(rigid.log(rigid.inverse(T_true) @ T)[0])
    print("along, after one and two steps [m]", left)
    assert abs(left[1]) < 0.015


def test_long_lines_move_in_pieces():
    line = MapElement("l", ElementClass.LANE_MARKING, [[0.0, 0.0, 0.0], [21.0, 0.0, 0.0]], true_ends=(True, False))
    pieces = pieces_of(line)
    assert [piece.id for piece in pieces] == [f"l.{k}" for k in range(6)]
    assert [piece.true_ends for piece in pieces] == [(True, False), *[(False, False)] * 5]
    np.testing.assert_allclose([p.points[[0, -1], 0] for p in pieces], [[3.5 * k, 3.5 * k + 3.5] for k in range(6)])
    short = MapElement("d", ElementClass.LANE_MARKING, [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]], style="dashed")
    assert pieces_of(short) == [short]
