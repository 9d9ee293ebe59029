"""The network for obstacles: where its cylinder lies, what its cells say, the weights that ship, ONNX."""

import numpy as np
import pytest

from semloc_jax.perception.networks.dense_net import STRIDE
from semloc_jax.perception.networks.obstacle_net import (
    CONFIG,
    FAR,
    HORIZON_V,
    KINDS,
    NEAR,
    OUTPUTS,
    PX_PER_RAD,
    SHIPPED,
    SIZE_PX,
    FoundObstacles,
    ObstacleNet,
    _as_in_strip,
    decoded,
    net_view,
    prepared,
)
from semloc_jax.perception.networks.onnx_graph import write_onnx
from semloc_jax.perception.networks.weights import read_card
from semloc_jax.simulation.cylinder_views.picture import Geometry, cylinder_sample
from tests.perception.four_fisheyes import four_fisheyes


def test_a_place_on_the_road_is_where_its_angles_say():
    """The left camera is 0.9 m over the road at (1.9, 1.0): 4 m to the left and 1 m ahead of it."""
    rig = four_fisheyes()
    view = net_view(rig.cameras[1], np.asarray(rig.T_base_cam[1], np.float64))
    (uv,), (shown,) = view.foot(np.array([[2.9, 5.0, 0.0]]))
    range_m = np.hypot(4.0, 1.0)
    across = 0.5 * (SIZE_PX[0] - 1) + PX_PER_RAD * np.arctan2(1.0, 4.0)
    np.testing.assert_allclose(uv, [across, HORIZON_V + PX_PER_RAD * 0.9 / range_m], atol=1e-3)
    assert shown and view.seen.shape == SIZE_PX[::-1] and view.seen.mean() > 0.6
    picture = prepared(np.full((*SIZE_PX[::-1], 3), 255, np.uint8), HORIZON_V)
    assert picture.max() == 1.0 + 0.0 and picture[int(HORIZON_V), 0, 3] == 0.0 and picture.dtype == np.float32
    assert picture[round(uv[1]), 0, 3] == pytest.approx(0.9 / range_m, abs=0.5 / PX_PER_RAD)


def test_cells_say_class_box_and_foot():
    said = np.zeros((20, 30, len(OUTPUTS)), np.float32)
    said[..., : len(KINDS)] = -8.0
    said[10, 12, 2] = 3.0
    said[10, 12, 4:] = [0.25, -0.5, np.log(2.0), np.log(0.5), 0.1, -0.5, 1.0]
    said[10, 14] = said[10, 12]
    said[10, 14, 2], said[10, 14, 4] = 2.0, -1.75  # the same box, less sure
    found = decoded(said, 0.5)
    assert found.kind.tolist() == [2] and found.has_foot.tolist() == [True]
    # Cell 12 is centred on pixel 49.5: 50.5 with its offset; the box is 32 x 8 px.
    np.testing.assert_allclose(found.box, [[34.5, 35.5, 66.5, 43.5]], atol=1e-4)
    np.testing.assert_allclose(found.foot_uv, [[50.5 + 3.2, 43.5 - 4.0]], atol=1e-4)
    assert found.confidence[0] == pytest.approx(1.0 / (1.0 + np.exp(-3.0)))
    assert len(found.above(0.99).box) == 0


class ByColour(ObstacleNet):
    """Says of red spots that they are cones and of blue ones that they are pillars, all of them 16 x 16 px."""

    def __init__(self, threshold):
        self.threshold = threshold

    def _said(self, picture, horizon_v):
        rows, columns = picture.shape[0] // STRIDE, picture.shape[1] // STRIDE
        cells = np.asarray(prepared(picture, horizon_v)).reshape(rows, STRIDE, columns, STRIDE, 4).mean(axis=(1, 3))
        said = np.zeros((rows, columns, len(OUTPUTS)), np.float32)
        said[..., : len(KINDS)] = -9.0
        for kind, channel in (("cone", 0), ("pillar", 2)):
            said[..., KINDS.index(kind)] = 4.0 * cells[..., channel]
        return said


def test_what_is_low_and_far_is_seen_enlarged():
    """A cone 15 px below the horizon is told by the strip, in which 16 px are 8; one 90 px below it and a pillar are
    told by the whole, in which 16 px are 28."""
    picture = np.zeros((SIZE_PX[1], 320, 3), np.uint8)
    v, u = np.mgrid[: SIZE_PX[1], :320]
    spots = {"far": (81.5, HORIZON_V + 15.0, 2), "near": (161.5, HORIZON_V + 90.0, 2), "pillar": (241.5, 145.5, 0)}
    for at_u, at_v, channel in spots.values():
        near = np.exp(-0.5 * ((u - at_u) ** 2 + (v - at_v) ** 2) / 5.0**2)
        picture[..., channel] = np.maximum(picture[..., channel], 255.0 * near)
    found = ByColour(0.5)(picture)
    assert sorted(KINDS[k] for k in found.kind) == ["cone", "cone", "pillar"]
    assert (np.diff(found.confidence) <= 0.0).all()
    middle, side = 0.5 * (found.box[:, :2] + found.box[:, 2:]), found.box[:, 2:] - found.box[:, :2]
    for name, (*at, _) in spots.items():
        k = int(np.linalg.norm(middle - at, axis=1).argmin())
        look = FAR if name == "far" else NEAR
        assert np.abs(middle[k] - at).max() <= 0.5 * STRIDE / look.scale  # within the cell
        np.testing.assert_allclose(side[k], 16.0 / look.scale, rtol=1e-5)
        np.testing.assert_allclose(found.foot_uv[k], [middle[k, 0], found.box[k, 3]])


def test_pillars_stand_where_the_strip_shows_them():
    """One of two: the other stands too near for the strip."""
    kind = np.full(2, KINDS.index("pillar"))
    near = FoundObstacles(
        kind,
        np.array([[100.0, 0.0, 120.0, HORIZON_V + 35.0], [200.0, 0.0, 260.0, HORIZON_V + 90.0]]),
        np.array([[110.0, HORIZON_V + 34.0], [230.0, HORIZON_V + 85.0]]),
        np.array([False, True]),
        np.array([0.9, 0.8]),
    )
    box = np.array([[101.0, 110.0, 119.0, HORIZON_V + 30.0], [201.0, 110.0, 259.0, HORIZON_V + 47.0]])
    far = near._replace(box=box, foot_uv=near.foot_uv - [0.0, 5.0], has_foot=np.array([True, False]))
    found = _as_in_strip(near, far)
    np.testing.assert_allclose(found.box[0], [101.0, 0.0, 119.0, HORIZON_V + 30.0])
    np.testing.assert_allclose(found.foot_uv[0], far.foot_uv[0])
    np.testing.assert_allclose(found.box[1], near.box[1])
    np.testing.assert_allclose(found.foot_uv[1], near.foot_uv[1])
    assert found.has_foot.all() and near.box[0, 3] == HORIZON_V + 35.0
    nobody = near.where(np.zeros(2, bool))
    np.testing.assert_allclose(_as_in_strip(near, nobody).box, near.box)
    aside = far._replace(box=box + [15.0, 0.0, 15.0, 0.0])
    np.testing.assert_allclose(_as_in_strip(near, aside).box, near.box)


@pytest.mark.parametrize("look", [NEAR, FAR])
def test_a_look_shows_the_horizon_where_it_says_and_leads_back(look):
    picture = np.zeros((SIZE_PX[1], SIZE_PX[0], 3), np.uint8)
    picture[int(HORIZON_V) + 1 :] = 200
    shown = look.at(picture)
    bright = shown[:, 0, 0] / 200.0
    # Row 135 is the first bright one: the edge is half a row below the horizon.
    edge_v = len(shown) - bright.sum() - 0.5
    assert edge_v == pytest.approx(look.horizon_v + 0.5 * look.scale, abs=0.02)
    assert len(shown) == look.height and shown.shape[1] == round(look.scale * SIZE_PX[0])
    assert not any(side % CONFIG.step_px for side in shown.shape[:2])
    assert not any(side % CONFIG.step_px for side in look.at(picture[:, :100]).shape[:2])
    one = FoundObstacles(
        np.zeros(1, int), np.zeros((1, 4)), np.array([[7.0, look.horizon_v]]), np.ones(1, bool), np.ones(1)
    )
    np.testing.assert_allclose(look.back(one).foot_uv, [[7.5 / look.scale - 0.5, HORIZON_V]])


@pytest.fixture(scope="module")
def shipped():
    return ObstacleNet.load()


def test_what_ships_is_small_and_says_what_it_is(shipped):
    assert SHIPPED.stat().st_size < 2.5e6
    card = read_card(SHIPPED)
    assert {"taught_on", "lessons", "limits", "threshold_by"} <= set(card)
    assert card["threshold"] == shipped.threshold and tuple(card["outputs"]) == OUTPUTS
    assert {"random.ap50", "lot_seed4.ap50", "rendered_garage.ap50"} <= set(card["figures"])


def test_onnx_is_the_same_to_1e_4(shipped, tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime")
    write_onnx(tmp_path / "net.onnx", shipped.network, CONFIG.num_outputs, CONFIG.num_inputs, "obstacles")
    session = onnxruntime.InferenceSession(str(tmp_path / "net.onnx"))
    sample = cylinder_sample(np.random.default_rng(5), Geometry(PX_PER_RAD, 128, SIZE_PX[1], HORIZON_V))
    picture = prepared(sample.picture, HORIZON_V)
    (found,) = session.run(None, {"picture": np.asarray(picture).transpose(2, 0, 1)[None]})
    expected = np.asarray(shipped.network(picture))
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(found[0].transpose(1, 2, 0), expected, atol=1e-4, rtol=1e-4)


def test_the_shipped_network_finds_what_is_drawn(shipped):
    """Random views that no lesson showed: most of what is asked for, and hardly anything else."""
    from semloc_jax.learning.obstacle_lesson import judged, mean_precision, shown

    geometry = Geometry(PX_PER_RAD, 256, SIZE_PX[1], HORIZON_V)
    views = [shown(cylinder_sample(np.random.default_rng((77, k)), geometry)) for k in range(12)]
    scores = judged(shipped, views)
    assert sum(own.num_true for own in scores.values()) > 15
    assert mean_precision(scores) > 0.35 and scores["cone"].average_precision > 0.6


def test_what_ships_is_the_same_as_an_onnx_graph(tmp_path):
    """In both of its looks; written with the rows of the horizon beside the colours."""
    onnxruntime = pytest.importorskip("onnxruntime")
    net = ObstacleNet.load()
    write_onnx(tmp_path / "net.onnx", net.network, CONFIG.num_outputs, CONFIG.num_inputs, output="obstacles")
    session = onnxruntime.InferenceSession(str(tmp_path / "net.onnx"))
    picture = np.random.default_rng(3).integers(0, 255, (SIZE_PX[1], 224, 3), np.uint8)
    for look in (NEAR, FAR):
        seen = np.asarray(prepared(look.at(picture), look.horizon_v), np.float32)
        (found,) = session.run(None, {"picture": seen.transpose(2, 0, 1)[None]})
        said = np.asarray(net.network(seen))
        assert np.ptp(said) > 0.1
        np.testing.assert_allclose(found[0].transpose(1, 2, 0), said, atol=1e-3 * np.ptp(said))
