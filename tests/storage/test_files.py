"""Outputs stay in their folder, are old or new, and have one writer at a time."""

import gzip
import os
import signal
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.storage import (
    append_line,
    claim,
    decompressed,
    file_name,
    is_plain_name,
    json_document,
    making,
    output_path,
    release_claims,
    require_room,
    whole_lines,
    write_text,
    writing,
)

HOSTILE = (
    "/etc/passwd",
    "../../out",
    "..",
    ".",
    "",
    "a/b",
    "a\\b",
    "C:\\x",
    "nul",
    "COM1.png",
    "x\0y",
    "new\nline",
    "name ",
    "é" * 300,
    "\udcff",
    "~/x",
)


@pytest.mark.parametrize("name", HOSTILE)
def test_no_name_leads_out_of_the_folder(tmp_path, name):
    folder = tmp_path / "out"
    folder.mkdir()
    path = output_path(folder, name, name, suffix=".png")
    assert path.resolve().is_relative_to(folder.resolve())
    path.write_text("inside")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_plain_names_stay_and_different_names_never_meet():
    for name in ("000123", "cam_front", "1403636579763555584", "frame 7", "Straße", "a.b"):
        assert is_plain_name(name) and file_name(name) == name
    names = [*HOSTILE, "a_b", "a?b", "a*b", "é" * 301]
    assert len({file_name(name) for name in names}) == len(names)


def test_a_link_in_the_folder_leads_nowhere(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    (tmp_path / "elsewhere").mkdir()
    (folder / "overlays").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(SemlocError, match="leads out of"):
        output_path(folder, "overlays", "7", suffix=".png")


def test_a_file_is_old_until_the_new_one_is_whole(tmp_path):
    path = tmp_path / "map.geojson"
    write_text(path, "old")
    path.chmod(0o640)
    with pytest.raises(ZeroDivisionError), writing(path) as partial:
        partial.write_text("half")
        assert 1 / 0
    assert path.read_text() == "old"
    with writing(path) as partial:
        assert partial.suffix == ".geojson"
        partial.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert path.stat().st_mode & 0o777 == 0o640
    assert [p.name for p in tmp_path.iterdir()] == ["map.geojson"]


@pytest.mark.parametrize("name", ["drive", "drive.bag"])
def test_what_is_made_apart_is_there_whole_or_not_at_all(tmp_path, name):
    path = tmp_path / name
    with pytest.raises(RuntimeError), making(path) as partial:
        assert partial.name == name and not partial.exists()
        partial.mkdir()
        raise RuntimeError("full")
    assert list(tmp_path.iterdir()) == []
    with making(path) as partial:
        partial.mkdir()
        (partial / "a").write_text("1")
        assert not path.exists()
    assert (path / "a").read_text() == "1" and list(tmp_path.iterdir()) == [path]


def test_a_new_file_has_the_mode_of_any_other(tmp_path):
    write_text(tmp_path / "ours", "x")
    (tmp_path / "plain").write_text("x")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_lines_survive_a_cut(tmp_path):
    path = tmp_path / "lines"
    assert whole_lines(path) == []
    for line in ("one", "two"):
        append_line(path, line)
    with path.open("a") as file:
        file.write("thr")
    assert whole_lines(path) == ["one", "two"]
    append_line(path, "three")
    assert path.read_text() == "one\ntwo\nthree\n"
    path.write_text("cut")
    append_line(path, "whole")
    assert whole_lines(path) == ["whole"]


HOLD = "import sys, time; from pathlib import Path; from semloc_jax.storage import claim; claim(Path(sys.argv[1]))"


@pytest.fixture
def claims():
    yield
    release_claims()


@pytest.mark.skipif(sys.platform == "win32", reason="no locks on folders")
def test_one_run_at_a_time_and_a_kill_frees_the_folder(tmp_path, claims):
    hold = f"{HOLD}; print('held', flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", hold, str(tmp_path)], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(SemlocError, match="another run is writing to it"):
            claim(tmp_path)
        os.kill(other.pid, signal.SIGKILL)
        other.wait()
    claim(tmp_path)
    claim(tmp_path / ".." / tmp_path.name)
    assert subprocess.run([sys.executable, "-c", HOLD, str(tmp_path)], capture_output=True, check=False).returncode != 0
    release_claims()
    assert subprocess.run([sys.executable, "-c", HOLD, str(tmp_path)], check=False).returncode == 0


def test_gzip_is_unpacked_up_to_a_limit():
    content = b"sweep" * 100_000
    assert decompressed(gzip.compress(content), "x.pkl.gz") == content
    assert decompressed(gzip.compress(b"a") + gzip.compress(b"b") + b"\0" * 9, "x.pkl.gz") == b"ab"
    with pytest.raises(SemlocError, match=r"x\.pkl\.gz: unpacks to more than 2 MB"):
        decompressed(gzip.compress(bytes(50_000_000)), "x.pkl.gz", 2_000_000)
    for broken in (gzip.compress(content)[:-9], b"no gzip", zlib.compress(content)):
        with pytest.raises(SemlocError, match="get the file again"):
            decompressed(broken, "x.pkl.gz")


def test_json_has_a_kind_and_an_end():
    assert json_document('{"a": 1}', "meta.json") == {"a": 1}
    for text, words in (
        ("null", "holds NoneType"),
        ("[1]", "holds list"),
        ("{", "expected JSON"),
        ("[" * 10**5, "JSON"),
    ):
        with pytest.raises(SemlocError, match=words):
            json_document(text, "meta.json")


@pytest.mark.parametrize("count", [1e9, float("inf"), float("nan")])
def test_room_is_asked_for_before_it_is_taken(count):
    with pytest.raises(SemlocError, match="element 'x': asks for .* samples; expected at most 1e"):
        require_room(count, 1e6, "element 'x'", "samples", "give a larger spacing")
    require_room(10, 1e6, "element 'x'", "samples", "give a larger spacing")


def test_a_text_file_may_replace_the_target_of_a_link(tmp_path):
    target, link = tmp_path / "target.csv", tmp_path / "link.csv"
    target.write_text("old")
    link.symlink_to(target)
    write_text(link, "new")
    assert link.is_symlink() and target.read_text() == "new"
    assert Path(os.readlink(link)) == target
