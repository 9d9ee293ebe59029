"""AVP-SLAM on a ring: its loops are the true ones and tie the way down; what speaks against a match is told."""

import numpy as np
import pytest

from semloc_jax.geometry import rigid
from semloc_jax.mapping.chain_graph import Start, solve_chain
from semloc_jax.mapping.literature.avp import AvpConfig, matched
from semloc_jax.mapping.literature.point_loops import loops_by
from semloc_jax.mapping.revisits import Revisit
from semloc_jax.reports.literature import side_by_side, true_loops
from semloc_jax.reports.map_judgement import loop_metrics
from semloc_jax.structs import ElementClass
from tests.mapping.ring_of_points import LAP, NUM, ring_maps

CONFIG = AvpConfig()


@pytest.fixture(scope="module")
def ring():
    return ring_maps()


def away_m(Ts, poses):
    return np.linalg.norm((Ts - poses)[:, :2, 3], axis=1)


def test_local_maps_are_carried_by_odometry(ring):
    maps, poses, _ = ring
    local = maps.around(10, 10.0, 30.0)
    whole = maps.in_map(poses)
    back = local.moved(poses[10])
    gap_m = [np.min(np.linalg.norm(whole.xy - point, axis=1)) for point in back.xy[::25]]
    assert np.median(gap_m) < 0.12
    assert set(np.unique(local.label)) == {int(ElementClass.SLOT_LINE), int(ElementClass.ROAD_MARK)}
    assert len(maps.around(10, 200.0, 300.0).xy) == 0


@pytest.mark.slow
def test_loops_of_a_ring_are_true_and_tie_the_way_down(ring):
    maps, poses, chain = ring
    start = Start(poses[0], np.diag(np.repeat([1e-3, 1e-4], 3) ** 2))

    def solve(loops):
        return solve_chain(chain, loops, start=start)

    found, solution = loops_by(lambda revisit, T: matched(maps, revisit, T, CONFIG), chain, solve)
    told = {metric.key: metric.value for metric in loop_metrics(found, poses)}
    assert told["loops.accepted"] >= 3
    assert told["loops.false"] == 0
    assert told["loops.error.max"] < 0.2
    without = away_m(solve(true_loops([], poses)).Ts_map_base, poses)
    tied = away_m(solution.Ts_map_base, poses)
    best = away_m(solve(true_loops(found, poses)).Ts_map_base, poses)
    rmse = [float(np.sqrt(np.mean(part**2))) for part in (without, tied, best)]
    # Local maps bend with the odometry: their matches help, and stay far from what the true motions would give.
    assert rmse[2] < rmse[1] < 0.8 * rmse[0]


def test_another_place_is_no_loop(ring):
    maps, _, _ = ring
    a, b = 5, 5 + LAP + LAP // 2
    revisit = Revisit(a, b, (b - 1, b, b + 1), np.eye(6))
    loop = matched(maps, revisit, np.eye(4), CONFIG)
    assert not loop.is_accepted
    assert "of the points have a partner" in loop.reasons[0]


def test_a_class_alone_is_no_loop(ring):
    maps, poses, chain = ring
    one = [part._replace(label=np.zeros_like(part.label)) for part in maps.points]
    a, b = 10, 10 + LAP
    T_a_b = rigid.inverse(poses[a]) @ poses[b]
    revisit = Revisit(a, b, (b - 1, b, b + 1), np.eye(6))
    blind = matched(type(maps)(chain, maps.frames, one, maps.config), revisit, T_a_b, CONFIG)
    assert blind.reasons == ("1 classes have partners",)
    assert matched(maps, revisit, T_a_b, CONFIG).is_accepted
    empty = type(maps)(chain, maps.frames[:3], maps.points[:3], maps.config)
    assert matched(empty, revisit, T_a_b, CONFIG) is None


def test_the_table_has_a_column_for_each_way_and_leaves_out_what_nobody_has(ring):
    from semloc_jax.evaluation import Metric

    columns = {"avp": [Metric("horizontal.rmse", 0.1234, "m"), Metric("loops.false", 2.0, "loops")], "ours": []}
    text = side_by_side(columns)
    assert [line.split()[-2:] for line in text.splitlines()] == [["avp", "ours"], ["0.123", "-"], ["2", "-"]]


def test_true_loops_leave_out_pairs_that_are_far_apart(ring):
    _, poses, _ = ring
    from semloc_jax.mapping.found_loops import FoundLoop

    near, far = (FoundLoop(a, b, np.eye(4), np.eye(6), 0.0, ("x",)) for a, b in ((3, 3 + LAP), (0, LAP // 2)))
    loops = true_loops([near, near, far], poses)
    assert loops.a.tolist() == [3]
    np.testing.assert_allclose(poses[3] @ loops.Ts_a_b[0], poses[3 + LAP], atol=1e-9)
    assert NUM > 2 * LAP
