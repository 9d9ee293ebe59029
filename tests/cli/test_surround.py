"""`semloc surround`: four pictures and a calibration to a top view; one clear line where they do not fit."""

import json
import re

import cv2
import numpy as np
import pytest

from semloc_jax.cameras.io import write_calibration
from semloc_jax.cli.main import main
from tests.perception.four_fisheyes import NAMES, four_fisheyes, photographed, road_picture

SMALL = ("--size-m", "9", "--metres-per-px", "0.025")


@pytest.fixture(scope="module")
def pictures():
    bars = [(x - 0.06, -4.0, x + 0.06, -1.5) for x in (-2.5, 0.0, 2.5, 5.0)]
    return photographed(four_fisheyes(), road_picture(lines=bars))


@pytest.fixture
def folder(tmp_path, pictures):
    """One picture for each camera, and the calibration."""
    place = tmp_path / "pictures"
    place.mkdir()
    write_calibration(four_fisheyes(), place / "calib.yaml")
    for name, picture in zip(NAMES, pictures, strict=True):
        cv2.imwrite(str(place / f"car_{name}.png"), picture)
    return place


def test_four_pictures_become_one_top_view(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["surround", str(folder), "--out", str(out), "--video", *SMALL]) == 0
    top = cv2.imread(str(out / "top_view" / "0.png"))
    assert top.shape == (360, 360, 3)
    film = cv2.VideoCapture(str(out / "surround.mp4"))
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == 1
    numbers = {m["key"]: m["value"] for m in json.loads((out / "metrics.json").read_text())["metrics"]}
    assert numbers["overlap.median"] < 25.0  # mm: one pixel
    assert "1 top view of 360 x 360 px, 25 mm a pixel" in capsys.readouterr().out


def test_a_bowl_is_seen_from_the_side_that_is_asked_for(folder, tmp_path):
    out = tmp_path / "out"
    assert main(["surround", str(folder), "--out", str(out), "--bowl-from-deg", "90", "--video", *SMALL]) == 0
    view = cv2.imread(str(out / "bowl" / "0.png"))
    assert view.shape == (540, 960, 3) and (view.max(axis=2) > 0).mean() > 0.6
    assert cv2.VideoCapture(str(out / "bowl.mp4")).get(cv2.CAP_PROP_FRAME_COUNT) == 1


def _exchange(folder, pictures):
    cv2.imwrite(str(folder / "car_left.png"), pictures[3])
    cv2.imwrite(str(folder / "car_right.png"), pictures[1])


FAULTS = {
    "missing": (lambda f, p: (f / "car_rear.png").unlink(), "no picture of camera rear .*--cameras front,left,right"),
    "exchanged": (_exchange, "another order than the cameras: left shows what belongs to right"),
    "black": (lambda f, p: cv2.imwrite(str(f / "car_left.png"), 0 * p[1]), "camera left: the image is black"),
    "of another car": (
        lambda f, p: cv2.imwrite(str(f / "car_rear.png"), np.zeros((300, 400, 3), np.uint8) + 90),
        "camera rear: the image has 400x300 px, the calibration says 640x480",
    ),
    "of another car, as large": (
        lambda f, p: write_calibration(four_fisheyes(pitch_deg=12.0), f / "calib.yaml"),
        "neighbouring cameras do not show the same road: .*the calibration is of another car",
    ),
    "without a calibration": (lambda f, p: (f / "calib.yaml").unlink(), "give --calib"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_does_not_fit_is_said_in_one_line(folder, pictures, tmp_path, capsys, fault):
    spoil, words = FAULTS[fault]
    spoil(folder, pictures)
    assert main(["surround", str(folder), "--out", str(tmp_path / "out"), *SMALL]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(words, line), line
    assert not (tmp_path / "out" / "top_view").exists()


def test_a_camera_may_be_left_out(folder, tmp_path):
    (folder / "car_rear.png").unlink()
    words = ["surround", str(folder), "--cameras", "front,left,right", "--out", str(tmp_path / "o"), *SMALL]
    assert main(words) == 0


def test_sizes_that_cannot_be_meant_are_refused(folder, capsys):
    assert main(["surround", str(folder), "--size-m", "12", "--metres-per-px", "0.001"]) == 1
    assert "12000 pixels a side; expected 16 to 8000" in capsys.readouterr().err
    assert main(["surround", str(folder), "--own-car", "1,2,3"]) == 2
    assert "expected 4 finite numbers as REAR,FRONT,RIGHT,LEFT" in capsys.readouterr().err
