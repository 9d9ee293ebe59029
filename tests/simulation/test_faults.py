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
from semloc_jax.geometry import rigid
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.simulation.faults import FAULTS, FaultSizes, with_fault
from semloc_jax.simulation.hostile import is_suite, suite
from semloc_jax.simulation.standing_faults import FAMILIES, STANDING
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


_NEEDS_MORE = {
    "dashes_along": "dashed lines",
    "other_masks": "frames that differ",
    "masks_mirrored": "masks that are not symmetric in every drawn frame",
    "distortion": "a lens with distortion",
    "one_camera_yaw": "several cameras",
    "one_camera_pitch": "several cameras",
    "paint_lost": "paint in the masks",
    "false_lines": "paint in the masks",
    "gyro_scale": "a vehicle that turns",
    "odometer_stuck": "a speed that changes",
    "map_widths": "lines with a width",
    "masks_rotated": "masks of more than 32 pixels",
    "masks_scaled": "masks of more than 32 pixels",
    "frames_missing": "more than 20 frames",
}


@pytest.mark.parametrize("name", sorted(set(STANDING) - set(_NEEDS_MORE)))
def test_every_standing_fault_changes_the_drive_for_all_of_its_time(name, drive, road):
    """Something of the drive or the map is other than before, the same for the same seed."""
    for severity in (1, 2, 3):
        fault = with_fault(f"{name}:{severity}", drive, road)
        assert fault.name == f"{name}:{severity}" and fault.from_s < 1.0 and fault.to_s > 19.0
        assert _told_apart(fault) != _told_apart(with_fault("none", drive, road))
        assert _told_apart(fault) == _told_apart(with_fault(f"{name}:{severity}", drive, road))


def _told_apart(fault):
    """What a fault may change, as text: map, calibration, clocks, wheels, gyroscope, fixes, masks of six frames."""
    masks = [frame.mask("sem", "front").tobytes() for frame in fault.drive.frames[:6]]
    elements = [(e.id, e.width_m, e.points.round(6).tolist()) for e in fault.semantic_map.elements]
    camera = [float(getattr(fault.drive.rig.cameras[0], key)) for key in ("fx", "fy", "cx", "cy")]
    gnss, wheels, imu = fault.drive.gnss, fault.drive.odometry, fault.drive.imu
    logs = [gnss.time_s, gnss.p_enu, gnss.sigma_m, wheels.time_s, wheels.speed_mps, imu.time_s, imu.gyro_radps]
    times = [frame.time_s for frame in fault.drive.frames]
    told = (elements, camera, fault.drive.rig.T_base_cam.tolist(), [log.tolist() for log in logs], times, masks)
    return repr(told)


def test_masks_of_the_next_frame_are_those_of_a_camera_farther_ahead(drive, road):
    """At constant speed: one way for every frame, which no pose of the vehicle differs by. Masks of a place a fifth of
    the drive away are seen at its end, where they begin anew, and by satellites."""
    frames = with_fault("other_masks:1", drive, road).drive.frames[:-1]
    ways = [rigid.inverse(drive.truth_at(frame)) @ drive.truth_at(frame.shown) for frame in frames]
    np.testing.assert_allclose(ways, np.broadcast_to(ways[0], (len(ways), 4, 4)), atol=1e-6)
    np.testing.assert_allclose(ways[0], rigid.exp(np.array([10.0, 0.0, 0.0, 0.0, 0.0, 0.0])), atol=1e-6)
    assert [bool(row.apart) for row in suite("other_masks")] == [True, False, False]


def test_the_suite_is_wide_and_every_row_has_a_size():
    rows = suite()
    faults = {row.fault for row in rows if row.severity}
    assert len(faults) >= 40 and len(rows) == 3 * len(faults) + 1
    assert {row.family for row in rows if row.severity} == set(FAMILIES)
    assert all(row.size for row in rows if row.severity)
    unseen = {"map_shifted", "map_turned", "map_scaled", "camera_ahead", "camera_aside", "other_masks"}
    assert {row.fault for row in rows if row.apart} == unseen
    assert [row.name for row in suite("focal, none")] == ["none", "focal:1", "focal:2", "focal:3"]
    assert {row.family for row in suite("time")} == {"time"} and is_suite("time") and not is_suite("focal:2")
    with pytest.raises(SemlocError, match="fault 'earthquake': not known; expected all, a family"):
        suite("earthquake")


def test_a_passing_fault_lasts_longer_the_worse_it_is(drive, road):
    lengths = [(fault := with_fault(f"black_images:{k}", drive, road)).to_s - fault.from_s for k in (1, 2, 3)]
    assert lengths == pytest.approx([1.0, 3.0, 6.0])
    with pytest.raises(SemlocError, match="severity 0; expected 1 to 3"):
        with_fault("black_images:bad", drive, road)


def test_a_jittering_clock_keeps_the_places_and_the_order(drive, road):
    fault = with_fault("frames_jitter:3", drive, road).drive
    stated = np.array([frame.time_s for frame in fault.frames])
    taken = np.array([frame.time_s for frame in drive.frames])
    assert (np.diff(stated) > 0).all() and 0.02 < np.std(stated - taken) < 0.12
    for old, new in zip(drive.frames, fault.frames, strict=True):
        np.testing.assert_allclose(fault.truth_at(new), drive.truth_at(old), atol=1e-9)


def test_a_spoofer_pulls_evenly_and_says_it_is_sure(drive, road):
    fixes = with_fault("fixes_spoofed:2", drive, road).drive.gnss
    np.testing.assert_allclose(fixes.p_enu[:, 1], 6.0 * fixes.time_s / 20.0, atol=1e-9)
    assert (fixes.sigma_m == 0.05).all()


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
