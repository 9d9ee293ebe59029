"""A stranger's folder: what is there, what is missing, templates that nobody can use by mistake, the next command."""

import cv2
import numpy as np
import pytest
import yaml

from semloc_jax.cli.main import FAILED, OK, main
from semloc_jax.datasets import open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.first_look import first_look
from semloc_jax.perception import load_class_table


@pytest.fixture
def folder(tmp_path):
    """Images and masks of one camera in folders called `front`; nothing else."""
    for kind, pixel in (("images", (90, 90, 90)), ("masks", 0)):
        (tmp_path / "mine" / kind / "front").mkdir(parents=True)
        for name in ("000", "001"):
            image = np.full((40, 64, 3) if kind == "images" else (40, 64), pixel, np.uint8)
            cv2.imwrite(str(tmp_path / "mine" / kind / "front" / f"{name}.png"), image)
    return tmp_path / "mine"


def _filled_in(text):
    numbers = {
        "FX": "60.0",
        "FY": "60.0",
        "CX": "31.5",
        "CY": "19.5",
        "K1": "0.0",
        "K2": "0.0",
        "P1": "0.0",
        "P2": "0.0",
    }
    numbers |= {"X_FORWARD": "1.6", "Y_LEFT": "0.0", "Z_UP": "1.4"}
    for word, number in numbers.items():
        text = text.replace(word, number)
    return text


def test_a_bare_folder_gets_templates_and_the_next_command(folder, capsys):
    assert main(["init", str(folder)]) == OK
    said = capsys.readouterr().out
    assert "camera front: 2 pictures of 64x40 px" in said
    for name in ("calibration", "gps.csv", "wheel_odom.csv", "times.csv", "map"):
        assert f"missing  {name}" in said
    assert "Columns: t,lat_deg,lon_deg,alt_m" in said and "Columns: t,v_m_s,yaw_rate_rad_s" in said
    assert said.strip().splitlines()[-1].startswith(f"next: fill in {folder / 'calib.yaml'}, then: semloc check-calib")


def test_templates_are_no_data_until_they_are_filled_in(folder):
    first_look(folder)
    with pytest.raises(SemlocError, match="calib.yaml"):
        open_drive(folder)
    with pytest.raises(SemlocError, match="'ids' must map names to numbers"):
        load_class_table(folder / "classes.yaml")
    calib, classes = folder / "calib.yaml", folder / "classes.yaml"
    calib.write_text(_filled_in(calib.read_text()))
    text = classes.read_text()
    for word, number in (("LANE_ID", "1"), ("POLE_ID", "2"), ("CAR_ID", "3")):
        text = text.replace(word, number)
    classes.write_text(text)
    drive = open_drive(folder)
    assert drive.rig.names == ("front",) and drive.rig.cameras[0].resolution == (64, 40)
    np.testing.assert_allclose(drive.rig.T_base_cam[0] @ [0.0, 0.0, 1.0, 1.0], [2.6, 0.0, 1.4, 1.0])  # looks ahead
    assert len(load_class_table(classes).channels) == 2
    look = first_look(folder)
    assert look.written == () and any("2 frames in all" in line for line in look.found)
    assert look.command.startswith(f"semloc localize {folder} --map MAP --masks masks --class-table")


def test_folders_of_other_names_are_told_with_how_to_rename_them(folder):
    (folder / "images").rename(folder / "photos")
    (folder / "masks").rename(folder / "seg")
    for name in ("photos", "seg"):
        for file in (folder / name / "front").iterdir():
            file.rename(folder / name / file.name)
        (folder / name / "front").rmdir()
    look = first_look(folder)
    assert look.found == ("photos/: 2 photographs", "seg/: 2 pictures of ids")
    moves = f"mv {folder / 'photos'} {folder / 'images'}; mv {folder / 'seg'} {folder / 'masks'}"
    assert look.command == f"{moves}; semloc init {folder}"
    grey = np.arange(40 * 64, dtype=np.uint8).reshape(40, 64)
    cv2.imwrite(str(folder / "photos" / "000.png"), grey)
    assert first_look(folder).found == look.found  # a camera without colour takes photographs too
    cv2.imwrite(str(folder / "seg" / "000.png"), grey)
    assert "mv" not in first_look(folder).command  # two of a kind: which is which is the owner's to say


def test_files_of_other_names_are_named(folder):
    """What a person has lying there: gnss.csv is read, a map and intrinsics of another name can be given."""
    (folder / "gnss.csv").write_text("timestamp,latitude,longitude\n0.0,48.0,11.0\n")
    (folder / "town.osm").write_text("<osm/>")
    (folder / "camera.yaml").write_text(
        "%YAML:1.0\n---\nimage_width: 64\nimage_height: 40\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n"
        "   dt: d\n   data: [60., 0., 31.5, 0., 60., 19.5, 0., 0., 1.]\ndistortion_coefficients: !!opencv-matrix\n"
        "   rows: 1\n   cols: 5\n   dt: d\n   data: [0., 0., 0., 0., 0.]\n"
    )
    look = first_look(folder)
    assert "gnss.csv: 1 rows" in look.found and not any(line.startswith("gps.csv") for line in look.missing)
    assert "calibration: intrinsics and place of each camera; intrinsics are in camera.yaml" in look.missing
    assert f"map: give --map FILE; there: {folder / 'town.osm'}" in look.missing
    assert f"--map {folder / 'town.osm'}" in look.command
    assert any("masks in masks/ with ids 0: --class-table" in line for line in look.found)


def test_what_is_there_is_never_overwritten(folder):
    (folder / "calib.yaml").write_text("mine: 1\n")
    first_look(folder)
    assert (folder / "calib.yaml").read_text() == "mine: 1\n"


def test_a_drive_with_a_layout_of_its_own_is_told(simulated_road, capsys):
    assert main(["init", str(simulated_road)]) == OK
    said = capsys.readouterr().out
    assert "3 frames of front" in said and "satellite fixes" in said and "--masks sem" in said


def test_nothing_there_is_one_line(tmp_path, capsys):
    assert main(["init", str(tmp_path / "nowhere")]) == FAILED
    assert "no such folder or file" in capsys.readouterr().err


def _with_calibration(folder, *names):
    first_look(folder)
    content = yaml.safe_load(_filled_in((folder / "calib.yaml").read_text()))
    entries = {f"cam{i}": {**content["cam0"], "name": name} for i, name in enumerate(names)}
    (folder / "calib.yaml").write_text(yaml.safe_dump(entries))


def test_the_one_camera_of_a_kalibr_file_is_the_one_folder(folder, caplog):
    """`cam0` against `front`: there is nothing else that it could be."""
    _with_calibration(folder, "cam0")
    drive = open_drive(folder)
    assert len(drive) == 2 and drive.frames[0].image("cam0").shape == (40, 64, 3)
    assert "its one folder 'front' is taken for the one camera 'cam0'" in caplog.text
    assert "nothing states times; frames are taken to be 0.1 s apart. Write times.csv: frame,t" in caplog.text


def test_names_that_do_not_fit_are_explained(folder):
    _with_calibration(folder, "cam0", "cam1")
    with pytest.raises(SemlocError, match=r"no folder for camera cam0, cam1; .*; there are front: rename the folders"):
        open_drive(folder)
    _with_calibration(folder, "cam0")
    (folder / "images" / "left").mkdir()
    with pytest.raises(SemlocError, match=r"of the cameras front, left, and the calibration knows 'cam0' alone"):
        open_drive(folder)


def test_file_names_that_do_not_fit_are_shown(folder):
    _with_calibration(folder, "front")
    for file in (folder / "masks" / "front").iterdir():
        file.rename(file.with_name(f"9{file.name}"))
    with pytest.raises(SemlocError, match=r"2 rgb of front \(000\.png \.\.\.\), 2 masks of front \(9000\.png"):
        open_drive(folder)


def test_columns_of_fixes_that_are_missing_are_named_in_both_forms(folder):
    _with_calibration(folder, "front")
    (folder / "gps.csv").write_text("t,x,y\n0.0,1.0,2.0\n")
    with pytest.raises(SemlocError, match=r"expected t, lat_deg, lon_deg, alt_m .* or t, east_m, north_m"):
        open_drive(folder)


@pytest.mark.parametrize("new_name", ["mask_{}.png", "{}_mask.png", "mask{}.png", "{}_gtFine_labelIds.png"])
def test_masks_may_be_called_by_a_word_of_their_own(folder, new_name):
    """What labelling tools and exporters put before or behind the name of the picture."""
    _with_calibration(folder, "front")
    for kind, name in (("masks", new_name), ("images", "frame_{}.png")):
        for file in (folder / kind / "front").iterdir():
            file.rename(file.with_name(name.format(file.stem)))
    drive = open_drive(folder)
    assert [frame.id for frame in drive.frames] == ["000", "001"]
    assert drive.frames[1].path("masks", "front").name == new_name.format("001")


def test_pictures_numbered_without_zeros_come_in_their_order(folder):
    """frame_10 is the tenth: as words it would come after frame_1, and each picture would get another's time."""
    _with_calibration(folder, "front")
    for kind in ("images", "masks"):
        picture = (folder / kind / "front" / "000.png").read_bytes()
        for file in (folder / kind / "front").iterdir():
            file.unlink()
        for number in (1, 2, 10):
            (folder / kind / "front" / f"frame_{number}.png").write_bytes(picture)
    (folder / "timestamps.txt").write_text("1.1\n1.2\n2.0\n")
    frames = open_drive(folder).frames
    assert [(frame.id, frame.time_s) for frame in frames] == [("frame_1", 1.1), ("frame_2", 1.2), ("frame_10", 2.0)]


def test_masks_that_count_from_another_number_are_not_guessed(folder):
    """img_0, img_1 and seg_1, seg_2: one of them is of both, and it may be of two times."""
    _with_calibration(folder, "front")
    for kind, word, first in (("images", "img", 0), ("masks", "seg", 1)):
        for number, file in enumerate(sorted((folder / kind / "front").iterdir()), first):
            file.rename(file.with_name(f"{word}_{number}.png"))
    with pytest.raises(SemlocError, match=r"no file name is shared .*img_0\.png.*seg_1\.png"):
        open_drive(folder)


def test_folders_are_called_what_they_are_called(folder):
    """`Images` and `Labels` are read as they are, and `--masks` takes the name that stands on the disk."""
    _with_calibration(folder, "front")
    (folder / "images").rename(folder / "Images")
    (folder / "masks").rename(folder / "Labels")
    assert open_drive(folder).mask_sources == ("Labels",)
    look = first_look(folder)
    assert any(line.startswith("masks in Labels/") for line in look.found) and "--masks Labels" in look.command


def test_photographs_of_another_name_beside_masks_are_not_overlooked(folder):
    """labels/ is known, cam_front/ is not: without a word the drive would have had no images."""
    (folder / "images" / "front").rename(folder / "cam_front")
    (folder / "images").rmdir()
    look = first_look(folder)
    assert look.command == f"mv {folder / 'cam_front'} {folder / 'images'}; semloc init {folder}"
    assert not (folder / "calib.yaml").exists()


def test_pictures_in_the_folder_itself_and_an_empty_folder(folder, tmp_path):
    loose = folder / "images" / "front"
    assert first_look(loose).command.startswith(f"mkdir {loose / 'images'}; mv {loose}/*.png {loose / 'images'}/;")
    (loose / "001.png").unlink()
    assert "no calibration" in first_look(loose).missing[0]  # one picture alone says nothing
    (tmp_path / "empty").mkdir()
    look = first_look(tmp_path / "empty")
    assert look.missing[0].startswith(f"pictures: {tmp_path / 'empty'} is empty") and "once" not in look.command


def test_numbers_and_logs_under_other_names_are_used(folder):
    (folder / "K.txt").write_text("60.5 0 31.5\n0 61.5 19.5\n0 0 1\n")
    (folder / "dist.txt").write_text("-0.1 0.01 0 0\n")
    (folder / "positions.csv").write_text("time;lat;lon;height\n1,5;48,0;11,0;500\n2,5;48,1;11,0;500\n")
    (folder / "timestamps.txt").write_text("1.5\n1.6\n")
    look = first_look(folder)
    assert "K.txt: its numbers are in calib.yaml" in look.found and "times of the frames: timestamps.txt" in look.found
    camera = yaml.safe_load((folder / "calib.yaml").read_text())["cam0"]
    assert camera["intrinsics"] == [60.5, 61.5, 31.5, 19.5] and camera["distortion_coeffs"] == [-0.1, 0.01, 0, 0]
    fixes = next(line for line in look.missing if line.startswith("gps.csv"))
    assert f"positions.csv has its columns: mv {folder / 'positions.csv'} {folder / 'gps.csv'}" in fixes
    (folder / "positions.csv").rename(folder / "gps.csv")
    assert "gps.csv: 2 rows" in first_look(folder).found  # semicolons, and decimal commas between them


def test_what_is_not_filled_in_is_next_and_so_is_a_log_that_cannot_be_read(folder):
    first_look(folder)
    (folder / "imu.csv").write_text("t,gx\n0,1\n")
    look = first_look(folder)
    assert any("FX, FY, CX, CY, K1, K2, P1, P2, X_FORWARD, Y_LEFT, Z_UP in calib.yaml" in line for line in look.missing)
    assert look.command == f"fill in {folder / 'calib.yaml'}, then: semloc check-calib {folder} --out check"
    assert any(line.startswith("imu.csv: table") and "no column for gy" in line for line in look.missing)
    _with_calibration(folder, "front", "left")
    assert first_look(folder).command == f"mend what is said under 'missing', then: semloc init {folder}"


def test_only_class_tables_that_know_all_ids_are_offered(folder):
    for file in (folder / "masks" / "front").iterdir():
        cv2.imwrite(str(file), np.full((40, 64), 60, np.uint8))
    line = next(line for line in first_look(folder).found if line.startswith("masks in"))
    assert "with ids 60: --class-table mapillary, or your own" in line


def test_a_map_beside_the_folder_is_offered_and_not_called_its_own(folder):
    _with_calibration(folder, "front")
    (folder.parent / "map.osm").write_text("<osm/>")
    look = first_look(folder)
    assert f"map: give --map FILE; there: {folder.parent / 'map.osm'}" in look.missing
    assert f"--map {folder.parent / 'map.osm'}" in look.command and open_drive(folder).map_path is None


def test_a_video_is_told_what_to_fill_in_and_which_clock_is_another(tmp_path, caplog):
    video = cv2.VideoWriter(str(tmp_path / "dash.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 40))
    for _ in range(2):
        video.write(np.zeros((40, 64, 3), np.uint8))
    video.release()
    for _ in range(2):  # the second time the template is there; the size is that of the video
        look = first_look(tmp_path / "dash.avi")
        assert (
            "FX, FY, CX, CY" in look.missing[0]
            and "WIDTH" not in look.missing[0]
            and look.command.startswith(f"fill in {tmp_path / 'calib.yaml'}")
        )
    (tmp_path / "calib.yaml").write_text(_filled_in((tmp_path / "calib.yaml").read_text()))
    (tmp_path / "gps.csv").write_text("t,lat,lon\n1700000000.0,48.0,11.0\n1700000001.0,48.0,11.0\n")
    look = first_look(tmp_path / "dash.avi")
    assert any(line.startswith("common time: fixes 1700000000") for line in look.missing)
    assert "nothing states times; pictures follow each other at 10 Hz from 0 s. Write dash.csv" in caplog.text
