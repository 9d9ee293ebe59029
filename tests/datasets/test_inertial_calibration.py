"""Noise and clock of an inertial sensor, as files in and beside a drive state them."""

import shutil

import numpy as np
import pytest
import yaml

from semloc_jax.datasets import open_drive
from semloc_jax.datasets.inertial import imu_yaml, read_imu_noise
from semloc_jax.errors import SemlocError
from semloc_jax.structs import InertialNoise
from tests.datasets.layouts import write_euroc

OWN, OTHER = InertialNoise(1e-4, 2e-3, 3e-5, 4e-4), InertialNoise(5e-4, 6e-3, 7e-5, 8e-4)


def test_a_drive_has_the_noise_of_its_imu_yaml_and_of_one_beside_a_calibration_before_it(simulated_road, tmp_path):
    drive = tmp_path / "drive"
    shutil.copytree(simulated_road, drive)
    (drive / "imu.yaml").write_text(imu_yaml(OWN))
    assert open_drive(drive).imu.noise == OWN
    (tmp_path / "calib.yaml").write_text((drive / "calib.yaml").read_text())
    assert open_drive(drive, tmp_path / "calib.yaml").imu.noise == OWN
    (tmp_path / "imu.yaml").write_text(yaml.safe_dump({"imu0": yaml.safe_load(imu_yaml(OTHER))}))
    assert open_drive(drive, tmp_path / "calib.yaml").imu.noise == OTHER
    (drive / "imu.yaml").unlink()
    assert open_drive(drive).imu.noise == InertialNoise()


def test_an_imu_yaml_of_something_else_costs_itself_only(simulated_road, tmp_path, caplog):
    drive = tmp_path / "drive"
    shutil.copytree(simulated_road, drive)
    (drive / "imu.yaml").write_text("topic: /imu0\n")
    assert open_drive(drive).imu.noise == InertialNoise()
    assert "gyroscope_noise_density" in caplog.text


def test_the_clock_of_a_camchain_counts_for_every_verb(simulated_road, tmp_path):
    chain = yaml.safe_load((simulated_road / "calib.yaml").read_text())
    chain["cam0"]["timeshift_cam_imu"] = 0.02
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump(chain))
    before, after = open_drive(simulated_road).imu, open_drive(simulated_road, tmp_path / "camchain.yaml").imu
    np.testing.assert_allclose(after.time_s, before.time_s - 0.02, atol=1e-9)
    np.testing.assert_array_equal(after.gyro_radps, before.gyro_radps)


def test_the_sensor_file_of_euroc_states_it_too(tmp_path):
    folder = write_euroc(tmp_path / "MH_01")
    assert open_drive(folder).imu.noise == InertialNoise()
    path = folder / "mav0" / "imu0" / "sensor.yaml"
    path.write_text(path.read_text() + imu_yaml(OWN))
    assert open_drive(folder).imu.noise == OWN


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("gyroscope_noise_density: 1e-4\n", "accelerometer_noise_density"),
        (imu_yaml(OWN).replace("0.0001", "0"), "expected a positive density"),
    ],
)
def test_an_imu_yaml_that_is_none_is_named(tmp_path, text, says):
    (tmp_path / "imu.yaml").write_text(text)
    with pytest.raises(SemlocError, match=says):
        read_imu_noise(tmp_path / "imu.yaml")
