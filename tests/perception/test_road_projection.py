"""Pixels on the road: four clicked points say what the calibration says; bad points are refused in one line."""

import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera, mounted
from semloc_jax.errors import SemlocError
from semloc_jax.perception.road_projection import CalibratedRoad, FourPointRoad, RoadProjection, read_four_points

CAMERA = PinholeCamera(400.0, 402.0, 319.5, 199.5, 640, 400)
T_BASE_CAM = mounted((1.6, 0.1, 1.4), down_deg=6.0)
CORNERS = np.array([[6.0, 1.5], [6.0, -1.5], [15.0, -2.5], [15.0, 3.0]])


def pixels(xy):
    p_cam = (np.column_stack([xy, np.zeros(len(xy))]) - T_BASE_CAM[:3, 3]) @ T_BASE_CAM[:3, :3]
    return np.asarray(CAMERA.project(p_cam)[0], np.float64)


def written(path, rows):
    path.write_text("camera,u_px,v_px,x_m,y_m\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n")
    return path


def test_four_points_are_as_good_as_the_calibration():
    four, known = FourPointRoad.of(pixels(CORNERS), CORNERS), CalibratedRoad(CAMERA, T_BASE_CAM)
    assert isinstance(four, RoadProjection)
    assert isinstance(known, RoadProjection)
    uv = np.array([[100.0, 390.0], [320.0, 250.0], [600.0, 300.0], [320.0, 20.0]])
    places, on_road = four.on_road(uv)
    expected, seen = known.on_road(uv)
    np.testing.assert_array_equal(on_road, seen)
    np.testing.assert_array_equal(on_road, [True, True, True, False])
    np.testing.assert_allclose(places[:3], expected[:3], atol=2e-3)


def test_a_file_of_points_holds_every_camera(tmp_path):
    uv = pixels(CORNERS)
    rows = [(name, *uv[k], *CORNERS[k]) for name in ("front", "rear") for k in range(4)]
    roads = read_four_points(written(tmp_path / "points.csv", rows))
    assert sorted(roads) == ["front", "rear"]
    np.testing.assert_allclose(roads["front"].on_road(uv)[0], CORNERS, atol=1e-4)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([("front", 1, 2, 3, 4)] * 3, "3 points of camera front; expected four"),
        ([("front", 10 * k, 20 * k, k, 2 * k) for k in range(4)], "three of the four points lie on one line"),
        ([("front", "x", 2, 3, 4)] * 4, "could not convert"),
        ([("front", "nan", 2, 3, 4)] * 4, "four finite pairs"),
    ],
)
def test_bad_points_are_refused(tmp_path, rows, words):
    with pytest.raises(SemlocError, match=words):
        read_four_points(written(tmp_path / "points.csv", rows))


def test_other_columns_and_no_file_are_refused(tmp_path):
    (tmp_path / "points.csv").write_text("u,v\n1,2\n")
    with pytest.raises(SemlocError, match="expected camera, u_px, v_px, x_m, y_m"):
        read_four_points(tmp_path / "points.csv")
    with pytest.raises(SemlocError, match=r"none\.csv: no such file; expected a csv file with the columns camera"):
        read_four_points(tmp_path / "none.csv")
