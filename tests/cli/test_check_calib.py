"""`semloc check-calib`: numbers and pictures of a drive or a file, warnings and exit codes."""

import shutil

import cv2
import numpy as np
import pytest
import yaml

from semloc_jax.cli.main import FAILED, LOST, OK, main


def test_a_drive_gives_pictures_and_no_warning(simulated_road, tmp_path, capsys):
    assert main(["check-calib", str(simulated_road), "--out", str(tmp_path), "--strict"]) == OK
    said = capsys.readouterr().out
    assert "front: BrownConradyCamera 480x300 px" in said and "z 1.43 m" in said
    assert "nothing implausible found" in said
    picture = cv2.imread(str(tmp_path / "calib_front.png"))
    assert picture.shape[1] == 1520 and picture.std() > 20
    assert (tmp_path / "calib_top_view.png").is_file()


def test_a_map_drawn_from_satellite_fixes_is_said_to_be(simulated_road, tmp_path, caplog):
    drive = shutil.copytree(simulated_road, tmp_path / "drive")
    assert main(["check-calib", str(drive), "--out", str(tmp_path / "truth")]) == OK
    assert "satellite fixes" not in caplog.text
    poses = (drive / "poses_body.tum").rename(tmp_path / "kept.tum")
    assert main(["check-calib", str(drive), "--out", str(tmp_path / "fixes")]) == OK
    assert "the map is drawn where the satellite fixes put the vehicle" in caplog.text
    caplog.clear()
    assert main(["check-calib", str(drive), "--poses", str(poses), "--out", str(tmp_path / "given")]) == OK
    assert "satellite fixes" not in caplog.text


@pytest.fixture
def wrong(simulated_road, tmp_path):
    """A drive whose camera stands under the ground."""
    drive = shutil.copytree(simulated_road, tmp_path / "drive")
    content = yaml.safe_load((drive / "calib.yaml").read_text())
    content["cam0"]["T_body_cam"][2][3] = -1.4
    (drive / "calib.yaml").write_text(yaml.safe_dump(content))
    return drive


def test_a_wrong_calibration_is_warned_of(wrong, tmp_path, capsys):
    assert main(["check-calib", str(wrong), "--out", str(tmp_path / "a")]) == OK
    assert "warning: front: sits 1.40 m under the ground" in capsys.readouterr().out
    assert main(["check-calib", str(wrong), "--out", str(tmp_path / "b"), "--strict"]) == LOST


def test_a_file_alone_and_with_a_picture(simulated_road, tmp_path, capsys):
    file = str(simulated_road / "calib.yaml")
    assert main(["check-calib", file, "--out", str(tmp_path / "none")]) == OK
    said = capsys.readouterr().out
    assert "nothing implausible found" in said and "no picture: no image to draw on; give --image FILE" in said
    assert "-0.0 deg" not in said
    assert not (tmp_path / "none").exists()
    cv2.imwrite(str(tmp_path / "big.png"), np.full((600, 960, 3), 80, np.uint8))
    assert main(["check-calib", file, "--image", str(tmp_path / "big.png"), "--out", str(tmp_path / "out")]) == OK
    assert "pictures are 960x600 px, the calibration is for 480x300 px" in capsys.readouterr().out
    assert (tmp_path / "out" / "calib_front.png").is_file()


@pytest.mark.data
def test_a_log_without_pictures_is_checked_by_its_numbers(data_dir, tmp_path, capsys):
    pytest.importorskip("pyarrow")
    if not (data_dir / "av2_7fab2350").is_dir():
        pytest.skip(f"no av2_7fab2350 in {data_dir}")
    assert main(["check-calib", str(data_dir / "av2_7fab2350"), "--out", str(tmp_path / "out"), "--strict"]) == OK
    said = capsys.readouterr()
    assert "ring_side_left: PinholeCamera 2048x1550 px" in said.out and "nothing implausible found" in said.out
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["no/such/thing"], "no such file"),
        (["DRIVE", "--frame", "99"], "no frame 99; it has 3 frames"),
        (["DRIVE", "--cameras", "rear"], "camera 'rear': not in the calibration"),
        (["DRIVE/calib.yaml", "--image", "no.png"], "image no.png: no such file"),
    ],
)
def test_bad_input_is_one_line(simulated_road, tmp_path, capsys, words, message):
    words = [word.replace("DRIVE", str(simulated_road)) for word in words]
    assert main(["check-calib", *words, "--out", str(tmp_path / "out")]) == FAILED
    said = capsys.readouterr().err.strip()
    assert message in said and len(said.splitlines()) == 1
