"""The dense network: where its cells are, that it is the same as ONNX, that its weights come back."""

import dataclasses
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.perception.networks.dense_net import STRIDE, DenseNet, DenseNetConfig, filled_up
from semloc_jax.perception.networks.onnx_graph import write_onnx
from semloc_jax.perception.networks.operations import JAX
from semloc_jax.perception.networks.weights import load_weights, read_card, save_weights
from semloc_jax.storage import write_npz

SMALL = DenseNetConfig(num_outputs=5, detail=2, num_channels=(8, 12, 16), num_blocks=(1, 1, 1), num_dense=2)


def net_of(seed=0):
    """A network all of whose weights say something."""
    net = DenseNet.create(jax.random.key(seed), SMALL)
    leaves, structure = jax.tree.flatten(net)
    rng = np.random.default_rng(seed)
    return jax.tree.unflatten(structure, [x + 0.1 * rng.standard_normal(x.shape).astype(np.float32) for x in leaves])


@pytest.fixture(scope="module")
def picture():
    return np.random.default_rng(1).random((48, 80, 3)).astype(np.float32)


@pytest.mark.parametrize("border_px", [23.0, 23.4, 25.5, 26.1])
def test_an_edge_stays_where_it_is_through_down_and_up(border_px):
    """Blocks averaged to stride 4 and 8, and up to 4 again: the border is found to 0.01 px in each (a ramp wide
    enough to be sampled; half a pixel forgotten would be 0.5 px and more)."""
    ramp = np.clip((np.arange(64) - border_px) / 24.0, -1.0, 1.0)
    x = jnp.asarray(np.broadcast_to(ramp[:, None], (64, 64, 1)))
    means = {}
    at_4 = JAX.to_depth(x, STRIDE).mean(-1, keepdims=True)
    at_8 = JAX.to_depth(at_4, 2).mean(-1, keepdims=True)
    for name, stride, found in (("4", 4, at_4), ("8", 8, at_8), ("8 up", 4, JAX.twice(at_8))):
        row = np.asarray(found[2, :, 0])
        centres = stride * np.arange(len(row)) + (stride - 1) / 2
        k = int(np.flatnonzero(np.diff(np.sign(row)))[0])
        means[name] = centres[k] - row[k] * stride / (row[k + 1] - row[k])
    assert means == pytest.approx(dict.fromkeys(means, border_px), abs=0.01)


def test_blocks_of_cells_come_back(picture):
    np.testing.assert_array_equal(JAX.from_depth(JAX.to_depth(jnp.asarray(picture), 4), 4), picture)


def test_twice_keeps_a_plane(picture):
    """A plane over the cells is the same plane over cells half as large, but for the border."""
    v, u = np.mgrid[:6, :9]
    coarse = jnp.asarray((0.3 * u - 0.7 * v)[..., None])
    v, u = np.mgrid[:12, :18]
    expected = 0.3 * (u + 0.5) / 2 - 0.15 - 0.7 * ((v + 0.5) / 2 - 0.5)
    np.testing.assert_allclose(JAX.twice(coarse)[1:-1, 1:-1, 0], expected[1:-1, 1:-1], atol=1e-6)


def test_depthwise_is_a_grouped_convolution(picture):
    x = jnp.asarray(picture)
    kernel = np.random.default_rng(2).standard_normal((3, 3, 3))
    numbers, weights = ("NHWC", "HWIO", "NHWC"), jnp.asarray(kernel[:, :, None], x.dtype)
    (expected,) = jax.lax.conv_general_dilated(
        x[None], weights, (1, 1), "SAME", dimension_numbers=numbers, feature_group_count=3
    )
    np.testing.assert_allclose(JAX.depthwise(x, jnp.asarray(kernel), jnp.zeros(3)), expected, atol=1e-5)


def test_a_new_network_says_nothing_and_learns_everywhere(picture):
    net = DenseNet.create(jax.random.key(0), SMALL)
    assert np.all(np.asarray(net(jnp.asarray(picture))) == 0.0)
    moved = eqx.tree_at(lambda n: n.head.kernel, net, net.head.kernel + 0.1)
    slope = jax.jit(jax.grad(lambda n: jnp.mean((n(jnp.asarray(picture)) - 1.0) ** 2)))(moved)
    # A block begins as the identity: only its second layer has a slope before the first step.
    for block in (*(block for level in slope.blocks for block in level), slope.merged):
        assert max(float(jnp.abs(leaf).max()) for leaf in jax.tree.leaves(block.second)) > 0.0
    for layer in (*slope.into, *slope.up, slope.head):
        assert float(jnp.abs(layer.kernel).max()) > 0.0


def test_onnx_is_the_same_to_1e_4(tmp_path, picture):
    onnxruntime = pytest.importorskip("onnxruntime")
    net = net_of()
    write_onnx(tmp_path / "net.onnx", net, SMALL.num_outputs)
    session = onnxruntime.InferenceSession(str(tmp_path / "net.onnx"))
    for size in ((48, 80), (64, 32)):
        batch = np.random.default_rng(3).random((2, *size, 3)).astype(np.float32)
        (found,) = session.run(None, {"picture": batch.transpose(0, 3, 1, 2)})
        expected = jax.vmap(net)(jnp.asarray(batch))
        assert np.ptp(np.asarray(expected)) > 0.1
        np.testing.assert_allclose(found.transpose(0, 2, 3, 1), expected, atol=1e-4)


def test_pictures_of_any_size_are_filled_up():
    picture = jnp.arange(2 * 3 * 3.0).reshape(2, 3, 3)
    filled = filled_up(picture, 4)
    assert filled.shape == (4, 4, 3)
    np.testing.assert_array_equal(filled[:2, :3], picture)
    np.testing.assert_array_equal(filled[3, 3], picture[1, 2])


def test_weights_come_back_with_their_card(tmp_path, picture):
    path, net = tmp_path / "a.weights", net_of()
    save_weights(path, net, {"kind": "test", "classes": ["pole"]})
    assert read_card(path) == {"kind": "test", "classes": ["pole"]}
    back = load_weights(path, DenseNet.create(jax.random.key(5), SMALL))
    np.testing.assert_allclose(back(jnp.asarray(picture)), net(jnp.asarray(picture)), rtol=1e-4, atol=1e-4)


def test_weights_that_do_not_fit_are_refused(tmp_path):
    path, net = tmp_path / "a.weights", net_of()
    save_weights(path, net, {})
    with pytest.raises(SemlocError, match=r"into\.0\.kernel is float32\[1, 1, 48, 8\]; expected finite float32"):
        load_weights(path, DenseNet.create(jax.random.key(0), dataclasses.replace(SMALL, num_channels=(9, 12, 16))))
    lower = dataclasses.replace(SMALL, num_channels=(8, 12), num_blocks=(1, 1))
    with pytest.raises(SemlocError, match="arrays are not those of such a network"):
        load_weights(path, DenseNet.create(jax.random.key(0), lower))
    save_weights(path, eqx.tree_at(lambda n: n.head.bias, net, jnp.full(20, np.nan)), {})
    with pytest.raises(SemlocError, match=r"head\.bias is float32\[20\]; expected finite"):
        load_weights(path, net)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(SemlocError, match="content is not what such a file holds"):
        load_weights(path, net)
    with pytest.raises(SemlocError, match=r"none\.weights: no such file"):
        read_card(tmp_path / "none.weights")
    write_npz(path, {"card": np.frombuffer(json.dumps([1]).encode(), np.uint8)})
    with pytest.raises(SemlocError, match="its card is a list"):
        read_card(path)
