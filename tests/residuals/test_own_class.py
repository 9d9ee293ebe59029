"""A sample is scored by the mask of its own class only: paint never feels a pole, however near it is in the image."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.geometry import lie
from semloc_jax.perception import load_class_table
from semloc_jax.perception.cost_maps import cost_maps
from semloc_jax.residuals.alignment import Usable, alignment_residual, camera_views
from semloc_jax.residuals.normal_equations import normal_equations
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.scoring import robust_cost
from semloc_jax.residuals.texture import pack
from semloc_jax.simulation.cameras import mounted
from semloc_jax.structs import ElementClass, ViewSamples

RIG = Rig(
    [PinholeCamera(180.0, 180.0, 119.5, 74.5, 240, 150)], mounted((1.6, 0.0, 1.4), 0.0, 5.0, 0.0)[None], ["front"]
)
compiled_residual = eqx.filter_jit(alignment_residual)
compiled_normal_equations = eqx.filter_jit(normal_equations)
compiled_cost = eqx.filter_jit(robust_cost)
TABLE = load_class_table("drive")
ROAD, LANE, POLE, SIGN = 1, 10, 20, 21


def views_of(label, weight=1.0):
    """A grid of samples of one class over the road in view."""
    x, y = np.meshgrid(np.linspace(4.0, 12.0, 20), np.linspace(-1.5, 1.5, 10))
    p_map = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    samples = ViewSamples(
        jnp.asarray(p_map[None]),
        jnp.zeros((1, *p_map.shape)),
        jnp.full((1, x.size), TABLE.channel_of(label)),
        jnp.full((1, x.size), weight),
        jnp.zeros((1, x.size), int),
        jnp.zeros((1, x.size), int),
    )
    return camera_views(RIG, samples)


def evidence_of(mask_id, background=ROAD):
    """Cost maps of a mask with a broad upright stripe of one class."""
    mask = np.full((150, 240), background, np.uint8)
    mask[:, 100:140] = mask_id
    maps = cost_maps([mask], TABLE)
    return pack(maps, jnp.float64), Usable(jnp.asarray(maps.usable), maps.usable_stride)


def cost_of(views, textures, usable):
    cost = compiled_cost(jnp.eye(4), views, textures.level(1), usable, LOSSES["tukey"], 2.0)
    return float(cost.summed), float(cost.visible)


@pytest.mark.parametrize("mask_id", [POLE, SIGN])
def test_paint_feels_no_mask_of_another_class(mask_id):
    textures, usable = evidence_of(mask_id)
    views = views_of(ElementClass.LANE_MARKING)
    for level in range(4):
        r, _ = compiled_residual(jnp.eye(4), views, textures.level(level))
        assert np.array_equal(r, np.ones(200))
    slopes = compiled_normal_equations(jnp.eye(4), views, textures.level(0), LOSSES["squared"])
    assert np.array_equal(slopes.hessian, np.zeros((6, 6))) and np.array_equal(slopes.gradient, np.zeros(6))
    summed, visible = cost_of(views, textures, usable)
    assert visible > 100
    assert summed == pytest.approx(visible, rel=1e-12)


def test_the_same_samples_feel_the_mask_of_their_own_class():
    textures, usable = evidence_of(POLE)
    r, _ = compiled_residual(jnp.eye(4), views_of(ElementClass.POLE), textures.level(0))
    assert np.mean(np.abs(r) < 0.9) > 0.5
    slopes = compiled_normal_equations(jnp.eye(4), views_of(ElementClass.POLE), textures.level(0), LOSSES["squared"])
    assert float(jnp.linalg.norm(slopes.gradient)) > 1.0
    summed, visible = cost_of(views_of(ElementClass.POLE), textures, usable)
    assert summed < 0.95 * visible


def test_both_kinds_of_lane_paint_are_one_class():
    """The mask's lane_solid (10) and lane_dashed (11) are one evidence for the map's lane markings."""
    (solid, _), (dashed, _) = evidence_of(10), evidence_of(11)
    views = views_of(ElementClass.LANE_MARKING)
    for level in range(4):
        assert np.array_equal(
            compiled_residual(jnp.eye(4), views, solid.level(level))[0],
            compiled_residual(jnp.eye(4), views, dashed.level(level))[0],
        )


@pytest.mark.parametrize("hidden_by", [7, 8, 255], ids=["vehicle", "ego", "unlabelled"])
def test_what_lies_behind_moving_things_is_not_visible(hidden_by):
    mask = np.full((150, 240), ROAD, np.uint8)
    mask[:, :119] = hidden_by
    maps = cost_maps([mask], TABLE)
    views = views_of(ElementClass.LANE_MARKING)
    _, visible = cost_of(views, pack(maps, jnp.float64), Usable(jnp.asarray(maps.usable), maps.usable_stride))
    everything = cost_of(views, *evidence_of(LANE))[1]
    assert 0.4 * everything < visible < 0.55 * everything


@jax.jit
def squared_and_slope(xi, views, texture):
    def value(xi):
        return jnp.sum(alignment_residual(lie.exp(xi), views, texture)[0] ** 2)

    return jax.value_and_grad(value)(xi)


def test_masks_of_one_class_all_over_and_nothing_at_all_have_finite_slopes():
    views = views_of(ElementClass.LANE_MARKING)
    for filled in (LANE, ROAD, 255):
        maps = cost_maps([np.full((150, 240), filled, np.uint8)], TABLE)
        value, slope = squared_and_slope(jnp.zeros(6), views, pack(maps, jnp.float64).level(0))
        assert np.isfinite(value) and np.isfinite(slope).all()
