"""Heights from a ground surface and from the road, against a map that has them."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.cli.main import OK, main
from semloc_jax.errors import SemlocError
from semloc_jax.maps import MapElement, SemanticMap, read_map, write_map
from semloc_jax.maps.ground_raster import GroundRaster, read_ground_raster
from semloc_jax.maps.heights import height_sigmas, with_heights
from semloc_jax.structs import ElementClass


def _flat(element: MapElement) -> MapElement:
    return replace(element, points=element.points * [1.0, 1.0, 0.0], has_height=False)


@pytest.fixture(scope="module")
def log(data_dir):
    folder = data_dir / "av2_7fab2350"
    if not folder.is_dir():
        pytest.skip(f"no Argoverse 2 log in {data_dir}")
    return folder


def _errors(before, after) -> np.ndarray:
    pairs = [(a, b) for a, b in zip(before, after, strict=True) if "height_sigma_m" in b.attributes]
    return np.concatenate([(a.points - b.points)[:, 2] for a, b in pairs])


@pytest.mark.data
def test_heights_of_the_ground_surface_are_those_of_the_map(log):
    road = read_map(log)
    again = with_heights([_flat(e) for e in road.elements], read_ground_raster(log))
    assert np.mean([e.has_height for e in again]) > 0.9, "the rest lies where the surface has holes"
    error = _errors(road.elements, again)
    assert abs(np.median(error)) < 0.01 and np.percentile(np.abs(error), 95) < 0.10


@pytest.mark.data
def test_heights_of_the_road_beside_come_with_a_sigma_that_holds(log):
    """Every other element loses its heights and gets them from the road that the others show."""
    road = read_map(log)
    ground = SemanticMap(road.elements[1::2]).ground
    mixed = [e if i % 2 else _flat(e) for i, e in enumerate(road.elements)]
    again = with_heights(mixed, ground)
    error = np.abs(_errors(road.elements, again))
    sigma = np.concatenate([np.full(len(e.points), s) for e in again if (s := e.attributes.get("height_sigma_m"))])
    assert np.percentile(error, 95) < 0.15
    assert np.mean(error < sigma) > 0.68 and np.mean(error < 2.0 * sigma) > 0.95


def _slope(x):
    return 5.0 + 0.05 * x


def test_elements_without_heights_lie_on_the_road_at_the_vehicle():
    x = np.arange(0.0, 101.0, 5.0)
    edges = [
        MapElement(
            f"e{y}", ElementClass.LANE_MARKING, np.stack([x, 0 * x + y, _slope(x)], 1), width_m=0.1, style="solid"
        )
        for y in (-3.0, 3.0)
    ]
    line = MapElement("l", ElementClass.LANE_MARKING, np.array([[20.0, 0, 0], [80.0, 0, 0]]), width_m=0.1)
    pole = MapElement("p", ElementClass.POLE, np.array([[50.0, 6, 0], [50.0, 6, 4]]), radius_m=0.1)
    road = SemanticMap((*edges, replace(line, has_height=False), replace(pole, has_height=False)))
    found = {e.id: e for e in road.query([50.0, 0.0], 20.0).elements}
    np.testing.assert_allclose(found["l"].points[:, 2], _slope(found["l"].points[:, 0]), atol=0.02)
    np.testing.assert_allclose(found["p"].points[:, 2], [7.5, 11.5], atol=0.02)
    assert not found["l"].has_height, "what was guessed is still known as such"
    flat = SemanticMap((replace(line, has_height=False),)).query([50.0, 0.0], 20.0)
    assert (flat.elements[0].points[:, 2] == 0.0).all()


def test_only_guessed_heights_have_a_sigma_that_grows_with_distance():
    points = np.array([[0.0, 0, 0], [9.0, 0, 0]])
    given = MapElement("a", ElementClass.CURB, points)
    surface = replace(given, attributes={"height_sigma_m": 0.05})
    guessed = replace(given, has_height=False)
    expected = [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.02, 0.0005, 0.0]]
    np.testing.assert_allclose(height_sigmas((given, surface, guessed)), expected)
    np.testing.assert_allclose(height_sigmas((guessed,)), [[0.02, 0.0005, 0.03]], err_msg="nobody knows what is up")
    assert height_sigmas(()).shape == (0, 3)


def test_an_esri_grid(tmp_path):
    (tmp_path / "g.asc").write_text(
        "ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 2\nNODATA_value -9999\n4 5 6\n1 2 -9999\n"
    )
    grid = read_ground_raster(tmp_path / "g.asc")
    places = np.array([[11.0, 21.0], [13.0, 23.0], [12.0, 22.0], [15.0, 21.0], [0.0, 0.0]])
    np.testing.assert_allclose(grid.height_at(places), [1.0, 5.0, 3.0, np.nan, np.nan])


@pytest.mark.parametrize("text", ["", "ncols 3\nnrows 2\n", "ncols 1e9\nnrows 1e9\ncellsize 1\n", "hello world\n1 2"])
def test_broken_grids_are_refused(tmp_path, text):
    (tmp_path / "g.asc").write_text(text)
    with pytest.raises(SemlocError, match="ground heights g.asc"):
        read_ground_raster(tmp_path / "g.asc")
    with pytest.raises(SemlocError, match="no such file"):
        read_ground_raster(tmp_path)


_GRID = "ncols {columns}\nnrows 2\nxllcorner {west}\nyllcorner 0\ncellsize {cell}\n9 {height}\n7 {height}\n"


def _argoverse2_raster(folder, cell):
    np.save(folder / "a_ground_height_surface____.npy", np.array([[7.0, cell], [9.0, cell]]))
    (folder / "a___img_Sim2_city.json").write_text('{"R": [1, 0, 0, 1], "t": [0, 0], "s": 1}')
    return folder


@pytest.mark.parametrize("height", ["1e39", "-3.4028234663852886e+38", "inf", "nan", "1e6"])
def test_heights_that_no_ground_has_are_holes_in_both_formats(tmp_path, height):
    """Programs mark holes with numbers that float32 does not hold, and do not always name them in the head."""
    (tmp_path / "g.asc").write_text(_GRID.format(columns=2, west=0, cell=1, height=height))
    for path in (tmp_path / "g.asc", _argoverse2_raster(tmp_path, float(height))):
        heights = read_ground_raster(path).heights
        assert heights.dtype == np.float32 and sorted(heights[:, 0]) == [7.0, 9.0]
        assert np.isnan(heights[:, 1]).all()


@pytest.mark.parametrize(
    "given", [{"columns": "inf"}, {"west": "1e300"}, {"west": "nan"}, {"cell": "1e-320"}, {"cell": "inf"}]
)
def test_a_place_of_a_raster_that_is_no_place_is_refused(tmp_path, given):
    (tmp_path / "g.asc").write_text(_GRID.format(**{"columns": 2, "west": 0, "cell": 1, "height": 8} | given))
    with pytest.raises(SemlocError, match="ground heights g.asc") as caught:
        read_ground_raster(tmp_path / "g.asc")
    assert "\n" not in str(caught.value)


def test_a_raster_without_any_height_is_refused(tmp_path):
    with pytest.raises(SemlocError, match="none of 4 cells has a height"):
        np.save(_argoverse2_raster(tmp_path, 0.0) / "a_ground_height_surface____.npy", np.full((2, 2), 1e7))
        read_ground_raster(tmp_path)


def test_the_command_line_adds_heights(tmp_path, capsys):
    line = MapElement("l", ElementClass.STOP_LINE, np.array([[11.0, 21.0, 0], [13.0, 21.0, 0]]), has_height=False)
    write_map(SemanticMap((line,)), tmp_path / "flat.geojson")
    (tmp_path / "g.asc").write_text("ncols 2\nnrows 2\nxllcenter 11\nyllcenter 21\ncellsize 2\n9 9\n7 8\n")
    words = ["convert", str(tmp_path / "flat.geojson"), str(tmp_path / "m.gpkg"), "--heights", str(tmp_path / "g.asc")]
    assert main(words) == OK
    assert "heights: 1 of 1 elements that lacked them" in capsys.readouterr().out
    again = read_map(tmp_path / "m.gpkg").elements[0]
    np.testing.assert_allclose(again.points[:, 2], [7.0, 8.0])
    assert again.has_height and again.attributes["height_sigma_m"] == GroundRaster.sigma_m
