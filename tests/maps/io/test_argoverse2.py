"""Argoverse 2 vector maps against the poses and the lidar of their log."""

import json

import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import wgs84_from_enu
from semloc_jax.maps import GeoOrigin, read_map
from semloc_jax.maps.curves import resample
from semloc_jax.maps.io.argoverse2 import map_from_argoverse2
from semloc_jax.structs import ElementClass


@pytest.fixture(scope="module")
def log(data_dir):
    folder = data_dir / "av2_7fab2350"
    if not folder.is_dir():
        pytest.skip(f"no Argoverse 2 log in {data_dir}")
    return folder


def _table(path):
    return pytest.importorskip("pyarrow.feather").read_table(path).to_pydict()


@pytest.mark.data
def test_every_ego_pose_lies_in_the_drivable_area(log):
    (path,) = (log / "map").glob("log_map_archive_*.json")
    outlines = [area["area_boundary"] for area in json.loads(path.read_text())["drivable_areas"].values()]
    poses = _table(log / "city_SE3_egovehicle.feather")
    area = shapely.unary_union([shapely.Polygon([(p["x"], p["y"]) for p in outline]) for outline in outlines])
    inside = shapely.contains_xy(area, poses["tx_m"], poses["ty_m"])
    assert len(inside) == 2706 and inside.all()


@pytest.mark.data
def test_markings_lie_on_the_ground_that_the_lidar_sees(log):
    """Median within 2 cm and nine tenths within 10 cm of both sweeps; the rest is under parked cars."""
    painted = [e.points for e in read_map(log).elements if e.is_painted and not e.closed]
    points = resample(painted, 0.5)[0]
    poses = _table(log / "city_SE3_egovehicle.feather")
    sweeps = sorted((log / "sensors" / "lidar").glob("*.feather"))
    assert len(sweeps) == 2
    for sweep in sweeps:
        row = poses["timestamp_ns"].index(int(sweep.stem))
        R_city_ego = Rotation.from_quat([poses[f"q{axis}"][row] for axis in "xyzw"]).as_matrix()
        lidar = _table(sweep)
        p_ego = np.stack([np.asarray(lidar[axis], dtype=np.float64) for axis in "xyz"], axis=1)
        p_city = p_ego @ R_city_ego.T + [poses[f"t{axis}_m"][row] for axis in "xyz"]
        tree = cKDTree(p_city[:, :2])
        near = [(z, i) for z, i in zip(points[:, 2], tree.query_ball_point(points[:, :2], 0.4), strict=True)]
        gap = np.array([np.percentile(p_city[i, 2], 20) - z for z, i in near if len(i) >= 4])
        assert len(gap) > 50
        assert abs(np.median(gap)) < 0.02 and np.mean(np.abs(gap) < 0.1) > 0.9


@pytest.mark.data
def test_boundaries_between_two_lanes_are_there_once(log):
    road = read_map(log)
    lines = [shapely.LineString(e.points[:, :2]) for e in road.elements if e.style == "solid"]
    assert len(lines) == 46
    covered = [one.buffer(0.05).covers(other) for i, one in enumerate(lines) for other in lines[:i]]
    assert not any(covered)
    assert sum(e.label == ElementClass.CROSSWALK for e in road.elements) == 11
    assert road.frame == "Argoverse 2 city frame PIT" and road.origin is None


def _lane(kind: str, points=((0, 0, 1), (40, 0, 1))):
    line = [dict(zip("xyz", point, strict=True)) for point in points]
    far = [dict(zip("xyz", (x, y - 3.5, z), strict=True)) for x, y, z in points]
    lane = {"left_lane_boundary": line, "left_lane_mark_type": kind, "right_lane_boundary": far}
    return {"lane_segments": {"7": lane}, "pedestrian_crossings": {}, "drivable_areas": {}}


@pytest.mark.parametrize(
    ("kind", "offsets", "styles"),
    [
        ("SOLID_WHITE", [0.0], {"solid"}),
        ("DOUBLE_SOLID_YELLOW", [-0.12, 0.12], {"solid"}),
        ("SOLID_DASH_YELLOW", [-0.12, 0.12], {"solid", "dashed"}),
        ("DASHED_WHITE", [0.0], {"dashed"}),
        ("DOUBLE_DASH_WHITE", [-0.12, 0.12], {"dashed"}),
    ],
)
def test_mark_types_become_strokes(kind, offsets, styles):
    road = map_from_argoverse2(_lane(kind), "map.json")
    painted = [e for e in road.elements if e.is_painted]
    assert {e.style for e in painted} == styles
    np.testing.assert_allclose(sorted({round(e.points[0, 1], 6) for e in painted}), offsets, atol=1e-9)
    assert all("width" in e.attributes["assumed"] for e in painted)


def test_city_coordinates_reach_the_places_of_the_authors_tool():
    """av2-api's own example: 1745.37, -1421.37 in Austin is 30.26164 N, 97.72247 W."""
    points = ((1745.37, -1421.37, 0.0), (1738.54, -1415.03, 0.0))
    origin = GeoOrigin(30.2616, -97.7224)
    road = map_from_argoverse2(_lane("SOLID_WHITE", points), "log_map_archive_x____ATX_city_1.json", origin)
    lat, lon, _ = wgs84_from_enu(road.elements[0].points, origin)
    np.testing.assert_allclose(lat, [30.261642967615092, 30.26170086362131], atol=2e-8)
    np.testing.assert_allclose(lon, [-97.72246957081633, -97.72253982250783], atol=2e-8)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"lane_segments": {"1": 5}}, "no table of objects"),
        ({"lane_segments": {"1": {"left_lane_boundary": [{"x": 1}]}}}, "cannot be read"),
        ({"lane_segments": {"1": {"left_lane_boundary": []}}}, "0 points"),
        (_lane("NONE", ((0, 0, float("nan")), (1, 0, 0))), "no finite ones"),
    ],
)
def test_broken_archives_are_refused(document, message):
    with pytest.raises(SemlocError, match=message):
        map_from_argoverse2(document, "map.json")


def test_an_unknown_city_cannot_be_put_at_an_origin():
    with pytest.raises(SemlocError, match="no known city"):
        map_from_argoverse2(_lane("SOLID_WHITE"), "map.json", GeoOrigin(40.0, -80.0))
