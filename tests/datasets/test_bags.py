"""Bags of ROS 1 and ROS 2: a drive written as a bag comes back the same, and what is missing or broken is named."""

import contextlib
import logging
import re
import shutil
import sqlite3
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import KannalaBrandtCamera
from semloc_jax.cameras.io import write_calibration
from semloc_jax.datasets import open_drive, read_bag, write_bag
from semloc_jax.datasets.bags.frames import FrameTree
from semloc_jax.datasets.bags.images import picture_of
from semloc_jax.datasets.bags.logs import gnss_from_fixes, imu_from_messages, odometry_from_twists
from semloc_jax.datasets.bags.store import BagStore
from semloc_jax.datasets.bags.topics import camera_topics
from semloc_jax.datasets.bags.writer import _Scribe
from semloc_jax.errors import SemlocError
from semloc_jax.maps import read_map

rosbags = pytest.importorskip("rosbags")
KINDS = {"sqlite3": "bag", "mcap": "bag", "ros1": "drive.bag"}
CLOCK_S = 1.7e9
"""Times of the bags are those of a clock; float64 holds them to 0.24 us."""


@pytest.fixture(scope="module")
def drive(simulated_road):
    return open_drive(simulated_road)


@pytest.fixture(scope="module")
def origin(drive):
    return read_map(drive.map_path).origin


@pytest.fixture(scope="module")
def bags(drive, origin, tmp_path_factory):
    """The drive as a bag of each storage, two with compressed pictures."""
    folder = tmp_path_factory.mktemp("bags")
    return {
        kind: write_bag(
            drive, folder / f"{kind}_{name}", kind, origin, compressed=kind != "sqlite3", clock_offset_s=CLOCK_S
        )
        for kind, name in KINDS.items()
    }


@pytest.mark.parametrize("kind", KINDS)
def test_a_drive_written_as_a_bag_comes_back_the_same(drive, origin, bags, kind):
    found = open_drive(bags[kind]).in_map_of(origin)
    assert found.rig.names == drive.rig.names
    np.testing.assert_allclose(found.rig.T_base_cam, drive.rig.T_base_cam, atol=1e-12)
    ours, theirs = found.rig.cameras[0], drive.rig.cameras[0]
    assert type(ours) is type(theirs)
    np.testing.assert_allclose([ours.fx, ours.cy, ours.k1, ours.p2], [theirs.fx, theirs.cy, theirs.k1, theirs.p2])
    assert [frame.id for frame in found.frames] == [frame.id for frame in drive.frames]
    for ours, theirs in zip(found.frames, drive.frames, strict=True):
        assert ours.time_s == pytest.approx(theirs.time_s + CLOCK_S, abs=3e-7)
        assert np.array_equal(ours.image("front"), theirs.image("front"))
        for source in ("sem", "sem_net"):
            assert np.array_equal(ours.mask(source, "front"), theirs.mask(source, "front"))


@pytest.mark.parametrize("kind", KINDS)
def test_sensors_survive_the_bag(drive, origin, bags, kind):
    found = open_drive(bags[kind]).in_map_of(origin)
    np.testing.assert_allclose(found.gnss.p_enu, drive.gnss.p_enu, atol=1e-6)  # um, through degrees and back
    np.testing.assert_allclose(found.gnss.sigma_m, drive.gnss.sigma_m, rtol=1e-12)
    np.testing.assert_allclose(found.odometry.speed_mps, drive.odometry.speed_mps)
    np.testing.assert_allclose(found.odometry.yaw_rate_radps, drive.odometry.yaw_rate_radps)
    np.testing.assert_allclose(found.imu.gyro_radps, drive.imu.gyro_radps)
    np.testing.assert_allclose(found.truth.T_map_base, drive.truth.T_map_base, atol=1e-9)
    np.testing.assert_allclose(found.truth.time_s, drive.truth.time_s + CLOCK_S, rtol=0, atol=3e-7)
    a, b = found.gnss_prior(drive.frames[1].time_s + CLOCK_S), drive.gnss_prior(drive.frames[1].time_s)
    np.testing.assert_allclose(a.p_enu, b.p_enu, atol=1e-4)


def test_four_cameras_keep_their_places(garage_dir, tmp_path):
    drive = open_drive(garage_dir)
    bag = write_bag(only_images(drive), tmp_path / "bag", frames=drive.frames[:2], compressed=True)
    found = read_bag(bag)
    assert sorted(found.rig.names) == sorted(drive.rig.names)
    for name in drive.rig.names:
        ours, theirs = found.rig.index(name), drive.rig.index(name)
        np.testing.assert_allclose(found.rig.T_base_cam[ours], drive.rig.T_base_cam[theirs], atol=1e-12)
        assert type(found.rig.cameras[ours]) is KannalaBrandtCamera
        assert np.array_equal(found.frames[1].image(name), drive.frames[1].image(name))


def test_antennas_imus_and_axles_are_moved_to_the_base(tmp_path, drive, origin):
    """Sensors in frames of their own: tf tells where they are, and the readings are those of the base."""
    path = write_bag(replace(drive, odometry=None, imu=None), tmp_path / "bag", "mcap", origin, clock_offset_s=CLOCK_S)
    store = open_drive(path)
    assert store.odometry is None
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    T[:3, 3] = (2.0, 0.5, 1.0)

    def vector(x, y, z):
        return SimpleNamespace(x=x, y=y, z=z)

    # The base drives 5 m/s ahead and turns at 0.4 rad/s: the sensor feels v + w x t, turned into its own axes.
    v_sensor = T[:3, :3].T @ (np.array([5.0, 0.0, 0.0]) + np.cross([0.0, 0.0, 0.4], T[:3, 3]))
    twist = SimpleNamespace(linear=vector(*v_sensor), angular=vector(0.0, 0.0, 0.4))
    found = odometry_from_twists([(0.0, SimpleNamespace(twist=twist)), (0.1, SimpleNamespace(twist=twist))], T, "x")
    np.testing.assert_allclose(found.speed_mps, 5.0)
    np.testing.assert_allclose(found.yaw_rate_radps, 0.4)
    reading = SimpleNamespace(angular_velocity=vector(0, 0, 0.4), linear_acceleration=vector(1.0, 0.0, 9.8))
    np.testing.assert_allclose(imu_from_messages([(0.0, reading)], T).accel_mps2, [[0.0, 1.0, 9.8]], atol=1e-12)
    fix = SimpleNamespace(
        latitude=48.0,
        longitude=11.0,
        altitude=500.0,
        status=SimpleNamespace(status=0),
        position_covariance=np.zeros(9),
        position_covariance_type=0,
    )
    nothing = SimpleNamespace(**(vars(fix) | {"status": SimpleNamespace(status=-1)}))
    track = gnss_from_fixes([(0.0, nothing), (1.0, fix)], T)
    assert track.antenna_base == (2.0, 0.5, 1.0)
    assert track.time_s.tolist() == [1.0]
    assert gnss_from_fixes([(0.0, nothing)], T) is None


def test_frames_are_found_over_several_links():
    tree = FrameTree()
    vector, quaternion = _xyz(1.0, 0.0, 0.0), _xyzw(*Rotation.from_euler("z", 90, degrees=True).as_quat())
    tree.add(0.0, "/base_link", "/mast", vector, quaternion)
    tree.add(0.0, "camera", "mast", _xyz(0.0, 0.0, -2.0), _xyzw(0.0, 0.0, 0.0, 1.0))
    np.testing.assert_allclose(tree.constant("base_link", "camera")[:3, 3], [1.0, 0.0, 2.0], atol=1e-12)
    assert tree.constant("base_link", "elsewhere") is None
    for second in (0.0, 4.0):
        tree.add(second, "map", "odom", _xyz(0.1 * second, 0.0, 0.0), _xyzw(0.0, 0.0, 0.0, 1.0))
    for second in np.arange(0.5, 5.0):
        tree.add(second, "odom", "base_link", _xyz(3.0 * (second - 0.5), 0.0, 0.0), _xyzw(0.0, 0.0, 0.0, 1.0))
    path = tree.path("map", "camera")
    np.testing.assert_allclose(path.time_s, [0.5, 1.5, 2.5, 3.5])
    np.testing.assert_allclose(path.T_map_base[:, 0, 3], 1.0 + 0.1 * path.time_s + 3.0 * (path.time_s - 0.5))


def test_topics_are_grouped_by_camera():
    images = {
        "/sensors/front/image_raw": 10,
        "/sensors/front/image_raw/compressed": 10,
        "/sensors/front/semantic": 10,
        "/sensors/rear/image_rect_color/compressed": 9,
        "/sensors/rear/depth/image": 9,
    }
    found = camera_topics(images, ["/sensors/front/camera_info", "/sensors/rear/camera_info"])
    assert list(found) == ["front", "rear"]
    assert found["front"].image == "/sensors/front/image_raw" and not found["front"].is_rectified
    assert found["front"].masks == {"semantic": "/sensors/front/semantic"}
    assert found["rear"].is_rectified and found["rear"].info == "/sensors/rear/camera_info"
    (alone,) = camera_topics({"/usb_cam/image_raw": 3}, [])
    assert alone == "usb_cam"


def test_encodings_of_raw_images(tmp_path):
    """Every encoding gives back the colours that were put in (Bayer: to its interpolation)."""
    scribe = _Scribe(tmp_path / "x", "mcap")
    bgr = np.zeros((8, 12, 3), np.uint8)
    bgr[:] = (40, 90, 200)

    def message(encoding, pixels, pad=0):
        rows = np.pad(pixels.reshape(8, -1), ((0, 0), (0, pad)))
        return scribe.make(
            "sensor_msgs/msg/Image",
            header=scribe.header(1.0, "x"),
            height=8,
            width=12,
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1],
            data=rows.ravel().view(np.uint8),
        )

    mosaic = np.empty((8, 12), np.uint8)
    mosaic[0::2, 0::2], mosaic[0::2, 1::2], mosaic[1::2, 0::2], mosaic[1::2, 1::2] = 200, 90, 90, 40
    for encoding, pixels in {
        "bgr8": bgr,
        "rgb8": bgr[..., ::-1].copy(),
        "bgra8": np.dstack([bgr, np.full((8, 12), 255, np.uint8)]),
        "bayer_rggb8": mosaic,
    }.items():
        assert np.array_equal(picture_of(message(encoding, pixels), "x"), bgr), encoding
    assert np.array_equal(picture_of(message("bgr8", bgr, pad=5), "x"), bgr)  # rows with a margin
    grey = np.arange(96, dtype=np.uint8).reshape(8, 12)
    assert np.array_equal(picture_of(message("mono8", grey), "x"), grey)
    with pytest.raises(SemlocError, match="encoding '32FC1' is not supported"):
        picture_of(message("32FC1", grey), "x")
    with pytest.raises(SemlocError, match="bytes for 12x8 px of bgr8"):
        picture_of(message("bgr8", grey), "x")


def test_without_tf_a_calibration_beside_the_bag_is_used(drive, tmp_path, monkeypatch):
    monkeypatch.setattr(_Scribe, "transform", _elsewhere(_Scribe.transform))
    bag = write_bag(only_images(drive), tmp_path / "bag")
    with pytest.raises(
        SemlocError, match=r"tf does not link 'front_optical_frame' .* with a base .* give --calib FILE"
    ):
        open_drive(bag)
    write_calibration(drive.rig, tmp_path / "calib.yaml")
    assert open_drive(bag).rig.names == ("front",)
    (tmp_path / "calib.yaml").rename(tmp_path / "other.yaml")
    assert open_drive(bag, tmp_path / "other.yaml").rig.names == ("front",)


def test_a_missing_library_names_the_extra(bags, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(SemlocError, match=r'pip install "rosbags'):
        open_drive(bags["mcap"])


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_a_bag_cut_off_is_one_line(bags, kind, tmp_path):
    source = bags[kind] if kind == "ros1" else next(bags[kind].glob("*.mcap"))
    damaged = tmp_path / source.name
    damaged.write_bytes(source.read_bytes()[: source.stat().st_size // 2])
    with pytest.raises(SemlocError, match=r"bag .*: (cannot be opened|damaged|no image topic|the CameraInfo|no )"):
        for frame in open_drive(damaged).frames:
            frame.image("front")


@pytest.mark.parametrize(
    ("table", "column", "value", "said"),
    [
        ("messages", "timestamp", b"GP", "recorded at b'GP'; expected whole nanoseconds"),
        ("messages", "timestamp", "abc", "recorded at 'abc'; expected whole nanoseconds"),
        ("messages", "timestamp", 1.5, "recorded at 1.5; expected whole nanoseconds"),
        ("messages", "timestamp", -1, "recorded at -1; expected whole nanoseconds"),
        ("messages", "timestamp", 2**63 - 1, "expected whole nanoseconds"),
        ("messages", "data", 10**10, "a message holds int; expected bytes"),
        ("topics", "name", b"/gps", "expected two words and a whole number"),
    ],
)
def test_values_of_the_wrong_kind_in_a_table_are_refused_where_they_enter(bags, tmp_path, table, column, value, said):
    """SQLite has no fixed types; nobody behind the door of a bag meets a time that is text."""
    path = Path(shutil.copy(next(bags["sqlite3"].glob("*.db3")), tmp_path))
    with contextlib.closing(sqlite3.connect(path)) as held, held:
        held.execute(f"UPDATE {table} SET {column} = ? WHERE id % 3 = 1", (value,))
    with pytest.raises(SemlocError, match=re.escape(said)) as caught:
        store = BagStore(path)
        [store.at(topic, recorded_ns) for topic, recorded_ns, _ in store.messages(list(store.types))]
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_fixes_need_to_know_where_the_map_is(bags):
    found = open_drive(bags["mcap"])
    assert found.gnss.origin is not None
    with pytest.raises(SemlocError, match="the map does not say where on the earth"):
        found.in_map_of(None)


def test_pictures_of_another_size_scale_the_camera(drive, tmp_path, caplog):
    half = only_images(replace(drive, rig=replace_cameras(drive.rig, [c.resized(960, 600) for c in drive.rig.cameras])))
    with caplog.at_level(logging.WARNING):
        found = read_bag(write_bag(half, tmp_path / "bag"))
    assert found.rig.cameras[0].resolution == (480, 300)
    assert "pictures are 480x300 px, the calibration is for 960x600 px; it is scaled" in caplog.text
    np.testing.assert_allclose(found.rig.cameras[0].fx, drive.rig.cameras[0].fx)
    wide = only_images(replace(drive, rig=replace_cameras(drive.rig, [c.resized(960, 400) for c in drive.rig.cameras])))
    with pytest.raises(SemlocError, match="another shape"):
        read_bag(write_bag(wide, tmp_path / "wide"))


@pytest.mark.slow
@pytest.mark.data
def test_the_bag_is_localized_as_the_folder_is(road_dir, tmp_path):
    from semloc_jax.inputs.mask_source import mask_source
    from semloc_jax.localization.frame_by_frame import localize_frames

    drive = open_drive(road_dir)
    semantic_map = read_map(drive.map_path)
    bag = write_bag(drive, tmp_path / "bag", "mcap", semantic_map.origin, drive.frames[10:13], compressed=True)
    found = open_drive(bag).in_map_of(semantic_map.origin)
    ours = localize_frames(found, semantic_map, mask_source("sem", found, table="drive"))
    theirs = localize_frames(drive, semantic_map, "sem", frames=slice(10, 13))
    assert all(result.localized for result in ours)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a.T_map_base, b.T_map_base, atol=1e-3)


def only_images(drive):
    return replace(drive, gnss=None, odometry=None, imu=None, truth=None)


def replace_cameras(rig, cameras):
    return type(rig)(cameras, rig.T_base_cam, rig.names)


def _elsewhere(transform):
    """tf whose parent is no name of a base frame."""
    return lambda self, time_s, parent, child, T: transform(self, time_s, "chassis_42", child, T)


def _xyz(x, y, z):
    return SimpleNamespace(x=x, y=y, z=z)


def _xyzw(x, y, z, w):
    return SimpleNamespace(x=x, y=y, z=z, w=w)


def test_init_says_which_class_tables_know_the_masks_of_a_bag(bags):
    """A bag cannot say what ids mean: without the option the command that comes next would fail."""
    from semloc_jax.inputs.first_look import first_look

    look = first_look(bags["mcap"])
    assert "--masks sem --class-table TABLE" in look.command and "--map MAP" in look.command
    (line,) = (line for line in look.missing if line.startswith("class table of the masks with ids"))
    assert "drive" in line.split("--class-table")[1] and "cityscapes" not in line


def test_init_does_not_ask_for_pictures_where_a_library_is_missing(bags, monkeypatch):
    from semloc_jax.inputs import first_look

    def refuse(path):
        raise SemlocError("bag: the library rosbags is not installed; run: pip install rosbags")

    monkeypatch.setattr(first_look, "open_drive", refuse)
    look = first_look.first_look(bags["mcap"])
    assert look.command == f"mend that, then: semloc init {bags['mcap']}"
