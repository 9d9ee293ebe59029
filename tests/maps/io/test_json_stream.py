"""JSON read item by item: the values of the standard library, one line for what is broken, little memory."""

import json
import re
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import semloc_jax
from semloc_jax.errors import SemlocError
from semloc_jax.maps import read_map
from semloc_jax.maps.io import write_geojson
from semloc_jax.maps.io.argoverse2 import lane_bounds
from semloc_jax.maps.io.json_stream import JsonFile, JsonList, JsonTable
from semloc_jax.maps.io.osm import read_osm
from tests.maps.io.town import town

WORD = st.text(max_size=6) | st.sampled_from(['"', "\\", "{", "]", ",", ":", '\\"', "a b"])
VALUE = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | WORD,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORD, inner, max_size=3),
    max_leaves=12,
)


def plain(value):
    if isinstance(value, JsonTable):
        return dict(value.items())
    return list(value) if isinstance(value, JsonList) else value


@settings(max_examples=25, deadline=None, derandomize=True)
@given(document=st.dictionaries(WORD, VALUE, max_size=4), indent=st.sampled_from([None, 1]), is_ascii=st.booleans())
def test_values_are_those_of_the_standard_library(tmp_path_factory, document, indent, is_ascii):
    path = tmp_path_factory.mktemp("json") / "map.json"
    path.write_text(json.dumps(document, indent=indent, ensure_ascii=is_ascii), encoding="utf-8")
    found = JsonFile(path)
    assert {key: plain(found[key]) for key in found} == document
    for key, value in document.items():
        if isinstance(value, dict | list):
            assert len(found[key]) == len(value)


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{", '{"a"', '{"a":', '{"a": [1, 2', '{"a": [1}', '{"a": {"b": 1]}', '{"a": 1} {"b": 2}',
        '{"a": [1 2]}', '{"a": [1,]}', '{a: 1}', '{"a": "x}', '{"a": ' + "[" * 100 + "]" * 100 + "}",
    ],
)  # fmt: skip
def test_broken_files_are_one_line(tmp_path, text):
    path = tmp_path / "map.json"
    path.write_text(text)
    with pytest.raises(SemlocError, match="not valid JSON") as caught:
        found = JsonFile(path)
        [plain(found[key]) for key in found]
    assert "\n" not in str(caught.value)


def peak_bytes(work):
    work()  # what is imported, and made when first called, does not count
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_lanes_of_a_city_are_not_held_in_memory(tmp_path):
    """Walking through the lanes takes the memory of one of them; the standard library takes that of the file."""
    line = [{"x": 10.0 * k, "y": 2.5, "z": 1.25} for k in range(20)]
    lane = {"lane_type": "VEHICLE", "left_lane_boundary": line, "right_lane_boundary": line}
    path = tmp_path / "city.json"
    path.write_text(json.dumps({"drivable_areas": {}, "lane_segments": {str(k): lane for k in range(300)}}))
    size = path.stat().st_size
    assert size > 400_000
    assert peak_bytes(lambda: sum(1 for _ in lane_bounds(JsonFile(path), "city"))) < 0.2 * size
    assert peak_bytes(lambda: json.loads(path.read_text())) > size


def test_nodes_of_osm_keep_no_more_than_their_place(tmp_path):
    words = (
        'version="3" changeset="1234567" timestamp="2024-01-01T00:00:00Z" user="somebody" uid="12345" visible="true"'
    )
    nodes = (f'<node id="{k}" lat="48.1{k:05d}" lon="11.6{k:05d}" {words}/>' for k in range(2000))
    path = tmp_path / "town.osm"
    odd = "<node id='9999' lat='1' lon='2'><tag k='id' v='x'/><nd ref='1'/></node>"
    path.write_text("<osm>" + "\n".join(nodes) + odd + "</osm>")
    found = read_osm(path)
    assert found.nodes.pop("9999").attributes["id"] == "9999" and found.nodes["7"].references == []
    assert len(found.nodes) == 2000
    assert set(found.nodes["7"].attributes) == {"id", "lat", "lon"}
    assert peak_bytes(lambda: read_osm(path)) < 5 * path.stat().st_size


def test_a_geojson_is_no_larger_in_memory_than_its_elements(tmp_path):
    """Few features are held at once, however many there are; a mark of the encoding at the start does no harm."""
    path = tmp_path / "town.geojson"
    write_geojson(town(12), path)
    text = path.read_text(encoding="utf-8")
    path.write_text("\ufeff" + text.replace('"origin"', '"made_by"'), encoding="utf-8")
    read_map(path)  # what is imported on the way does not count
    tracemalloc.start()
    found = read_map(path)
    kept, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(found.elements) == 1476
    assert peak - kept < 200_000 < 0.5 * path.stat().st_size
    assert peak_bytes(lambda: json.loads(text)) > path.stat().st_size


def test_no_group_is_possessive_by_itself():
    """Python before 3.11.5 matches such groups wrongly, and refused whole maps for it: `ANY_TIMES` knows."""
    for path in Path(semloc_jax.__file__).parent.rglob("*.py"):
        assert not re.search(r"\)[*+?]\+", path.read_text(encoding="utf-8")), path
