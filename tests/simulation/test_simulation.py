"""Simulated drives: masks without bias against independent projection, sensors with stated errors, seeds."""

import sys

import cv2
import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation

from semloc_jax.datasets import read_drive
from semloc_jax.datasets.inertial import read_imu_noise
from semloc_jax.datasets.sensors import read_imu
from semloc_jax.errors import SemlocError
from semloc_jax.maps import GeoOrigin, read_map
from semloc_jax.simulation import Degradation, SimulationConfig, degrade, simulate
from semloc_jax.simulation.motion import TrueMotion
from semloc_jax.simulation.render import render
from semloc_jax.simulation.sensor_logs import SensorErrors, SensorPlan, write_sensor_logs
from semloc_jax.structs import ElementClass, InertialNoise

CLEAN = SimulationConfig(num_frames=3, width_px=640, height_px=400, wear_share=0.0, has_images=False)


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    return simulate("road", 5, tmp_path_factory.mktemp("road"), CLEAN)


@pytest.fixture(scope="module")
def garage(tmp_path_factory):
    config = SimulationConfig(num_frames=2, width_px=480, height_px=360, wear_share=0.0, has_images=False)
    return simulate("garage", 5, tmp_path_factory.mktemp("garage"), config)


def densified(ring, spacing_m):
    """Points along an outline, by shapely instead of the package's own sampling."""
    line = shapely.LineString(ring)
    return np.array([line.interpolate(s).coords[0] for s in np.arange(0.0, line.length, spacing_m)])


def outline_of(element):
    """Outline [k 3] of paint and signs; lines as ribbons made by shapely, at the height of their centre line."""
    if element.closed:
        return np.vstack([element.points, element.points[:1]])
    ribbon = shapely.LineString(element.points[:, :2]).buffer(0.5 * element.width_m, cap_style="flat")
    xy = np.array(ribbon.exterior.coords)
    nearest = np.argmin(np.linalg.norm(xy[:, None] - element.points[None, :, :2], axis=2), axis=1)
    return np.column_stack([xy, element.points[nearest, 2]])


def projector(drive, name):
    """OpenCV's projection for a camera of the drive: the oracle."""
    camera = drive.rig.cameras[drive.rig.index(name)]
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=float)

    def project(p_cam):
        if hasattr(camera, "p1"):
            d = np.array([float(v) for v in (camera.k1, camera.k2, camera.p1, camera.p2)])
            uv, _ = cv2.projectPoints(p_cam, np.zeros(3), np.zeros(3), K, d)
        else:
            d = np.array([float(v) for v in (camera.k1, camera.k2, camera.k3, camera.k4)])
            uv, _ = cv2.fisheye.projectPoints(p_cam[:, None], np.zeros(3), np.zeros(3), K, d)
        return uv[:, 0]

    return project


def border_offsets(mask, class_id, uv, normal, reach_px=2.5):
    """Signed distance [px] along the outward `normal` from each projected contour point to the border of the class.

    Where something stands in front there is another border or none: those points, and borders farther off than a
    pixel grid can put them, are left out.
    """
    steps = np.arange(-reach_px, reach_px + 1e-6, 0.02)
    places = np.round(uv[:, None] + steps[None, :, None] * normal[:, None]).astype(int)
    h, w = mask.shape
    inside = ((places >= 0) & (places < [w, h])).all(axis=(1, 2))
    profile = mask[places[inside, :, 1], places[inside, :, 0]] == class_id
    changes = profile[:, 1:] != profile[:, :-1]
    single = (changes.sum(axis=1) == 1) & profile[:, 0]
    offsets = steps[1:][np.argmax(changes[single], axis=1)] - 0.01
    return offsets[np.abs(offsets) < 1.0]


def contour_bias(drive, labels, max_range_m):
    offsets = []
    elements = [e for e in read_map(drive.map_path).elements if e.label in labels and not e.is_logical]
    for frame in drive.frames:
        for name, T_base_cam in zip(drive.rig.names, np.asarray(drive.rig.T_base_cam), strict=True):
            T_cam_map = np.linalg.inv(drive.truth_at(frame) @ T_base_cam)
            mask, project = frame.mask("sem", name), projector(drive, name)
            for element in elements:
                ring = densified(outline_of(element), 0.02)
                p_cam = ring @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]
                seen = (p_cam[:, 2] > 0.8) & (np.linalg.norm(p_cam, axis=1) < max_range_m)
                if seen.sum() < 10 or (element.label == ElementClass.SIGN and not seen.all()):
                    continue
                uv = project(np.where(seen[:, None], p_cam, [0.0, 0.0, 5.0]))
                tangent = np.roll(uv, -1, axis=0) - np.roll(uv, 1, axis=0)
                size = np.linalg.norm(tangent, axis=1)
                # Paint is seen from above; the orientation of a sign in the image says which side faces the camera.
                plan = uv * [1.0, -1.0] if element.label == ElementClass.SIGN else ring[:, :2]
                turn = np.sign(np.sum(plan[:, 0] * np.roll(plan[:, 1], -1) - plan[:, 1] * np.roll(plan[:, 0], -1)))
                normal = turn * np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.maximum(size, 1e-9)[:, None]
                class_id = drive.class_ids[str(element.attributes["class"])]
                seen &= (size > 1e-3) & np.roll(seen, 1) & np.roll(seen, -1)
                offsets.append(border_offsets(mask, class_id, uv[seen], normal[seen]))
    return np.concatenate(offsets)


ROAD_PAINT = {ElementClass.LANE_MARKING, ElementClass.STOP_LINE, ElementClass.CROSSWALK, ElementClass.ROAD_MARK}


def test_paint_borders_of_the_road_have_no_bias(road):
    offsets = contour_bias(road, ROAD_PAINT, 30.0)
    assert len(offsets) > 5000
    assert abs(offsets.mean()) < 0.03
    assert offsets.std() < 0.35


def test_sign_borders_have_no_bias(road):
    offsets = contour_bias(road, {ElementClass.SIGN}, 45.0)
    assert len(offsets) > 200
    assert abs(offsets.mean()) < 0.1


def test_paint_borders_of_fisheyes_have_no_bias(garage):
    offsets = contour_bias(garage, {ElementClass.SLOT_LINE, ElementClass.ROAD_MARK}, 12.0)
    assert len(offsets) > 2000
    assert abs(offsets.mean()) < 0.03


def test_poles_are_as_wide_as_the_map_says(road):
    """Left and right border of each pole at its middle height, against the tangents of a circle."""
    project, T_base_cam = projector(road, "front"), np.asarray(road.rig.T_base_cam)[0]
    offsets = []
    for frame in road.frames:
        T_map_cam = road.truth_at(frame) @ T_base_cam
        T_cam_map, mask = np.linalg.inv(T_map_cam), frame.mask("sem", "front")
        for element in read_map(road.map_path).elements:
            if element.label != ElementClass.POLE:
                continue
            for share in np.linspace(0.05, 0.95, 40):
                axis = (1 - share) * element.points[0] + share * element.points[1]
                radius = (1 - share) * element.radius_m + share * element.radius_top_m
                away = axis[:2] - T_map_cam[:2, 3]
                distance = np.linalg.norm(away)
                if not 5.0 < distance < 40.0 or (axis - T_map_cam[:3, 3]) @ T_map_cam[:3, 2] < 2.0:
                    continue
                for side in (-1.0, 1.0):
                    turned = np.arctan2(away[1], away[0]) + side * np.arcsin(radius / distance)
                    edge = T_map_cam[:2, 3] + np.sqrt(distance**2 - radius**2) * np.array(
                        [np.cos(turned), np.sin(turned)]
                    )
                    points = np.array([[*edge, axis[2]]])
                    uv = project(points @ T_cam_map[:3, :3].T + T_cam_map[:3, 3])
                    offsets.append(border_offsets(mask, 20, uv, np.array([[-side, 0.0]]), 2.5))
    offsets = np.concatenate(offsets)
    assert len(offsets) > 300
    assert abs(offsets.mean()) < 0.1


def test_the_vehicle_stands_on_the_road(road):
    """The height of the truth equals the height of the paint around it."""
    painted = [e for e in read_map(road.map_path).elements if e.is_painted]
    points = np.vstack([element.points for element in painted])
    for T in road.truth.T_map_base:
        near = points[np.linalg.norm(points[:, :2] - T[:2, 3], axis=1) < 4.0]
        below = (near - T[:3, 3]) @ T[:3, 2]
        assert abs(np.median(below)) < 0.03


def test_same_seed_same_drive_other_seed_another(tmp_path):
    config = SimulationConfig(num_frames=1, width_px=160, height_px=100)
    first, again, other = (
        simulate("road", seed, tmp_path / name, config) for seed, name in ((1, "a"), (1, "b"), (2, "c"))
    )
    for source in ("sem", "sem_net"):
        np.testing.assert_array_equal(first.frames[0].mask(source, "front"), again.frames[0].mask(source, "front"))
    assert (first.frames[0].mask("sem", "front") != other.frames[0].mask("sem", "front")).mean() > 0.05
    assert (tmp_path / "a" / "gps.csv").read_text() == (tmp_path / "b" / "gps.csv").read_text()


def test_sensors_have_the_stated_errors(road):
    drive = read_drive(road.path)
    assert drive.odometry.time_s[0] <= -2.9 and drive.imu.time_s[-1] > drive.frames[-1].time_s
    fixes = drive.gnss
    gaps = np.diff(fixes.time_s)
    assert 1.4 < gaps.max() < 2.0
    first, last = drive.truth.T_map_base[0], drive.truth.T_map_base[-1]
    span = drive.frames[-1].time_s - drive.frames[0].time_s
    motion = np.linalg.inv(first) @ last
    driven = drive.odometry.relative_motion(drive.frames[0].time_s, drive.frames[-1].time_s)
    assert np.linalg.norm(driven[:2, 3] - motion[:2, 3]) < 0.03 * np.linalg.norm(motion[:3, 3])
    inside = (drive.imu.time_s > drive.frames[0].time_s) & (drive.imu.time_s < drive.frames[-1].time_s)
    turn = Rotation.from_matrix(motion[:3, :3]).as_rotvec() / span
    np.testing.assert_allclose(drive.imu.gyro_radps[inside].mean(axis=0), turn, atol=0.006)
    assert np.linalg.norm(drive.imu.accel_mps2.mean(axis=0)) == pytest.approx(9.81, abs=0.3)


@pytest.mark.parametrize("rate_hz", [100.0, pytest.param(400.0, marks=pytest.mark.slow)])
def test_the_inertial_log_has_the_noise_of_its_imu_yaml(tmp_path, rate_hz):
    errors = SensorErrors(inertial=InertialNoise(4e-4, 8e-3, 1e-3, 2e-2))
    plan, origin = SensorPlan(errors, rate_hz, has_gnss=False), GeoOrigin(48.0, 11.0, 0.0)
    write_sensor_logs(tmp_path, Standing(), 0.0, 400.0, plan, origin, np.random.default_rng(3))
    noise, imu = read_imu_noise(tmp_path / "imu.yaml"), read_imu(tmp_path / "imu.csv")
    assert noise == errors.inertial
    for readings, density, walk in (
        (imu.gyro_radps, noise.gyro_density, noise.gyro_walk),
        (imu.accel_mps2, noise.accel_density, noise.accel_walk),
    ):
        white = np.diff(readings, axis=0).std() / np.sqrt(2.0 * rate_hz)
        assert white == pytest.approx(density, rel=0.03)
        # Means of 10 s differ by what the bias does in between: two thirds of 10 s of its walk.
        means = readings[: 40 * round(10 * rate_hz)].reshape(40, -1, 3).mean(axis=1)
        expected = np.sqrt(walk**2 * 10.0 * 2 / 3 + 2 * density**2 / 10.0)
        assert np.diff(means, axis=0).std() == pytest.approx(expected, rel=0.25)


class Standing(TrueMotion):
    """A vehicle that does not move."""

    def poses(self, time_s):
        return np.tile(np.eye(4), (len(time_s), 1, 1))


def test_the_prior_of_a_simulated_drive_is_usable(road):
    for frame in road.frames:
        T = road.truth_at(frame)
        prior = road.gnss_prior(frame.time_s)
        heading = np.arctan2(T[1, 0], T[0, 0])
        assert abs((np.degrees(prior.heading_rad - heading) + 180) % 360 - 180) < 5.0
        assert np.linalg.norm((prior.p_enu - T[:3, 3])[:2]) < 4.0


def test_degraded_masks_carry_the_half_pixel_of_their_half_resolution():
    """Without any other fault a vertical border moves by half a pixel to the right on average."""
    mask = np.ones((200, 400), dtype=np.uint8)
    for row in range(200):
        mask[row, 100 + row % 7 :] = 4
    quiet = Degradation(0.0, 6.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    shifted = degrade(mask, np.random.default_rng(0), quiet)
    exact = (mask[::2] == 1).sum(axis=1).mean()
    assert (shifted[::2] == 1).sum(axis=1).mean() - exact == pytest.approx(0.5, abs=0.1)


def test_degraded_masks_stay_recognisable(road):
    mask = road.frames[0].mask("sem", "front")
    net = road.frames[0].mask("sem_net", "front")
    assert 0.005 < (mask != net).mean() < 0.08
    painted = np.isin(mask, [10, 11])
    assert (np.isin(net, [10, 11]) & painted).sum() > 0.5 * painted.sum()


def test_map_with_errors_is_the_map_with_the_logged_errors(tmp_path):
    drive = simulate("garage", 2, tmp_path, SimulationConfig(num_frames=1, width_px=64, height_px=48))
    exact = {e.id: e for e in read_map(drive.maps["exact"]).elements}
    faulty = {e.id: e for e in read_map(drive.maps["errors"]).elements}
    missing = set(exact) - set(faulty)
    assert 0.02 < len(missing) / len(exact) < 0.2
    assert all(name.startswith("phantom") for name in set(faulty) - set(exact))
    moved = [np.abs(faulty[k].points - exact[k].points).max() for k in set(exact) & set(faulty)]
    assert 0.04 < np.mean(np.array(moved) > 1e-3) < 0.25


def test_each_picture_is_rendered_once(tmp_path, monkeypatch):
    rendered = []

    def counted(*args):
        rendered.append(args)
        return render(*args)

    module = sys.modules["semloc_jax.simulation.pictures"]
    monkeypatch.setattr(module, "render", counted)
    simulate("road", 1, tmp_path, SimulationConfig(num_frames=2, width_px=64, height_px=40))
    assert len(rendered) == 2


@pytest.mark.parametrize(
    ("kind", "config", "says"),
    [
        ("boat", SimulationConfig(), "unknown kind 'boat'"),
        ("road", SimulationConfig(num_frames=0), "num_frames = 0"),
        ("road", SimulationConfig(variants=("snow",)), "unknown variant 'snow'"),
    ],
)
def test_wrong_requests_are_named(tmp_path, kind, config, says):
    with pytest.raises(SemlocError, match=says):
        simulate(kind, 1, tmp_path, config)
