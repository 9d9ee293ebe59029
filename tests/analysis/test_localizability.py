"""What is expected of a place agrees with what images of it give; second poses; lanes; small maps; bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.pose import Prior, assess
from semloc_jax.alignment.single_frame import evidence_from
from semloc_jax.analysis.expected import expected_covariance, expected_sigma
from semloc_jax.analysis.intervals import Interval, bounds
from semloc_jax.analysis.lanes import lane_ways
from semloc_jax.analysis.seed_errors import errors_by_seed
from semloc_jax.analysis.selection import (
    ElementInformation,
    element_information,
    greedy_order,
    small_map,
)
from semloc_jax.analysis.survey import Way, path_way, survey_ways
from semloc_jax.datasets import open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.maps import MapElement, SemanticMap, read_map, write_drive_geojson
from semloc_jax.perception import load_class_table
from semloc_jax.simulation import SimulationConfig, simulate
from semloc_jax.simulation.cameras import front_rig, surround_rig
from semloc_jax.structs import ElementClass

TABLE = load_class_table("drive")


@pytest.fixture(scope="module")
def drive(simulated_road):
    return open_drive(simulated_road)


@pytest.fixture(scope="module")
def road_map(drive):
    return read_map(drive.map_path)


@pytest.fixture(scope="module")
def found(drive, road_map):
    Ts = np.stack([drive.truth_at(frame) for frame in drive.frames])
    return survey_ways(road_map, drive.rig, TABLE, [Way("drive", Ts, np.arange(len(Ts)) * 5.0)])


@pytest.mark.slow
def test_expected_information_is_that_of_exact_masks(drive, road_map, found):
    """Lateral and heading sigma of the information from the map alone are within 25 % of the solver's on exact masks.

    Along the road the stairs of real masks look like information to the solver; the map alone does not count them.
    """
    source, report = mask_source("sem", drive, offset_px=(0.0, 0.0)), found.ways[0]
    expected = expected_sigma(expected_covariance(jnp.asarray(report.information), found.config.expected.prior_sigma))
    localizer = FrameLocalizer(road_map, source.table)
    config, ratios = localizer.config.frame, []
    stated_by_solver = jax.jit(lambda T, evidence, prior: assess(T, 2, evidence, prior, config.polish_align))
    for row, frame in enumerate(drive.frames):
        T = drive.truth_at(frame)
        inputs, local_map = localizer.prepare(source.masks(frame), frame.rig, T)
        T = jnp.asarray(local_map.frame.from_map(T))
        prior = Prior(T, jnp.asarray(found.config.expected.prior_sigma, jnp.float32))
        stated = stated_by_solver(T, evidence_from(T, inputs, config.polish_view), prior)
        ratios.append(expected[row] / expected_sigma(stated.covariance))
    longitudinal, lateral, heading = np.median(ratios, axis=0)
    assert 0.8 < lateral < 1.25 and 0.8 < heading < 1.25
    assert 0.8 < longitudinal < 2.0


def test_covariance_without_an_image_is_the_prior():
    sigma = np.array([1.0, 2.0, 0.03, 0.01, 0.01, 0.05])
    np.testing.assert_allclose(expected_covariance(jnp.zeros((6, 6)), sigma), np.diag(sigma**2), rtol=1e-12)


def test_weak_stretches_are_what_is_above_the_limit(found):
    limit = found.limits["longitudinal"]
    weak = [s for s in found.weak_stretches() if s.what == "longitudinal"]
    assert bool(weak) == bool((found.ways[0].sigma[:, 0] > limit).any())
    assert all(s.worst > limit and s.from_km <= s.to_km for s in weak)


def _straight(dash_m: float, gap_m: float, length_m: float = 120.0) -> SemanticMap:
    """Two solid lines 3.6 m apart or, with gaps, rows of dashes."""
    starts = np.arange(0.0, length_m, dash_m + gap_m)
    elements = []
    for side in (-1.8, 1.8):
        for k, x in enumerate(starts):
            line = np.array([[x, side, 0.0], [x + dash_m, side, 0.0]])
            elements.append(MapElement(f"{side}_{k}", ElementClass.LANE_MARKING, line, width_m=0.15))
    return SemanticMap(tuple(elements))


def test_dashes_fit_one_period_further_on():
    """On a road with dashes of 3 m each 9 m and nothing else, the pose 9 m away explains the view."""
    dashes = _straight(3.0, 6.0)
    way = path_way("middle", np.stack([dashes.road_pose(40.0, 0.0, 0.0)]), 5.0)
    report = survey_ways(dashes, front_rig(), TABLE, [way]).ways[0]
    assert abs(abs(report.second_m[0, 0]) - 9.0) < 0.4 and abs(report.second_m[0, 1]) < 0.1
    assert report.ambiguity[0] > 0.75


def test_a_lane_between_solid_lines_is_found_in_its_middle():
    ways = lane_ways(_straight(119.0, 1.0), 5.0)
    assert len(ways) == 1
    np.testing.assert_allclose(ways[0].Ts_map_base[:, 1, 3], 0.0, atol=0.05)
    assert ways[0].station_m[-1] > 100.0


def test_no_lane_is_a_message():
    pole = MapElement("p", ElementClass.POLE, np.array([[0, 0, 0], [0, 0, 3.0]]), radius_m=0.1)
    with pytest.raises(SemlocError, match="--path"):
        lane_ways(SemanticMap((pole,)), 5.0)


def test_information_of_the_elements_adds_up(drive, road_map, found):
    T = found.ways[0].way.Ts_map_base
    parts = element_information(road_map, drive.rig, TABLE, T)
    scale = parts.prior_sigma
    whole = found.ways[0].information * scale[:, None] * scale
    away = np.abs(parts.whitened.sum(axis=1) - whole)
    # Rounding of the processor decides whether a sample at the rim of the image is in view, in one of both or in both.
    assert (away > 2e-3 * (np.abs(whole) + np.abs(whole).max())).mean() < 0.05
    np.testing.assert_allclose(away, 0.0, atol=0.02 * np.abs(whole).max())


def test_greedy_is_near_the_best_pair():
    """With equal costs the two that are taken gain at least 95 % of what the best of all pairs gains."""
    rng = np.random.default_rng(3)
    a = rng.normal(size=(4, 12, 6, 2)) * rng.uniform(0.1, 3.0, (1, 12, 1, 1))
    information = ElementInformation(a @ np.swapaxes(a, -1, -2), np.ones(6))
    taken, values = greedy_order(information, np.ones(12), 2.0)
    whole = information.sigma(range(12))

    def value(chosen):
        return np.mean((information.sigma(chosen) / whole) ** 2)

    pairs = [value([i, j]) for i in range(12) for j in range(i)]
    assert len(taken) == 2 and values[-1] == pytest.approx(value(taken))
    assert value([]) - values[-1] >= 0.95 * (value([]) - min(pairs)) and values[-1] < 0.7 * np.mean(pairs)


def test_small_map_keeps_its_share(drive, road_map, found, tmp_path):
    """Bytes are those of the file that is written, and no point of the small map lies 2 cm off the whole one."""
    places = found.ways[0].way.Ts_map_base
    small = small_map(road_map, drive.rig, TABLE, places, 0.2)
    write_drive_geojson(small.map, tmp_path / "small.geojson")
    write_drive_geojson(road_map, tmp_path / "whole.geojson")
    size, whole = ((tmp_path / f"{name}.geojson").stat().st_size for name in ("small", "whole"))
    assert size == pytest.approx(small.share * whole) and size <= 0.2 * whole
    assert np.all(small.sigma < 1.2 * small.sigma_whole)
    by_id = {element.id: element.points for element in road_map.elements}
    for element in small.map.elements:
        away = np.linalg.norm(element.points[:, None] - by_id[element.id], axis=-1).min(axis=1)
        assert away.max() < 0.01
    with pytest.raises(SemlocError, match="0.2"):
        small_map(road_map, drive.rig, TABLE, places, 1.5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [22, 33])
def test_a_fifth_of_a_map_gives_nearly_its_accuracy(tmp_path, seed):
    """On a road no figure was chosen on, poses of masks with a network's noise lose at most 20 % of their accuracy.

    Mean over the three directions at most 10 %: root mean square over 12 places and 6 draws of the noise each.
    """
    size = SimulationConfig(num_frames=12, rate_hz=1.0, width_px=640, height_px=400, has_images=False)
    drive = simulate("road", seed, tmp_path / "road", size)
    whole, places = read_map(drive.map_path), np.stack([drive.truth_at(frame) for frame in drive.frames])
    small = small_map(whole, drive.rig, TABLE, places, 0.2)
    rms = [
        np.sqrt(np.mean(errors_by_seed(drive, m, drive.frames, 6).error ** 2, axis=(0, 1))) for m in (whole, small.map)
    ]
    loss = rms[1] / rms[0] - 1
    print(f"seed {seed}: {small}; measured loss {np.round(100 * loss)} %")
    assert loss.max() < 0.2 and loss.mean() < 0.1


@pytest.mark.parametrize("camera", [front_rig().cameras[0], surround_rig().cameras[1]], ids=["radtan", "fisheye"])
def test_interval_bounds_hold_for_every_camera(camera):
    """Pixels and their derivatives of 20,000 points lie within the bounds of the boxes that they were drawn from."""
    rng = np.random.default_rng(0)
    center = rng.uniform([-5, -2, 2, -1, -1, -1], [5, 2, 30, 1, 1, 1], (200, 6))
    radius = np.abs(rng.normal(0, 0.1, (200, 6)))

    def pixels(*p):
        return jax.jvp(lambda *xyz: camera.project_xyz(*xyz)[:2], p[:3], p[3:])

    low, high = (jnp.asarray(end.T) for end in (center - radius, center + radius))
    held = jax.jit(lambda low, high: bounds(pixels, *map(Interval, low, high)))(low, high)
    held = jax.tree.leaves(held, is_leaf=lambda part: isinstance(part, Interval))
    inside = jax.jit(pixels)
    for _ in range(100):
        point = center + radius * rng.uniform(-1, 1, center.shape)
        for interval, value in zip(held, jax.tree.leaves(inside(*map(jnp.asarray, point.T))), strict=True):
            assert bool(jnp.all((interval.low - 1e-9 <= value) & (value <= interval.high + 1e-9)))
