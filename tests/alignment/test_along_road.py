"""How sure a pose is along the road: against the posterior integrated on a grid, and as the drawn street says.

The street is drawn by OpenCV from the lines of the map: only what is painted can leave a pose open.
"""

from functools import partial

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.along_road import AlongRoadConfig, beyond_reach, weighed_along_road, widened
from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.hypotheses import prior_cost
from semloc_jax.alignment.pieces import chances, nats_by_piece, piece_costs, pieces_of
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.proposals import displaced
from semloc_jax.alignment.single_frame import SingleFrameConfig, evidence_from
from semloc_jax.alignment.tracking_step import TrackAlignConfig, valley_along
from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Frame
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.perception import load_class_table
from semloc_jax.simulation.cameras import mounted
from semloc_jax.structs import ElementClass, SolveStatus
from tests.compiling import jit_quickly

RIG = Rig(
    [PinholeCamera(740.0, 742.0, 478.0, 296.0, 960, 600)], mounted((1.6, 0.0, 1.4), 0.0, 3.0, 0.0)[None], ["front"]
)
X_TRUE, SIGMA_M = 20.0, 1.0
TABLE = load_class_table("drive")
IDS = {ElementClass.LANE_MARKING: 10, ElementClass.STOP_LINE: 12}


def across(at_m, width_m):
    """A stop line over the lane, `at_m` in front of the vehicle."""
    ends = np.array([[X_TRUE + at_m, -1.7, 0.0], [X_TRUE + at_m, 1.8, 0.0]])
    return MapElement(f"stop {at_m}", ElementClass.STOP_LINE, ends, width_m=width_m)


def street(*more):
    lines = [
        MapElement(f"line {y}", ElementClass.LANE_MARKING, np.array([[-60.0, y, 0.0], [140.0, y, 0.0]]), width_m=0.15)
        for y in (-1.8, 1.9)
    ]
    # One out of sight behind, so that every street has the same channels and shares one compiled program.
    return SemanticMap((*lines, across(-75.0, 0.4), *more))


def drawn(semantic_map):
    """The mask of the street from the true pose; every strip of paint as a polygon, finely divided."""
    T_cam_map = np.linalg.inv(
        np.array([[1, 0, 0, X_TRUE], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]) @ RIG.T_base_cam[0]
    )
    mask = np.ones((600, 960), np.uint8)
    for element in semantic_map.elements:
        along = np.linspace(element.points[0], element.points[-1], 4000)
        aside = np.cross([0.0, 0.0, 1.0], element.points[-1] - element.points[0])
        aside *= 0.5 * element.width_m / np.linalg.norm(aside)
        p = np.concatenate([along + aside, (along - aside)[::-1]]) @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]
        p = p[p[:, 2] > 0.5]
        if not len(p):
            continue
        uv = np.stack([740.0 * p[:, 0] / p[:, 2] + 478.0, 742.0 * p[:, 1] / p[:, 2] + 296.0], axis=1)
        cv2.fillPoly(mask, [np.round(uv * 16).astype(np.int32)], IDS[element.label], shift=4)
    return mask


def localized(semantic_map, x_prior=X_TRUE + 0.8):
    localizer = FrameLocalizer(semantic_map, TABLE)
    prior = PosePrior(x_prior, 0.4, np.radians(1.0), SIGMA_M, np.radians(2.0))
    frame = Frame(0, "0", 0.0, "", RIG, {})
    with jax.enable_x64(False):
        return localizer.localize(frame, [drawn(semantic_map)], prior)


@pytest.mark.slow
def test_lines_alone_say_nothing_along_the_road():
    """Nothing but the prior holds the pose along solid lines, and the pose says so."""
    result = localized(street())
    best = result.modes[0]
    assert result.status == SolveStatus.WEAK_DIRECTION and not result.localized
    assert best.sigma_longitudinal_m == pytest.approx(SIGMA_M, rel=0.25)
    assert best.sigma_lateral_m < 0.08
    assert abs(result.T_map_base[1, 3]) < 0.03


@pytest.mark.slow
def test_a_near_stop_line_holds_the_pose():
    result = localized(street(across(8.0, 0.4)))
    assert result.localized, result.reasons
    assert abs(result.T_map_base[0, 3] - X_TRUE) < 0.05
    assert result.modes[0].sigma_longitudinal_m < 0.15


@partial(jit_quickly, static_argnames="align")
def _cost_of(Ts, evidence, align):
    """Cost [nats] of every pose on level 2, with what the masks are like told by the best of them."""
    piece_of, channel = pieces_of(evidence, align)
    costs = jax.lax.map(lambda T: piece_costs(T, 2, evidence, piece_of, align), Ts, batch_size=256)
    best = jnp.argmin(jnp.sum(costs.nats * costs.observations, axis=1))
    elsewhere = displaced(Ts[best], jnp.asarray([[-4.0, 0.8, 0.1], [3.0, -1.6, 0.2], [5.0, 4.0, -0.2]]))
    at_random = jax.lax.map(lambda T: piece_costs(T, 2, evidence, piece_of, align), elsewhere)
    num_channels = evidence.textures.num_channels
    masks = chances(jax.tree.map(lambda leaf: leaf[best], costs), at_random, channel, num_channels)
    return jnp.sum(nats_by_piece(costs, channel, masks), axis=1)


@pytest.mark.parametrize("at_m", [8.0, 22.0, 34.0])
def test_the_spread_is_that_of_the_posterior_on_a_grid(at_m):
    """Oracle: the same cost summed over a grid of places, sides and headings around the truth, without any solver."""
    semantic_map, config = street(across(at_m, 0.4)), SingleFrameConfig()
    localizer = FrameLocalizer(semantic_map, TABLE)
    prior = PosePrior(X_TRUE + 0.5, 0.0, 0.0, SIGMA_M, np.radians(0.3))
    with jax.enable_x64(False):
        T_prior = prior.on_road(semantic_map)
        frame, local_map = localizer.prepare([drawn(semantic_map)], RIG, T_prior)
        locked = prior.to_solver(T_prior, local_map.frame, localizer.config.road)
        # Height, roll and pitch stay where they are: a grid of six dimensions would have too many places.
        locked = eqx.tree_at(lambda p: p.sigma, locked, locked.sigma.at[2:5].set(0.0))
        T_true = jnp.eye(4).at[:3, 3].set(local_map.frame.from_map(np.array([X_TRUE, 0.0, 0.0])))
        evidence = evidence_from(T_true, frame, config.search_view)
        # Every nat counts: what few pieces say as well.
        whole = AlongRoadConfig(least_believed=1.0)
        road = weighed_along_road(T_true, evidence, locked, config.search_align, whole, 32)
        x, y, yaw = (np.linspace(-r, r, n) for r, n in ((2.0, 81), (0.12, 13), (np.radians(0.8), 13)))
        moves = np.stack(np.meshgrid(x, y, yaw, indexing="ij"), axis=-1).reshape(-1, 3)
        Ts = displaced(T_true, jnp.asarray(moves, jnp.float32))
        cost = _cost_of(Ts, evidence, config.search_align) + jax.vmap(prior_cost, (0, None))(Ts, locked)
    share = np.exp(-(np.asarray(cost, float) - float(cost.min())))
    share /= share.sum()
    mean = share @ moves[:, 0]
    expected = np.sqrt(share @ (moves[:, 0] - mean) ** 2)
    about_best = np.asarray(road.spread, float)[0, 0]
    best = float((np.linalg.inv(np.asarray(T_true)) @ np.asarray(road.Ts_local_base[0]))[0, 3])
    assert np.sqrt(about_best) == pytest.approx(np.sqrt(expected**2 + (mean - best) ** 2), rel=0.2, abs=0.02)


@pytest.mark.parametrize(("more", "shortest_m", "longest_m"), [((), 0.7, 5.0), ((8.0,), 0.0, 0.12)])
def test_a_tracked_frame_knows_how_open_it_is_along_the_road(more, shortest_m, longest_m):
    """Two solid lines: as open as anyone looked and more, whatever the prediction says; a stop line ahead: held."""
    semantic_map = street(*(across(at_m, 0.4) for at_m in more))
    localizer = FrameLocalizer(semantic_map, TABLE)
    predicted = PosePrior(X_TRUE, 0.0, 0.0, 0.1, np.radians(0.3))
    with jax.enable_x64(False):
        T_road = predicted.on_road(semantic_map)
        frame, local_map = localizer.prepare([drawn(semantic_map)], RIG, T_road)
        prior = predicted.to_solver(T_road, local_map.frame, localizer.config.road)
        config = TrackAlignConfig()
        evidence = evidence_from(prior.T_local_base, frame, config.view)
        mean, moment, _ = jax.jit(valley_along, static_argnames="config")(prior.T_local_base, evidence, prior, config)
    assert shortest_m < float(jnp.sqrt(moment[0, 0])) < longest_m
    assert abs(float(mean[0])) < 0.15


def test_a_covariance_is_widened_only_where_the_road_is_less_sure():
    covariance, spread = np.diag([0.01, 0.02, 0.03, 1e-4, 1e-4, 1e-4]), np.zeros((6, 6))
    spread[0, 0], spread[5, 5], spread[0, 5], spread[5, 0] = 0.25, 1e-4, 4e-3, 4e-3
    wide = np.asarray(widened(jnp.asarray(covariance), jnp.asarray(spread)))
    assert wide[0, 0] == pytest.approx(0.25) and np.linalg.eigvalsh(wide).min() > 0
    assert np.asarray(widened(jnp.asarray(covariance), jnp.asarray(0.01 * spread))) == pytest.approx(covariance)
    assert np.isfinite(np.asarray(widened(jnp.asarray(covariance), jnp.zeros((6, 6))))).all()


@pytest.mark.parametrize(("middle_m", "sigma_m"), [(0.1, 0.05), (-0.2, 0.2), (0.3, 0.5), (0.2, 1.0), (0.0, 50.0)])
def test_a_posterior_longer_than_the_places_is_not_taken_for_their_spread(middle_m, sigma_m):
    """Oracle: the Gaussian itself. What is told is never surer than it, nor twice as wide while it fits."""
    offsets = np.linspace(-0.75, 0.75, 11)
    share = np.exp(-0.5 * ((offsets - middle_m) / sigma_m) ** 2)
    share /= share.sum()
    seen = float(share @ offsets)
    mean, moment = np.zeros(6), np.zeros((6, 6))
    mean[0], moment[0, 0] = seen, share @ (offsets - seen) ** 2
    told, variance = beyond_reach(jnp.asarray(mean), jnp.asarray(moment), jnp.asarray(offsets), 25.0)
    sigma = float(jnp.sqrt(variance[0, 0]))
    assert abs(float(told[0]) - middle_m) < max(0.03, 0.4 * sigma)
    assert 0.95 * min(sigma_m, 2.3) < sigma < 2.0 * sigma_m
