"""The network for obstacles: where its cylinder lies, what its cells say, the weights that ship, ONNX."""

import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.perception.networks.obstacle_net import (
    CONFIG,
    HORIZON_V,
    KINDS,
    OUTPUTS,
    PX_PER_RAD,
    SHIPPED,
    SIZE_PX,
    ObstacleNet,
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
    assert picture.max() == 1.0 + 0.0 and picture[int(HORIZON_V), 0, 3] == 0.0
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
    (found,) = session.run(None, {"picture": picture.transpose(2, 0, 1)[None]})
    expected = np.asarray(shipped.network(jnp.asarray(picture)))
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
