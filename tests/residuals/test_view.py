"""Map samples as a camera sees them: silhouettes against plane geometry, density and weights against the image."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.cameras import BevCamera, PinholeCamera, Rig
from semloc_jax.cameras.bev import T_base_bev
from semloc_jax.maps import MapElement, SemanticMap, sample
from semloc_jax.residuals.noise import NoiseModel
from semloc_jax.residuals.view import ViewConfig, contour_points, view
from semloc_jax.simulation.cameras import mounted
from semloc_jax.structs import ElementClass, MapSamples, SampleKind

CHANNELS = jnp.arange(len(ElementClass), dtype=jnp.int32)
seen_by = jax.jit(view, static_argnames="config")
PLAIN = ViewConfig(capacity=512, shared_error=0.0)
"""Weights as they are in the image, without the limit on the share of an element."""
CAMERA = PinholeCamera(740.0, 742.0, 478.0, 296.0, 960, 600)
RIG = Rig([CAMERA], mounted((1.6, 0.0, 1.4), 0.0, 3.0, 0.0)[None], ["front"])


def made(p_map, tangent, **columns):
    """MapSamples of arrays [n 3]; other columns by name, else 0."""
    n = len(p_map)
    rows = {name: columns.get(name, np.zeros(n)) for name in ("offset_m", "length_m", "label", "kind", "element")}
    ints = ("label", "kind", "element")
    return MapSamples(
        p_map=jnp.asarray(p_map, jnp.float32),
        tangent_map=jnp.asarray(tangent, jnp.float32),
        center_map=jnp.asarray(columns.get("center_map", p_map), jnp.float32),
        height_sigma=jnp.asarray(columns.get("height_sigma", np.zeros((n, 3))), jnp.float32),
        valid=jnp.ones(n, bool),
        **{k: jnp.asarray(v, jnp.int32 if k in ints else jnp.float32) for k, v in rows.items()},
    )


def road_lines(spacing_m=0.1, capacity=None):
    """Samples of two edge lines of a straight road, 80 m along x."""
    elements = [
        MapElement(f"line {y}", ElementClass.LANE_MARKING, np.array([[0.0, y, 0.0], [80.0, y, 0.0]]), width_m=0.15)
        for y in (-1.8, 1.9)
    ]
    local = SemanticMap(tuple(elements)).query(np.array([20.0, 0.0, 0.0]), 90.0)
    samples = sample(local, spacing_m, capacity)
    return samples, local.origin_map


def pose(x, origin):
    T = np.eye(4)
    T[0, 3] = x
    T[:3, 3] -= origin
    return jnp.asarray(T, jnp.float32)


def pixels(p_map, T_map_base):
    """Pinhole projection, written anew."""
    T = np.linalg.inv(np.asarray(T_map_base, np.float64) @ np.asarray(RIG.T_base_cam[0]))
    p = np.asarray(p_map, np.float64) @ T[:3, :3].T + T[:3, 3]
    return p[:, :2] / p[:, 2:] * [740.0, 742.0] + [478.0, 296.0], p[:, 2]


def band_lengths(weight, uv, bands):
    return np.array([weight[(uv[:, 1] >= top) & (uv[:, 1] < bottom)].sum() for top, bottom in bands])


@pytest.mark.parametrize("capacity", [256, 1024])
def test_samples_are_spread_evenly_along_contours_in_the_image(capacity):
    """Raw samples crowd towards the horizon a hundred times denser than in front of the vehicle."""
    samples, origin = road_lines(0.02)
    T = pose(3.0, origin)
    seen = seen_by(samples, T, RIG, CHANNELS, config=replace(PLAIN, capacity=capacity))
    kept = np.asarray(seen.weight[0]) > 0
    uv, depth = pixels(seen.p_map[0].T, T)
    gaps, across = [], np.asarray(seen.p_map[0][1])
    borders = [
        edge for edge in np.unique(np.round(across[kept], 2)) if (kept & (np.abs(across - edge) < 0.02)).sum() > 5
    ]
    for edge in borders:
        on_edge = kept & (np.abs(across - edge) < 0.02)
        order = np.argsort(depth[on_edge])
        gaps.append(np.linalg.norm(np.diff(uv[on_edge][order], axis=0), axis=1))
    assert len(gaps) == 4  # both borders of both lines
    gaps = np.concatenate(gaps)
    raw, raw_depth = pixels(np.asarray(samples.p_map)[np.asarray(samples.valid)][:3900], T)
    raw_gaps = np.linalg.norm(np.diff(raw[raw_depth > 4.0], axis=0), axis=1)
    assert np.std(raw_gaps) / np.mean(raw_gaps) > 1.0
    assert np.std(gaps) / np.mean(gaps) < 0.25
    assert kept.sum() <= capacity
    assert gaps.mean() == pytest.approx(max(np.sum(gaps) / (0.9 * capacity), PLAIN.min_spacing_px), rel=0.15)


def test_weights_are_pixels_of_contour():
    """In every band of the image the weights add up to the length of the borders that run through it."""
    samples, origin = road_lines(0.02)
    T = pose(3.0, origin)
    seen = seen_by(samples, T, RIG, CHANNELS, config=PLAIN)
    uv, _ = pixels(seen.p_map[0].T, T)
    bands = ((290, 320), (320, 350), (350, 420), (420, 500), (500, 580))
    x = np.linspace(5.0, 50.0, 20000)
    true_px = np.zeros(len(bands))
    for y in (-1.8 - 0.075, -1.8 + 0.075, 1.9 - 0.075, 1.9 + 0.075):
        at, _ = pixels(np.column_stack([x, np.full_like(x, y), np.zeros_like(x)]) - origin, T)
        step = np.linalg.norm(np.diff(at, axis=0), axis=1) * ((at[1:, 0] >= -0.5) & (at[1:, 0] <= 959.5))
        true_px += band_lengths(step, at[1:], bands)
    np.testing.assert_allclose(band_lengths(np.asarray(seen.weight[0]), uv, bands), true_px, rtol=0.04, atol=6.0)


def test_a_weight_in_metres_favours_what_is_far():
    samples, origin = road_lines(0.02)
    T = pose(3.0, origin)
    share = []
    for exponent in (0.0, 0.5, 1.0):
        seen = seen_by(samples, T, RIG, CHANNELS, config=replace(PLAIN, metric_exponent=exponent))
        weight = np.asarray(seen.weight[0], np.float64)
        x = np.asarray(seen.p_map[0][0], np.float64) + origin[0]
        share.append(float(np.sum(weight * (x > 20.0)) / np.sum(weight)))
    in_reach = x[weight > 0]
    assert share[0] < 0.35 and share[0] < share[1] < share[2]
    assert share[2] == pytest.approx((in_reach.max() - 20.0) / np.ptp(in_reach), abs=0.06)


@pytest.mark.parametrize("first_element", [0, 5000])
def test_the_share_of_an_element_is_limited(first_element):
    """n observations of variance 1 that share an error of variance e hold n / (1 + n e): a long line counts no more."""
    samples, origin = road_lines(0.02)
    # A dense map numbers its elements far beyond the capacity of a view.
    samples = MapSamples(**{**vars(samples), "element": jnp.where(samples.valid, samples.element + first_element, -1)})
    T = pose(3.0, origin)
    free = seen_by(samples, T, RIG, CHANNELS, config=PLAIN)
    shared = replace(PLAIN, shared_error=0.2, noise=NoiseModel(correlation_px=50.0))
    limited = seen_by(samples, T, RIG, CHANNELS, config=shared)
    for element in (first_element, first_element + 1):
        total = [
            float(np.sum(np.asarray(v.weight[0]) * (np.asarray(v.element[0]) == element))) for v in (free, limited)
        ]
        assert total[1] == pytest.approx(total[0] / (1 + 0.2 * total[0] / 50.0), rel=1e-4)


def test_what_is_far_behind_or_has_no_mask_is_left_out():
    points = np.array([[10.0, 0, 0], [70.0, 0, 0], [-10.0, 0, 0], [10.0, 30.0, 0], [10.0, 0, 0], [9.0, 0, 0]])
    labels = [0, 0, 0, 0, int(ElementClass.SIGN), 0]
    samples = made(
        points, np.tile([0.0, 1.0, 0.0], (6, 1)), length_m=np.full(6, 0.5), label=labels, element=np.arange(6)
    )
    samples = MapSamples(**{**vars(samples), "valid": jnp.array([True] * 5 + [False])})
    seen = seen_by(
        samples, jnp.eye(4, dtype=jnp.float32), RIG, CHANNELS.at[ElementClass.SIGN].set(-1), config=ViewConfig(256)
    )
    assert set(np.asarray(seen.element[0])[np.asarray(seen.weight[0]) > 0]) <= {0}
    assert float(seen.weight.sum()) > 0


def test_an_empty_map_gives_an_empty_view():
    samples = made(np.zeros((256, 3)), np.zeros((256, 3)))
    samples = MapSamples(**{**vars(samples), "valid": jnp.zeros(256, bool)})
    seen = seen_by(samples, jnp.eye(4, dtype=jnp.float32), RIG, CHANNELS, config=ViewConfig(128))
    assert float(jnp.abs(seen.weight).max()) == 0.0
    assert np.isfinite(np.asarray(seen.p_map)).all()


def test_a_margin_keeps_what_a_wide_search_may_see():
    samples, origin = road_lines(0.02)
    T = pose(3.0, origin)
    narrow = seen_by(samples, T, RIG, CHANNELS, config=replace(PLAIN, capacity=1024, min_spacing_px=3.0))
    wide = seen_by(
        samples, T, RIG, CHANNELS, config=replace(PLAIN, capacity=1024, min_spacing_px=3.0, margin_share=0.3)
    )
    uv, _ = pixels(wide.p_map[0].T, T)
    outside = (np.asarray(wide.weight[0]) > 0) & ((uv[:, 1] > 600.0) | (np.abs(uv[:, 0] - 480) > 480.0))
    assert outside.sum() > 10
    assert uv[outside][:, 1].max() < 600.0 + 0.3 * 960 + 1
    assert float(wide.weight.sum()) > float(narrow.weight.sum())


def test_a_top_view_sees_metres_evenly():
    """Orthographic: equal spacing on the road is equal spacing in the image, near and far."""
    rig = Rig([BevCamera.covering(30.0, 5.0, 6.0, 6.0, 0.05)], T_base_bev()[None], ["top"])
    samples, origin = road_lines(0.02)
    seen = seen_by(samples, pose(10.0, origin), rig, CHANNELS, config=PLAIN)
    x = np.asarray(seen.p_map[0][0])[np.asarray(seen.weight[0]) > 0] + origin[0]
    counts, _ = np.histogram(x, bins=np.linspace(5.0, 40.0, 8))
    assert counts.min() > 0.85 * counts.max()
    assert float(seen.weight.sum()) == pytest.approx(4 * 35.0 / 0.05, rel=0.03)


def test_silhouette_of_a_cylinder_is_where_the_line_of_sight_touches_it():
    """Oracle: from distance D the tangents of a circle of radius r leave at asin(r / D) to either side."""
    rng = np.random.default_rng(0)
    distance, radius = rng.uniform(1.5, 40.0, 200), rng.uniform(0.03, 0.4, 200)
    bearing, height = rng.uniform(-np.pi, np.pi, 200), rng.uniform(-2.0, 5.0, 200)
    eye = np.array([3.0, -2.0, 1.4])
    axis = eye + np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing), height])
    for side in (1.0, -1.0):
        samples = made(
            axis, np.tile([0.0, 0.0, 1.0], (200, 1)), offset_m=side * radius, kind=np.full(200, int(SampleKind.ROUND))
        )
        p_map, is_contour = contour_points(samples, jnp.asarray(eye, jnp.float32))
        assert bool(is_contour.all())
        away = np.asarray(p_map, np.float64) - eye
        turned = np.arctan2(away[:, 1], away[:, 0]) - bearing
        turned = (turned + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(turned, side * np.arcsin(radius / distance), atol=2e-6)
        np.testing.assert_allclose(away[:, 2], height, atol=1e-5)
        # It is a point of the cylinder, too.
        assert np.hypot(*(np.asarray(p_map) - axis)[:, :2].T) == pytest.approx(radius, abs=1e-5)


def test_silhouette_of_a_leaning_cylinder():
    """The line of sight to the contour point stays one radius away from a tilted axis."""
    lean = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
    axis = np.array([8.0, 3.0, 0.5]) + np.linspace(0, 3, 20)[:, None] * lean
    samples = made(axis, np.tile(lean, (20, 1)), offset_m=np.full(20, 0.15), kind=np.full(20, int(SampleKind.ROUND)))
    p_map, _ = contour_points(samples, jnp.zeros(3, jnp.float32))
    sight = np.asarray(p_map, np.float64)
    normal = np.cross(sight, lean)
    gap = np.abs(np.sum((axis - 0.0) * normal, axis=1)) / np.linalg.norm(normal, axis=1)
    np.testing.assert_allclose(gap, 0.15, atol=1e-5)


@pytest.mark.parametrize("size_m", [(0.6, 0.6), (0.4, 0.9), (1.5, 0.3)])
def test_of_a_box_the_two_outermost_corners_are_kept(size_m):
    """Oracle: the corners with the smallest and the largest bearing, from near and far, from every side."""
    rng = np.random.default_rng(1)
    turn = 0.4
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    foot = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * size_m @ R.T + [4.0, 2.0]
    element = MapElement("pillar", ElementClass.PILLAR, np.column_stack([foot, np.zeros(4)]), closed=True, height_m=2.8)
    local = SemanticMap((element,)).query(np.array([4.0, 2.0, 0.0]), 20.0)
    samples = sample(local, 0.25)
    valid = np.asarray(samples.valid)
    position = (np.asarray(samples.p_map, np.float64) + local.origin_map)[valid]
    corner = np.argmin(np.linalg.norm(position[:, None, :2] - foot, axis=2), axis=1)
    wrong = 0
    for _ in range(100):
        bearing, distance = rng.uniform(-np.pi, np.pi), rng.uniform(1.6, 15.0)
        eye = np.array([4.0 + distance * np.cos(bearing), 2.0 + distance * np.sin(bearing), 0.8])
        _, is_contour = contour_points(samples, jnp.asarray(eye - local.origin_map, jnp.float32))
        angle = np.arctan2(*(foot - eye[:2]).T[::-1]) - np.arctan2(*([4.0, 2.0] - eye[:2])[::-1])
        angle = (angle + np.pi) % (2 * np.pi) - np.pi
        outermost = {int(np.argmin(angle)), int(np.argmax(angle))}
        kept = np.asarray(is_contour)[valid]
        wrong += set(corner[kept]) != outermost or not kept[np.isin(corner, list(outermost))].all()
    assert wrong == 0


def test_a_sample_of_unknown_height_counts_by_the_noise_of_its_place_in_the_image():
    """Weight s^2 / (s^2 + t^2) with t found by moving the point: up, and sideways with its height over the road."""
    tangents = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    points = np.array([[15.0, 1.0, 0.0], [20.0, -2.0, 0.0], [12.0, 3.0, 2.5]])
    label = np.array([ElementClass.STOP_LINE, ElementClass.LANE_MARKING, ElementClass.POLE])
    columns = {"length_m": np.array([0.25, 5.0, 0.25]), "label": label, "element": np.arange(3)}
    sigma = np.array([[0.03, 0.0, 0.0], [0.02, 5e-4, 0.0], [0.0, 0.0, 0.03]])
    T = jnp.eye(4, dtype=jnp.float32)
    plain, doubted = (
        np.asarray(seen_by(made(points, tangents, **columns, **more), T, RIG, CHANNELS, config=PLAIN).weight[0, :3])
        for more in ({}, {"height_sigma": sigma})
    )
    rise_m = np.hypot(sigma[:, 0], 0.5 * sigma[:, 1] * np.linalg.norm(points[:, :2] - [1.6, 0.0], axis=1) ** 2)
    (uv, _), (along, _) = pixels(points, T), pixels(points + 1e-4 * tangents, T)
    normal = (along - uv)[:, ::-1] * [1.0, -1.0] / np.linalg.norm(along - uv, axis=1, keepdims=True)
    square = np.zeros(3)
    for step, size_m in ((np.eye(3)[2], rise_m), *((np.eye(3)[k], sigma[:, 2] * points[:, 2]) for k in (0, 1))):
        square += (size_m * np.sum(normal * (pixels(points + 1e-4 * step, T)[0] - uv), axis=1) / 1e-4) ** 2
    np.testing.assert_allclose(doubted / plain, 1.0 / (1.0 + square / 4.0), rtol=2e-3)
    assert (doubted / plain < [0.9, 0.9, 0.2]).all()


def test_ends_of_dashes_count_as_observations_of_their_own():
    """Each end, some pixels long, weighs like one independent observation, or `most_alone` times its length."""
    dashes = [
        MapElement(f"dash {x}", ElementClass.LANE_MARKING, np.array([[x, 0.3, 0.0], [x + 3.0, 0.3, 0.0]]), width_m=0.25)
        for x in (9.0, 14.0)
    ]
    local = SemanticMap(tuple(dashes)).query(np.array([20.0, 0.0, 0.0]), 90.0)
    samples, T = sample(local, 0.05), pose(3.0, local.origin_map)
    plain, alone = (seen_by(samples, T, RIG, CHANNELS, config=replace(PLAIN, most_alone=most)) for most in (1.0, 3.0))
    np.testing.assert_array_equal(plain.p_map, alone.p_map)
    weight, more = (np.asarray(v.weight[0], np.float64) for v in (plain, alone))
    is_end = np.abs(np.asarray(plain.tangent_map[0][1])) > 0.9
    at_x = np.asarray(plain.p_map[0][0], np.float64) + local.origin_map[0]
    gains = []
    for x in (9.0, 12.0, 14.0, 17.0):
        end = is_end & (weight > 0) & (np.abs(at_x - x) < 0.05)
        gains.append(more[end].sum() / weight[end].sum())
        assert gains[-1] == pytest.approx(np.clip(60.0 / weight[end].sum(), 1.0, 3.0), rel=1e-4)
    # Fewer pixels with distance, so a higher gain, until the limit.
    assert gains[0] < gains[1] < gains[2] and gains[3] == pytest.approx(3.0)
    # The sides of the near dash are longer than one independent observation and gain nothing.
    side = ~is_end & (weight > 0) & (at_x < 12.0)
    assert weight[side].sum() > 120.0
    np.testing.assert_allclose(more[side], weight[side], rtol=1e-5)


@pytest.mark.parametrize("path", ["auto", "xla"])
def test_more_pixels_show_no_farther_road(path):
    """f h / r^2 is that of the camera's own pixels: 0.6 px for a metre 20.5 m away (focal length 180 px), not 29 m."""
    rig = Rig([PinholeCamera(180.0, 180.0, 200.0, 60.0, 400, 120)], RIG.T_base_cam, ["front"])
    samples, origin = road_lines()
    farthest_m = []
    for seen_through in (rig, rig.with_pixels(2)):
        found = seen_by(samples, pose(3.0, origin), seen_through, CHANNELS, config=replace(PLAIN, path=path))
        p_map, weight = np.asarray(found.p_map[0], np.float64), np.asarray(found.weight[0])
        farthest_m.append((p_map[0, weight > 0] + origin[0] - 4.6).max())
    assert farthest_m[0] == pytest.approx(np.sqrt(180.0 * 1.4 / 0.6), abs=1.0)
    assert farthest_m[1] == pytest.approx(farthest_m[0], abs=0.5)
