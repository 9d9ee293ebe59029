"""Differences of maps: applied they give the other map to the byte, on the right base only, damaged never."""

import base64
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from semloc_jax.cli.main import FAILED, OK, main
from semloc_jax.errors import SemlocError
from semloc_jax.maps import GeoOrigin, MapElement, SemanticMap, write_map
from semloc_jax.maps.versions.difference import applied, difference
from semloc_jax.maps.versions.records import element_of, record_of
from semloc_jax.maps.versions.sdiff import CHECK_BYTES, MAGIC, SdiffFile, sdiff_bytes
from semloc_jax.maps.versions.state import TILE_M, MapState, in_canonical_order, read_state, tile_of, write_state
from tests.maps.versions.made_maps import changed, elements, road, states

# beartype, which checks shapes in tests, throws dice itself while hypothesis draws.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module")
FEW = settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
MANY = settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))


def round_trip(data, folder):
    base = data.draw(states())
    target = data.draw(changed(base))
    write_state(base, folder / "a.gpkg")
    write_state(target, folder / "b.gpkg")
    a, b = read_state(folder / "a.gpkg"), read_state(folder / "b.gpkg")
    assert (a.digest, b.digest) == (base.digest, target.digest)  # a file keeps all that a version is
    content = sdiff_bytes(difference(a, b), a)
    write_state(applied(a, SdiffFile(content, "d").on(a)), folder / "again.gpkg")
    assert (folder / "again.gpkg").read_bytes() == (folder / "b.gpkg").read_bytes()
    back = sdiff_bytes(difference(b, a), b)
    assert applied(b, SdiffFile(back, "d").on(b)).digest == a.digest


@FEW
@given(data=st.data())
def test_a_difference_applied_is_the_other_map_to_the_byte(tmp_path_factory, data):
    round_trip(data, tmp_path_factory.mktemp("trip"))


@pytest.mark.slow
@MANY
@given(data=st.data())
def test_a_difference_applied_is_the_other_map_to_the_byte_300_times(tmp_path_factory, data):
    round_trip(data, tmp_path_factory.mktemp("trip"))


def damaged(data):
    base = data.draw(states())
    content = sdiff_bytes(difference(base, data.draw(changed(base))), base)
    at = data.draw(st.integers(0, len(content) - 1))
    broken = {
        "cut": content[:at],
        "flipped": content[:at] + bytes([content[at] ^ (1 << data.draw(st.integers(0, 7)))]) + content[at + 1 :],
        "longer": content + data.draw(st.binary(min_size=1, max_size=3)),
    }[data.draw(st.sampled_from(["cut", "flipped", "longer"]))]
    with pytest.raises(SemlocError):
        SdiffFile(broken, "d").on(base)


@FEW
@given(data=st.data())
def test_a_damaged_difference_is_refused(data):
    damaged(data)


@pytest.mark.slow
@MANY
@given(data=st.data())
def test_a_damaged_difference_is_refused_300_times(data):
    damaged(data)


@FEW
@given(data=st.data())
def test_a_difference_on_another_version_is_refused(data):
    base = data.draw(states())
    step = difference(base, data.draw(changed(base)))
    other = MapState(base.map, base.version + 1, base.num_drives)
    with pytest.raises(SemlocError, match="is for version"):
        SdiffFile(sdiff_bytes(step, base), "d").on(other)
    with pytest.raises(SemlocError, match="is for version"):
        applied(other, step)


@FEW
@given(data=st.data())
def test_a_record_keeps_every_bit(data):
    element = data.draw(elements("e"))
    again = element_of("e", record_of(element))
    assert again.points.tobytes() == element.points.tobytes()
    assert repr(replace(again, points=np.zeros((1, 3)))) == repr(replace(element, points=np.zeros((1, 3))))


def test_a_zero_without_sign_in_the_file_is_the_same_version(tmp_path):
    """Surveyed normals often hold -0.0: the version that was written must be the one that is read."""
    sign = MapElement("s", "sign", np.eye(3), closed=True, normal=np.array([-1.0, 0.0, -0.0]))
    state = MapState(SemanticMap((sign,), None, "signs"))
    write_state(state, tmp_path / "a.gpkg")
    assert read_state(tmp_path / "a.gpkg").digest == state.digest


@FEW
@given(junk=st.binary(max_size=80))
def test_junk_with_a_right_hash_is_refused(junk):
    content = MAGIC + zlib.crc32(junk).to_bytes(CHECK_BYTES, "little") + junk
    with pytest.raises(SemlocError):
        SdiffFile(content, "d").on(MapState(road(2)))


def test_a_promise_that_is_not_kept_is_refused():
    old, new = MapState(road(3)), MapState(road(4))
    with pytest.raises(SemlocError, match="but states"):
        applied(old, replace(difference(old, new), target="0" * 64))
    with pytest.raises(SemlocError, match="not there"):
        applied(old, replace(difference(old, new), removed=("nobody",)))
    with pytest.raises(SemlocError, match="twice"):
        applied(old, replace(difference(old, new), order=(0, 0, 1, 2)))


def test_a_tile_has_the_hash_of_what_it_holds_in_any_order():
    one = MapState(road(60))
    other = MapState(one.map.with_elements(reversed(one.map.elements)))
    assert sorted(one.tiles) == [(0, 0), (1, 0), (2, 0)]
    assert one.content == other.content and one.digest != other.digest
    moved = MapState(road(59).with_elements([*road(59).elements, road(60, 4).elements[-1]]))
    differ = [tile for tile in one.tiles if one.tiles[tile] != moved.tiles[tile]]
    assert differ == [tile_of(one.map.elements[-1])] == [(int(59 * 9 // TILE_M), 0)]
    assert in_canonical_order(other.map.elements) == in_canonical_order(one.map.elements)


def test_equal_maps_are_equal_files_whenever_they_are_written(tmp_path):
    here = SemanticMap(road(5).elements, GeoOrigin(48.0, 11.0, 500.0), "here")
    for name in ("a", "b"):
        write_map(here, tmp_path / f"{name}.gpkg")
    assert (tmp_path / "a.gpkg").read_bytes() == (tmp_path / "b.gpkg").read_bytes()


def test_a_few_changes_are_a_small_file():
    old = MapState(road(200))
    kept = [e for k, e in enumerate(road(200).elements) if k != 50]
    kept[7] = kept[7].with_points(kept[7].points + [0.0, 0.4, 0.0])
    new = MapState(old.map.with_elements(kept), 2)
    step = difference(old, new)
    assert (step.removed, step.moved(), list(step.added)) == (("dash_050",), ["dash_007"], [])
    whole = len(sdiff_bytes(difference(MapState(road(1)), old), MapState(road(1))))
    assert len(sdiff_bytes(step, old)) < 180 and whole < 600  # told one by one, 199 dashes were 900 bytes
    counted = MapState(road(200, seen=4), 2)
    assert len(sdiff_bytes(difference(old, counted), old)) < 150  # one more look at each of 200


BEFORE = (
    "U0RJRgI0MKq+K45J8CtShWXu2qnn/6/Ym6xV+F6atxMGDA7uys5oz4rmZr8n9B58UQBTAIgd/GtKvucVvZLRpEw2yeB8bLW1FMng5HuBHFxQnViKr2Bw"
    "n728GMN2fF8gncI3rvNjL5+tnlffGzBhx3FY1ZTZPx2qG4I0xWc/ut7vogNjHupGTC0a6QRq8fC54BgsWOvRY+rI9Lbt7y0iooOjQCOSczUT+do5KF+l"
    "0Nfw/54ZQAA="
)


def test_a_difference_of_the_form_before_is_read():
    """A history may hold such files: one dash gone, one moved, three come with hashes for names."""
    old, kept = MapState(road(6)), [e for k, e in enumerate(road(6).elements) if k != 2]
    kept[3] = kept[3].with_points(kept[3].points + [0.0, 0.4, 0.0])
    aside = [replace(e, id=f"dash_{k:08x}", points=e.points + [0, 3.5, 0]) for k, e in enumerate(road(3).elements, 77)]
    new, held = MapState(old.map.with_elements([*kept, *aside]), 2), base64.b64decode(BEFORE)
    assert applied(old, SdiffFile(held, "d").on(old)).digest == new.digest
    now = sdiff_bytes(difference(old, new, "before"), old)
    assert len(held) == 182 and len(now) < 150 and applied(old, SdiffFile(now, "d").on(old)).digest == new.digest


def test_two_elements_of_one_id_have_no_version():
    twice = SemanticMap((*road(2).elements, road(1).elements[0]), None, "twice")
    with pytest.raises(SemlocError, match="two elements have the id 'dash_000'"):
        MapState(twice)


def test_the_verbs(tmp_path, capsys):
    a, b, out = (tmp_path / f"{name}.gpkg" for name in "abc")
    write_map(road(20), a)
    write_map(road(22, 4, 0.01), b)
    step = tmp_path / "d.sdiff"
    assert main(["diff", str(a), str(b), "--out", str(step), "--list", "3"]) == OK
    said = capsys.readouterr().out
    assert "2 added, 20 modified, 0 removed; 1 of 1 tiles changed" in said and "note" not in said
    assert main(["apply", str(a), str(step), "--out", str(out)]) == OK
    assert out.read_bytes() == b.read_bytes()
    assert main(["apply", str(b), str(step), "--out", str(out)]) == FAILED
    assert "is for version 1" in capsys.readouterr().err
    assert out.read_bytes() == b.read_bytes()
    assert main(["log", str(out), "--tiles"]) == OK
    said = capsys.readouterr().out
    assert "version 2" in said and "version 1" in said and "tile 0,0" in said
    assert main(["rollback", str(out), "--to", "1"]) == OK
    assert main(["diff", str(a), str(out)]) == OK
    assert "0 added, 0 modified, 0 removed; 0 of 1 tiles changed" in capsys.readouterr().out
    assert main(["rollback", str(out), "--to", "2", "--out", str(tmp_path / "two.gpkg")]) == OK
    assert (tmp_path / "two.gpkg").read_bytes() == b.read_bytes()
    assert main(["rollback", str(out), "--to", "7"]) == FAILED
    assert "which knows 1 to 3" in capsys.readouterr().err
    assert main(["diff", str(a), str(b), "--out", str(tmp_path / "nowhere" / "d.sdiff")]) == FAILED
    assert main(["apply", str(a), str(step), "--out", str(tmp_path / "b.geojson")]) == FAILED
    assert "ends in .gpkg" in capsys.readouterr().err


def test_a_map_of_another_form_has_versions_too(tmp_path, capsys):
    write_map(road(3), tmp_path / "a.geojson")
    write_map(road(4), tmp_path / "b.geojson")
    step = tmp_path / "d.sdiff"
    assert main(["diff", str(tmp_path / "a.geojson"), str(tmp_path / "b.geojson"), "--out", str(step)]) == OK
    assert "was not written by this version of the package" in capsys.readouterr().out
    assert main(["apply", str(tmp_path / "a.geojson"), str(step), "--out", str(tmp_path / "c.gpkg")]) == OK
    made, read = read_state(tmp_path / "c.gpkg"), read_state(tmp_path / "b.geojson")
    assert made.digest == read.digest
