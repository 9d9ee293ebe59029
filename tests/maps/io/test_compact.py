"""The compact form: stated accuracy, stated size, refusal of what is broken."""

import lzma

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.maps import MapElement, SemanticMap, compare, inspect_map, read_map
from semloc_jax.maps.io.compact import _FILTERS, MAGIC, write_compact
from semloc_jax.maps.io.varints import pack_integers, split_columns, unpack_integers
from semloc_jax.structs import ElementClass


def test_numbers_of_every_size_come_back():
    values = np.array([0, -1, 1, 63, -64, 64, 127, 128, -129, 2**31, -(2**40), 2**62 - 1, -(2**62)])
    np.testing.assert_array_equal(unpack_integers(pack_integers(values), len(values)), values)
    assert len(pack_integers(np.zeros(100))) == 100
    assert len(unpack_integers(b"", 0)) == 0


@pytest.mark.data
@pytest.mark.parametrize(("resolution_m", "thinning_m"), [(0.01, 0.01), (0.05, 0.0), (0.02, 0.10)])
def test_lines_stay_within_the_stated_accuracy(road_dir, tmp_path, resolution_m, thinning_m):
    road = read_map(road_dir / "map.geojson")
    write_compact(road, tmp_path / "road.smap", resolution_m, thinning_m)
    losses = compare(road, read_map(tmp_path / "road.smap"))
    assert not losses.lost and not losses.added
    assert 0.3 * resolution_m < losses.shift_m < thinning_m + 0.87 * resolution_m
    assert set(losses.changed) <= {"attributes", "height", "normal"}


@pytest.mark.data
def test_kilobytes_per_kilometre(road_dir, data_dir, tmp_path):
    """RoadMap states 36 kB/km, poles alone take 2.7 kB/km elsewhere; ours at 1 cm."""
    path = tmp_path / "m.smap"
    e6 = data_dir / "maps_opendrive_esmini" / "resources" / "xodr" / "e6mini.xodr"
    for source, labels, limit in (
        (road_dir / "map.geojson", None, 12.0),
        (road_dir / "map.geojson", {ElementClass.POLE}, 1.5),
        (e6, None, 3.0),
    ):
        if not source.is_file():
            pytest.skip(f"no {source.name}")
        road = read_map(source)
        write_compact(road, path, labels=labels)
        assert path.stat().st_size / inspect_map(road).road_length_m < limit


def test_everything_that_the_form_keeps(tmp_path):
    plate = np.array([[0.0, 0.3, 2.0], [0.0, -0.3, 2.0], [0.0, 0.0, 2.5]])
    sign = MapElement("a", ElementClass.SIGN, plate, closed=True, shape="triangle", normal=np.array([-1.0, 0.0, 0.0]))
    bar = MapElement(
        "b", ElementClass.LANE_MARKING, plate[:2] * 9, width_m=0.15, style="dashed", true_ends=(True, False)
    )
    pole = MapElement("c", ElementClass.POLE, plate[:2], radius_m=0.1, radius_top_m=0.05, has_height=False)
    road = SemanticMap((sign, bar, pole), None, "three", {}, "here")
    write_compact(road, tmp_path / "m.smap")
    again = read_map(tmp_path / "m.smap")
    losses = compare(road, again)
    assert losses.changed == {} and losses.shift_m < 1e-9 and losses.notes == ("ids are not kept",)
    assert again.name == "three" and again.frame == "here" and again.origin is None


def test_an_empty_map_and_wrong_resolutions(tmp_path):
    write_compact(SemanticMap(()), tmp_path / "m.smap")
    with pytest.raises(SemlocError, match="no element that a camera could see"):
        read_map(tmp_path / "m.smap")
    for resolution in (0.0, -1.0, float("nan"), 2.0):
        with pytest.raises(SemlocError, match="expected more than 0"):
            write_compact(SemanticMap(()), tmp_path / "m.smap", resolution)


def test_bombs_and_lies_are_refused(tmp_path):
    path = tmp_path / "m.smap"
    zeros = lzma.compress(bytes(1 << 26), format=lzma.FORMAT_RAW, filters=_FILTERS)  # 8 million columns of nothing
    header = b'{"kinds": [], "origin": null, "name": "", "frame": "", "resolution_m": 1, "shift": [0, 0, 0]}'
    short = np.array([len(header)], dtype="<u4").tobytes() + header
    for payload in (zeros, lzma.compress(short, format=lzma.FORMAT_RAW, filters=_FILTERS), b"", b"\x00" * 40):
        path.write_bytes(MAGIC + payload)
        with pytest.raises(SemlocError, match="broken"):
            read_map(path)
    with pytest.raises(ValueError, match="more than 64 columns"):
        split_columns(bytes(1 << 12))
    path.write_bytes(b"SMAP\x02")
    with pytest.raises(SemlocError, match="not a compact map of this version"):
        read_map(path)
