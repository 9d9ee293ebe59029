"""A real drive: constant cameras, boxes as pandas reads them, and a map that lies on the paint of unseen frames."""

import gzip
import pickle
import tracemalloc
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.datasets import open_drive
from semloc_jax.datasets.pandaset import build_map, calibrated
from semloc_jax.datasets.pandaset.cuboids import read_cuboids
from semloc_jax.datasets.pandaset.reader import CAMERAS, FRONT, LANE_LINE, _camera_poses, _course_rate
from semloc_jax.datasets.pandaset.strips import look_for
from semloc_jax.datasets.pandaset.vectorize import trace_lines, trace_signs
from semloc_jax.errors import SemlocError
from semloc_jax.structs import ElementClass

MAP_SWEEPS, TEST_SWEEPS = slice(24, None, 4), slice(26, None, 4)


@pytest.fixture(scope="module")
def folder(data_dir):
    path = data_dir / "pandaset_002"
    if not path.is_dir():
        pytest.skip(f"no pandaset_002 in {data_dir}")
    return path


@pytest.fixture(scope="module")
def drive(folder):
    return open_drive(folder)


def test_six_cameras_and_all_frames(drive):
    assert drive.rig.names == CAMERAS
    assert len(drive) == 80
    assert drive.frames[7].image(FRONT).shape == (1080, 1920, 3)
    assert drive.frames[7].image("back_camera").shape == (540, 960, 3)
    assert [camera.resolution for camera in drive.rig.cameras] == [(1920, 1080)] + [(960, 540)] * 5


def test_frame_rigs_give_back_the_published_camera_poses(drive, folder):
    """Constant extrinsics and the motion until each trigger: within 1 cm and 0.1 deg of every published pose."""
    for name in CAMERAS:
        published = _camera_poses(folder / "camera" / name).T_map_base
        for frame in drive.frames[1::13]:
            T = drive.truth_at(frame) @ np.asarray(frame.rig.T_base_cam)[frame.rig.index(name)]
            error = np.linalg.inv(published[frame.index]) @ T
            assert np.linalg.norm(error[:3, 3]) < 0.01
            assert np.degrees(Rotation.from_matrix(error[:3, :3]).magnitude()) < 0.1


def test_base_stands_on_the_road_and_drives_ahead(drive):
    road = drive.points.of(7)
    for frame in drive.frames[::16]:
        T = drive.truth_at(frame)
        p_base = (road - T[:3, 3]) @ T[:3, :3]
        under = p_base[(np.abs(p_base[:, 0] - 1.5) < 5.0) & (np.abs(p_base[:, 1]) < 2.0), 2]
        assert abs(np.median(under)) < 0.04
    motion = np.linalg.inv(drive.truth.T_map_base[60]) @ drive.truth.T_map_base[70]
    assert motion[0, 3] > 4.0
    assert abs(motion[1, 3]) < 0.03 * motion[0, 3]


def test_satellite_prior_is_near_the_truth(drive):
    frame = drive.frames[70]
    T = drive.truth_at(frame)
    prior = drive.gnss_prior(frame.time_s)
    assert np.linalg.norm(prior.p_enu[:2] - T[:2, 3]) < 0.5
    assert abs(np.degrees(prior.heading_rad - np.arctan2(T[1, 0], T[0, 0]))) < 3.0


def test_boxes_are_those_that_pandas_reads(folder):
    pandas = pytest.importorskip("pandas")
    path = folder / "annotations" / "cuboids" / "10.pkl.gz"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            table = pandas.read_pickle(path)
        except Exception as error:
            pytest.skip(f"this pandas does not read the old tables: {error}")
    boxes = read_cuboids(path)
    assert list(boxes.label) == table["label"].tolist()
    np.testing.assert_array_equal(boxes.center, table[["position.x", "position.y", "position.z"]].to_numpy(float))
    np.testing.assert_array_equal(boxes.yaw_rad, table["yaw"].to_numpy(float))


class _Command:
    def __reduce__(self):
        return (print, ("this must not run",))


def test_a_pickle_that_names_a_function_is_refused(tmp_path, capsys):
    path = tmp_path / "00.pkl.gz"
    path.write_bytes(gzip.compress(pickle.dumps(_Command())))
    with pytest.raises(SemlocError, match="not part of a table"):
        read_cuboids(path)
    assert capsys.readouterr().out == ""


def test_a_damaged_index_of_a_pickle_takes_no_memory(tmp_path):
    """An empty list that is to be remembered as the ten-millionth thing seen."""
    path = tmp_path / "00.pkl.gz"
    path.write_bytes(gzip.compress(pickle.EMPTY_LIST + pickle.LONG_BINPUT + (10**7).to_bytes(4, "little") + b"."))
    tracemalloc.start()
    with pytest.raises(SemlocError, match="cannot be read"):
        read_cuboids(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10_000_000


def test_dynamic_masks_cover_the_car_ahead_and_spare_the_road(drive):
    mask = drive.frames[40].dynamic_mask(FRONT)
    assert mask.shape == (1080, 1920)
    assert mask[640, 940]
    assert not mask[900:1000, 600:1000].any()


def test_tracing_finds_the_known_strokes_of_a_drawing():
    rng = np.random.default_rng(0)
    x = rng.uniform(0.0, 3.0, 4000)
    dash = np.column_stack([x, 0.1 * x + rng.uniform(-0.05, 0.05, 4000), np.full(4000, 0.2)])
    x = rng.uniform(0.0, 20.0, 30000)
    side = rng.choice([-0.15, 0.15], 30000)
    double = np.column_stack([x, 5.0 + side + rng.uniform(-0.05, 0.05, 30000), np.zeros(30000)])
    lines = trace_lines(np.vstack([dash, double]))
    found = [line for line in lines if line.is_isolated]
    assert len(found) == 1
    ends = found[0].points[np.argsort(found[0].points[:, 0])]
    np.testing.assert_allclose(ends, [[0.0, 0.0, 0.2], [3.0, 0.3, 0.2]], atol=0.03)
    heights = sorted(float(np.mean(line.points[:, 1])) for line in lines if not line.is_isolated)
    np.testing.assert_allclose(heights, [4.85, 5.15], atol=0.02)


def test_signs_are_upright_rectangles_of_the_right_size():
    rng = np.random.default_rng(1)
    normal, right = np.array([0.8, 0.6, 0.0]), np.array([-0.6, 0.8, 0.0])
    across, up = rng.uniform(-0.4, 0.4, 900), rng.uniform(-0.3, 0.3, 900)
    points = [10.0, 5.0, 3.0] + across[:, None] * right + up[:, None] * [0.0, 0.0, 1.0]
    points = points + 0.01 * rng.normal(size=(900, 1)) * normal
    ((outline, found),) = trace_signs(points)
    assert abs(found @ normal) > 0.999
    np.testing.assert_allclose(np.ptp(outline @ right), 0.8, atol=0.05)
    np.testing.assert_allclose(np.ptp(outline[:, 2]), 0.6, atol=0.05)


@pytest.mark.slow
def test_the_map_lies_on_the_paint_of_frames_it_was_not_made_from(drive):
    """Dashes, in pixels of the front camera: 1 px median and no bias, across and along."""
    corrected = calibrated(drive, MAP_SWEEPS)
    turn = np.linalg.inv(np.asarray(drive.rig.T_base_cam)[0]) @ np.asarray(corrected.rig.T_base_cam)[0]
    assert 0.01 < np.degrees(Rotation.from_matrix(turn[:3, :3]).magnitude()) < 0.2
    semantic_map = build_map(corrected, MAP_SWEEPS)
    assert len(semantic_map.elements) > 20
    assert {ElementClass.LANE_MARKING, ElementClass.ROAD_MARK, ElementClass.SIGN} <= {
        element.label for element in semantic_map.elements
    }
    dashes = [e.points for e in semantic_map.elements if e.style == "dashed" and all(e.true_ends)]
    index = corrected.rig.index(FRONT)
    looks = [
        (frame, frame.rig.cameras[index], corrected.truth_at(frame) @ np.asarray(frame.rig.T_base_cam)[index])
        for frame in corrected.frames[TEST_SWEEPS]
    ]
    sightings = [s for s in look_for(dashes, [True] * len(dashes), looks, FRONT) if np.isfinite(s.ahead_m)]
    assert len(sightings) >= 8
    focal, height = 1970.0, 2.1
    across = np.array([s.left_m * focal / s.range_m for s in sightings])
    along = np.array([s.ahead_m * focal * height / s.range_m**2 for s in sightings])
    assert np.median(np.abs(across)) < 1.5 and abs(np.median(across)) < 1.0
    assert np.median(np.abs(along)) < 1.5 and abs(np.median(along)) < 1.0


def test_few_dashes_are_named(drive):
    with pytest.raises(SemlocError, match="dashes are seen"):
        calibrated(drive, slice(0, 2))


def test_wrong_folders_are_named(tmp_path, drive):
    assert len(drive.points.of(LANE_LINE)) > 90_000
    (tmp_path / "camera" / FRONT).mkdir(parents=True)
    (tmp_path / "camera" / FRONT / "poses.json").write_text("[]")
    with pytest.raises(SemlocError, match=r"timestamps.json: no such file"):
        open_drive(tmp_path)


def test_a_course_turns_by_no_more_than_its_noise_lets_it_say():
    """Half a degree a second of noise when slow, a tenth of a turn when it is one; the velocity is off by 0.03 m/s."""
    time_s = np.arange(0.0, 8.0, 0.1)
    speed, rate = np.clip(2.0 * (time_s - 2.0), 0.0, 5.0), np.where(time_s > 5.0, np.deg2rad(15.0), 0.0)
    yaw = np.cumsum(rate) * 0.1
    velocity = speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1) + [0.01, 0.03]
    found = _course_rate(time_s, velocity)
    straight, turning = time_s < 4.4, time_s > 5.6
    assert abs(np.degrees(found[straight].sum() * 0.1)) < 0.1
    np.testing.assert_allclose(found[turning], rate[turning], rtol=0.1)
