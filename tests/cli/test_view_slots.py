"""`semloc slots FOLDER --metres-per-px`: slots of ready-made top views, without a drive."""

import csv

import cv2
import numpy as np
import pytest

from semloc_jax.cli.main import main
from semloc_jax.mapping.slots import PERPENDICULAR, SlotConfig
from semloc_jax.mapping.view_slots import in_metres, in_pixels, slots_of_view
from semloc_jax.perception.networks.marking_net import MarkingNet, MarkingPoints

CONFIG = SlotConfig(assumed_depth_m=(5.0, 2.2))
SIDE, SCALE = (240, 200), 0.05


def test_points_on_the_right_of_a_car_that_drives_up_make_slots_there():
    """Four dividers every 2.5 m of paint of 12 cm, 2 m to the right of the middle; the last one is at the rim."""
    u, v = np.full(4, 119.5 + 2.0 / SCALE), np.array([3.0, 53.0, 103.0, 153.0])
    points = MarkingPoints(np.stack([u, v], 1), np.zeros(4), np.zeros(4, bool), np.array([0.9, 0.8, 0.7, 0.6]))
    slots = slots_of_view(points, SIDE, SCALE, CONFIG)
    assert [slot.kind for slot in slots] == [PERPENDICULAR] * 2
    for slot, sure in zip(slots, (0.7, 0.6), strict=True):
        assert slot.confidence == pytest.approx(sure)
        np.testing.assert_allclose(slot.corners[:, 1], [-1.94, -1.94, -6.94, -6.94], atol=1e-9)
        step = slot.corners[1] - slot.corners[0]  # the slot, on the right, is on the left of a way down the picture
        np.testing.assert_allclose(step, [-2.5, 0.0], atol=1e-9)
        np.testing.assert_allclose(in_metres(in_pixels(slot.corners, SIDE, SCALE), SIDE, SCALE), slot.corners)
    assert max(slot.corners[0, 0] for slot in slots) == pytest.approx(SCALE * (99.5 - 53.0))


def _said(net, picture, metres_per_px, threshold=None):
    """What a network would say of the row of dividers in a picture, the fourth too unsure to count."""
    v = np.flatnonzero(picture[:, 170, 0] > 150)[1::3].astype(float)
    uv = np.stack([np.full(len(v), 140.0), v], axis=1)
    return MarkingPoints(uv, np.zeros(len(v)), np.zeros(len(v), bool), np.array([0.9, 0.8, 0.7, 0.2])[: len(v)])


def test_a_folder_of_top_views(tmp_path, capsys, monkeypatch):
    blank = MarkingNet.__new__(MarkingNet)  # no weights: what it says is written above
    blank.threshold = 0.5
    monkeypatch.setattr(MarkingNet, "load", lambda path: blank)
    monkeypatch.setattr(MarkingNet, "__call__", _said)
    folder = tmp_path / "views"
    folder.mkdir()
    picture = np.full((200, 200, 3), 90, np.uint8)
    for v in (20, 70, 120, 170):  # dividers of a row on the right, 2.5 m apart
        picture[v - 1 : v + 2, 140:] = 220
    cv2.imwrite(str(folder / "a.png"), picture)
    cv2.imwrite(str(folder / "b.JPG"), np.full((200, 200), 90, np.uint8))
    assert main(["slots", str(folder), "--metres-per-px", "0.05", "--out", str(tmp_path / "out")]) == 0
    assert "2 top views" in capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "out" / "slots.csv").open()))
    points = list(csv.DictReader((tmp_path / "out" / "points.csv").open()))
    assert [(row["image"], row["type"], row["confidence"]) for row in rows] == [
        ("a.png", "perpendicular", "0.800"),
        ("a.png", "perpendicular", "0.700"),
    ]
    # The entrance is at the outer edge of 12 cm of paint.
    assert float(rows[0]["y_m"]) == pytest.approx(-0.05 * 40.5 + 0.06, abs=1e-3)
    assert float(rows[0]["u0_px"]) == pytest.approx(140.0 - 1.2, abs=0.01)
    assert [row["counts"] for row in points] == ["1", "1", "1", "0"] and {row["shape"] for row in points} == {"T"}
    assert (tmp_path / "out" / "pictures" / "a.png").is_file()
    for words, said in (
        ([str(tmp_path / "none"), "--metres-per-px", "0.05"], "expected a picture or a folder of pictures"),
        ([str(folder), "--metres-per-px", "0.001"], "expected sides of 4 to 60 m"),
    ):
        assert main(["slots", *words]) == 1
        assert said in capsys.readouterr().err
