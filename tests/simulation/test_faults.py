"""Faults by name: each does what it says, within its window only, the same for the same seed."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from semloc_jax.datasets import read_drive
from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory, write_tum
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.simulation.faults import FAULTS, FaultSizes, with_fault
from semloc_jax.simulation.standing_faults import STANDING
from semloc_jax.structs import ElementClass

CALIB = """
cam0:
  name: front
  camera_model: pinhole
  distortion_model: none
  intrinsics: [20.0, 20.0, 15.5, 9.5]
  distortion_coeffs: []
  resolution: [32, 20]
  T_body_cam: [[0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 1.4], [0, 0, 0, 1]]
"""


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """20 s straight east at 10 m/s, a frame each second, masks of road with a sign."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "calib.yaml").write_text(CALIB)
    (folder / "meta.json").write_text(json.dumps({"classes": CLASS_IDS}))
    times = np.arange(0.0, 21.0)
    (folder / "frames.csv").write_text(
        "frame,t,variant\n" + "".join(f"{k:06d},{t},noon\n" for k, t in enumerate(times))
    )
    mask = np.full((20, 32), CLASS_IDS["road"], np.uint8)
    mask[2:6, 20:28], mask[:2] = CLASS_IDS["sign"], CLASS_IDS["sky"]
    (folder / "sem" / "front").mkdir(parents=True)
    (folder / "rgb" / "front").mkdir(parents=True)
    for k in range(len(times)):
        cv2.imwrite(str(folder / "sem" / "front" / f"{k:06d}.png"), mask)
        cv2.imwrite(str(folder / "rgb" / "front" / f"{k:06d}.png"), np.full((20, 32, 3), 120, np.uint8))
    T = np.tile(np.eye(4), (201, 1, 1))
    T[:, 0, 3] = np.arange(201)
    write_tum(Trajectory(np.arange(201) / 10.0, T), folder / "poses_body.tum")
    rows = "".join(f"{t:.2f},10.0,0.0\n" for t in np.arange(0.0, 20.001, 0.1))
    (folder / "wheel_odom.csv").write_text("t,v_m_s,yaw_rate_rad_s\n" + rows)
    rows = "".join(f"{t:.2f},{10 * t:.2f},0,0,1.3,1.3,2.5\n" for t in np.arange(0.0, 20.001, 0.2))
    (folder / "gps.csv").write_text("t,east_m,north_m,up_m,sigma_e,sigma_n,sigma_u\n" + rows)
    rows = "".join(f"{t:.2f},0,0,0,0,0,9.81\n" for t in np.arange(0.0, 20.001, 0.1))
    (folder / "imu.csv").write_text("t,gx_rad_s,gy,gz,ax_m_s2,ay,az\n" + rows)
    return read_drive(folder)


@pytest.fixture(scope="module")
def road():
    x = np.arange(-20.0, 260.0, 20.0)
    line = MapElement("line", ElementClass.LANE_MARKING, np.column_stack([x, np.full_like(x, 2.0), np.zeros_like(x)]))
    poles = [
        MapElement(f"pole{k}", ElementClass.POLE, np.array([[k, -4.0, 0.0], [k, -4.0, 3.0]]), radius_m=0.1)
        for k in range(0, 240, 30)
    ]
    return SemanticMap((line, *poles))


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_leaves_a_whole_drive_and_is_repeatable(drive, road, name):
    one, other = with_fault(name, drive, road, seed=3), with_fault(name, drive, road, seed=3)
    first, last = one.drive.frames[0].time_s, one.drive.frames[-1].time_s
    assert first <= one.from_s <= one.to_s <= last and one.name == name
    times = np.array([frame.time_s for frame in one.drive.frames])
    assert (np.diff(times) > 0).all()
    for log in ("gnss", "odometry", "imu"):
        assert np.array_equal(getattr(one.drive, log).time_s, getattr(other.drive, log).time_s)
    assert np.array_equal(one.drive.gnss.p_enu, other.drive.gnss.p_enu)
    assert one.drive.truth_at(one.drive.frames[-1]).shape == (4, 4)


def test_fixes_drop_out_stop_and_jump(drive, road):
    dropped = with_fault("gnss_dropout", drive, road)
    gaps = np.diff(dropped.drive.gnss.time_s)
    assert gaps.max() == pytest.approx(5.2, abs=0.21) and (gaps > 0.25).sum() == 1
    assert dropped.to_s - dropped.from_s == pytest.approx(5.0)
    stopped = with_fault("no_gnss_after_start", drive, road)
    assert stopped.drive.gnss.time_s[-1] < 2.0 and len(stopped.drive.gnss.time_s) == 10
    outliers = with_fault("gnss_outliers", drive, road, seed=1, sizes=FaultSizes(outlier_share=0.3))
    off = np.linalg.norm(outliers.drive.gnss.p_enu - drive.gnss.p_enu, axis=1)
    assert set(np.round(off, 6)) == {0.0, 20.0}
    assert 0.2 < np.mean(off > 0) < 0.4


def test_images_and_masks_are_changed_in_the_window_only(drive, road):
    for name, value in (("black_images", CLASS_IDS["road"]), ("occlusion", CLASS_IDS["vehicle"])):
        faulty = with_fault(name, drive, road)
        inside = [f for f in faulty.drive.frames if faulty.from_s <= f.time_s < faulty.to_s]
        outside = [f for f in faulty.drive.frames if not faulty.from_s <= f.time_s < faulty.to_s]
        assert len(inside) == 3
        assert all((frame.mask("sem", "front") == value).all() for frame in inside)
        assert all((frame.mask("sem", "front") == CLASS_IDS["sign"]).any() for frame in outside)
    black = with_fault("black_images", drive, road)
    frame = next(f for f in black.drive.frames if f.time_s >= black.from_s)
    assert not frame.image("front").any() and drive.frames[0].image("front").any()


def test_wrong_class_table_says_something_else_with_the_same_shapes(drive, road):
    faulty = with_fault("wrong_class_table", drive, road)
    frame = next(f for f in faulty.drive.frames if f.time_s >= faulty.from_s)
    mask = frame.mask("sem", "front")
    # What is sky in Cityscapes reads as a solid lane in the drive's own table.
    assert (mask[0] == CLASS_IDS["lane_solid"]).all() and (mask[3, 24] == 7) and (mask[10] == 0).all()


def test_wheels_fall_silent_for_two_seconds(drive, road):
    faulty = with_fault("no_odometry", drive, road)
    assert np.diff(faulty.drive.odometry.time_s).max() == pytest.approx(2.1, abs=0.11)
    assert len(faulty.drive.imu.time_s) == len(drive.imu.time_s)


def test_clock_and_camera_are_off_by_what_is_stated(drive, road):
    late = with_fault("time_offset", drive, road).drive
    assert np.allclose(late.odometry.time_s - drive.odometry.time_s, 0.05)
    assert np.allclose(late.gnss.time_s - drive.gnss.time_s, 0.05)
    assert late.frames[3].time_s == drive.frames[3].time_s
    bumped = with_fault("camera_pitch", drive, road).drive
    axis, before = bumped.rig.T_base_cam[0][:3, 2], drive.rig.T_base_cam[0][:3, 2]
    assert np.degrees(np.arcsin(axis[2])) - np.degrees(np.arcsin(before[2])) == pytest.approx(1.0)
    assert np.array_equal(bumped.frames[5].rig.T_base_cam, bumped.rig.T_base_cam)


def test_a_kidnapped_vehicle_is_30_m_farther_a_moment_later(drive, road):
    faulty = with_fault("kidnapped", drive, road)
    frames = faulty.drive.frames
    x = np.array([faulty.drive.truth_at(frame)[0, 3] for frame in frames])
    steps = np.diff(x)
    assert np.sort(steps)[-1] == pytest.approx(30.0) and np.sort(steps)[-2] == pytest.approx(10.0)
    landed = frames[int(np.argmax(steps)) + 1]
    assert landed.time_s == pytest.approx(faulty.from_s)
    assert np.allclose(np.diff([frame.time_s for frame in frames]), 1.0)
    # The wheels know nothing of it; the satellites do.
    moved = faulty.drive.odometry.relative_motion(landed.time_s - 1.0, landed.time_s)
    assert moved[0, 3] == pytest.approx(10.0)
    east = np.interp(landed.time_s, faulty.drive.gnss.time_s, faulty.drive.gnss.p_enu[:, 0])
    assert east == pytest.approx(x[np.argmax(steps) + 1], abs=0.1)


def test_the_map_ends_in_front_of_the_vehicle(drive, road):
    faulty = with_fault("off_map", drive, road)
    edge = faulty.drive.truth_at(min(faulty.drive.frames, key=lambda f: abs(f.time_s - faulty.from_s)))[0, 3]
    assert faulty.semantic_map.extent[1, 0] <= edge
    names = {element.id for element in faulty.semantic_map.elements}
    assert names == {"line"} | {f"pole{k}" for k in range(0, 240, 30) if k <= edge}
    line = next(e for e in faulty.semantic_map.elements if e.id == "line")
    assert line.points[-1, 0] == edge - edge % 20.0


def test_unknown_faults_and_missing_sensors_are_told(drive, road):
    with pytest.raises(SemlocError, match="expected one of none, gnss_dropout"):
        with_fault("earthquake", drive, road)
    with pytest.raises(SemlocError, match="no satellite fixes"):
        with_fault("gnss_outliers", replace(drive, gnss=None), road)
    with pytest.raises(SemlocError, match="goes on for"):
        with_fault("kidnapped", drive, road, sizes=FaultSizes(jump_m=300.0))


@pytest.mark.parametrize("name", sorted(set(STANDING) - {"dashes_along", "other_masks", "masks_mirrored"}))
def test_every_standing_fault_grows_with_its_severity_or_says_what_it_needs(name, drive, road):
    """Something of the drive or the map is other than before, for all of its time, the same for the same seed."""
    for severity in (1, 2, 3):
        fault = with_fault(f"{name}:{severity}", drive, road)
        assert (fault.name, fault.from_s, fault.to_s) == (f"{name}:{severity}", 0.0, 20.0)
        assert _told_apart(fault) != _told_apart(with_fault("none", drive, road))
        assert _told_apart(fault) == _told_apart(with_fault(f"{name}:{severity}", drive, road))


def _told_apart(fault):
    """What a fault may change, as text: map, calibration, fixes, masks of three frames."""
    masks = [frame.mask("sem", "front").tobytes() for frame in fault.drive.frames[:3]]
    elements = [(e.id, e.points.round(6).tolist()) for e in fault.semantic_map.elements]
    camera = [float(getattr(fault.drive.rig.cameras[0], key)) for key in ("fx", "fy", "cx", "cy")]
    gnss = fault.drive.gnss
    return repr(
        (elements, camera, fault.drive.rig.T_base_cam.tolist(), gnss.p_enu.tolist(), gnss.sigma_m.tolist(), masks)
    )


def test_fixes_move_to_the_left_of_the_way_by_the_size(drive, road):
    fault = with_fault("fixes_left:2", drive, road)
    np.testing.assert_allclose(fault.drive.gnss.p_enu - drive.gnss.p_enu, [[0.0, 3.5, 0.0]] * len(drive.gnss.time_s))
    sure = with_fault("fixes_too_sure:2", drive, road).drive.gnss
    assert np.hypot(*(sure.p_enu - drive.gnss.p_enu)[0, :2]) == pytest.approx(2.0)
    assert (sure.sigma_m == 0.1).all()


def test_repainted_lines_move_and_what_stands_stays(drive):
    def line(name, label):
        return MapElement(name, label, np.array([[5.0, 2.0, 0.0], [9.0, 2.0, 0.0]]), width_m=0.1)

    given = SemanticMap((line("line", ElementClass.LANE_MARKING), line("post", ElementClass.POLE)))
    moved = with_fault("lines_repainted:3", drive, given).semantic_map.elements
    assert moved[0].points[:, 1] == pytest.approx([3.0, 3.0])
    assert moved[1].points[:, 1] == pytest.approx([2.0, 2.0])


def test_a_yawed_calibration_looks_to_the_left(drive, road):
    rig = with_fault("camera_yaw:3", drive, road).drive.rig
    ahead = rig.T_base_cam[0, :3, 2]
    assert np.degrees(np.arctan2(ahead[1], ahead[0])) == pytest.approx(2.0)
    np.testing.assert_allclose(rig.T_base_cam[0, :3, 3], drive.rig.T_base_cam[0, :3, 3])


def test_a_severity_that_is_none_is_refused(drive, road):
    with pytest.raises(SemlocError, match="severity 4; expected 1 to 3"):
        with_fault("focal:4", drive, road)
