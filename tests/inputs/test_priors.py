"""First guesses: seeded noise of the stated size, the same for a frame whichever frames are run, fixes, files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from semloc_jax.alignment.pose_prior import PosePrior, RoadSigmas
from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Drive, Frame, GnssTrack
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory, write_tum
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.inputs.priors import prior_source
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.structs import ElementClass

RIG = Rig([PinholeCamera(100.0, 100.0, 50.0, 40.0, 100, 80)], np.eye(4)[None], ["front"])
HEADING = 0.6


def truth(time_s):
    Ts = np.tile(np.eye(4), (len(time_s), 1, 1))
    c, s = np.cos(HEADING), np.sin(HEADING)
    Ts[:, :2, :2] = [[c, -s], [s, c]]
    Ts[:, :2, 3] = np.outer(10.0 * time_s, [c, s]) + [100.0, 50.0]
    return Trajectory(time_s, Ts)


@pytest.fixture
def drive():
    time_s = np.arange(400) / 10.0
    frames = tuple(Frame(k, f"{k:06d}", float(t), "", RIG, {}) for k, t in enumerate(time_s))
    path = truth(time_s)
    gnss = GnssTrack(time_s[::2], path.T_map_base[::2, :3, 3], np.full((200, 3), 1.7))
    return Drive("straight", Path("."), frames, RIG, truth=path, gnss=gnss)


def errors(drive, source):
    """Deviation of every prior from the truth in the vehicle frame: x, y [m], heading [rad]."""
    rows = []
    for frame in drive.frames:
        prior, T = source(frame), drive.truth_at(frame)
        xy = T[:2, :2].T @ (np.array([prior.x_m, prior.y_m]) - T[:2, 3])
        rows.append([*xy, prior.heading_rad - HEADING])
    return np.array(rows)


def test_noise_on_the_truth_has_the_stated_sigmas(drive):
    found = errors(drive, prior_source("truth", drive, 0.8, 2.0))
    np.testing.assert_allclose(found.std(axis=0), [0.8, 0.8, np.radians(2.0)], rtol=0.1)
    assert np.all(np.abs(found.mean(axis=0)) < 4 * np.array([0.8, 0.8, np.radians(2.0)]) / np.sqrt(400))
    assert abs(np.corrcoef(found.T)[0, 1]) < 0.15
    assert errors(drive, prior_source("truth", drive)).std(axis=0) == pytest.approx([1, 1, np.radians(3)], rel=0.1)


def test_noise_of_a_frame_depends_on_the_seed_and_the_frame_only(drive):
    first, again, other = (prior_source("truth", drive, seed=seed) for seed in (3, 3, 4))
    alone = first(drive.frames[17])
    assert [again(frame) for frame in drive.frames[10:20]][7] == alone
    assert other(drive.frames[17]) != alone
    assert first(drive.frames[18]) != alone


def test_fixes_give_place_heading_and_their_own_sigma(drive):
    source = prior_source("gnss", drive)
    prior, T = source(drive.frames[200]), drive.truth_at(drive.frames[200])
    np.testing.assert_allclose([prior.x_m, prior.y_m], T[:2, 3], atol=0.05)
    assert prior.heading_rad == pytest.approx(HEADING, abs=0.01)
    assert prior.sigma_xy_m == pytest.approx(1.7)
    assert prior.sigma_heading_rad >= np.radians(0.9)
    stated = prior_source("gnss", drive, 0.5, 4.0)(drive.frames[200])
    assert (stated.sigma_xy_m, stated.sigma_heading_rad) == pytest.approx((0.5, np.radians(4.0)))


def test_a_trajectory_file_is_a_prior(drive, tmp_path):
    write_tum(drive.truth, tmp_path / "guess.tum")
    source = prior_source(str(tmp_path / "guess.tum"), drive)
    assert np.abs(errors(drive, source)).max() < 1e-5
    assert source(drive.frames[0]).sigma_xy_m == 1.0


def test_what_is_missing_is_said(drive):
    with pytest.raises(SemlocError, match="no satellite fixes"):
        prior_source("gnss", replace(drive, gnss=None))
    with pytest.raises(SemlocError, match=r"for --prior gnss; give --prior truth or --prior FILE\.tum"):
        prior_source("gnss", replace(drive, gnss=None))
    with pytest.raises(SemlocError, match=r"for --prior gnss; give --prior FILE\.tum"):  # not a truth that is not there
        prior_source("gnss", replace(drive, gnss=None, truth=None))
    with pytest.raises(SemlocError, match="neither gnss nor truth"):
        prior_source("nowhere.tum", drive)
    with pytest.raises(SemlocError, match="no reference poses"):
        prior_source("truth", replace(drive, truth=None))(drive.frames[0])


@pytest.fixture
def sloping_map():
    """Two lines of a road that climbs by 1 in 20 along x and falls by 1 in 50 to the left."""
    x = np.linspace(-40.0, 40.0, 41)
    lines = [np.column_stack([x, np.full(41, y), 7.0 + 0.05 * x - 0.02 * y]) for y in (-2.0, 2.0)]
    return SemanticMap(
        tuple(MapElement(f"line{k}", ElementClass.LANE_MARKING, p, width_m=0.15) for k, p in enumerate(lines))
    )


def test_a_prior_stands_on_the_road_of_the_map(sloping_map):
    T = PosePrior(1.0, 0.5, 0.0, 1.0, 0.05).on_road(sloping_map)
    np.testing.assert_allclose(T[:3, 3], [1.0, 0.5, 7.0 + 0.05 - 0.01], atol=1e-3)
    assert T[2, 0] == pytest.approx(0.05 / np.hypot(1, 0.05), abs=2e-3)  # 0.1 deg
    assert T[2, 1] == pytest.approx(-0.02 / np.hypot(1, 0.02), abs=2e-3)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)


def test_the_solvers_prior_is_local_and_holds_the_road(sloping_map):
    prior = PosePrior(1.0, 0.5, 0.0, 1.2, 0.05)
    T, origin = prior.on_road(sloping_map), np.array([0.5, 0.5, 7.0])
    solver = prior.to_solver(T, LocalFrame(origin), RoadSigmas(0.03, 0.5))
    assert solver.T_local_base.dtype == np.float32
    np.testing.assert_allclose(solver.T_local_base[:3, 3], T[:3, 3] - origin, atol=1e-6)
    tilt = np.radians(0.5)
    np.testing.assert_allclose(solver.sigma, [1.2, 1.2, 0.03, tilt, tilt, 0.05], rtol=1e-6)


@pytest.mark.parametrize("field", ["x_m", "heading_rad", "sigma_xy_m"])
def test_a_prior_that_is_no_number_is_refused(sloping_map, field):
    bad = replace(PosePrior(1.0, 0.5, 0.0, 1.0, 0.05), **{field: float("nan")})
    with pytest.raises(SemlocError, match="NaN or infinite"):
        bad.on_road(sloping_map)
