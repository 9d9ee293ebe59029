"""What a killed process left in a folder goes with the next writer there; nothing else does."""

import os
import shutil
import signal
import sqlite3
import time

import pytest

from semloc_jax.storage import (
    claim,
    making,
    release_claims,
    remove_folder,
    sweep,
    temporary_prefix,
    write_text,
    writing,
)

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")


@pytest.fixture(autouse=True)
def claims():
    yield
    release_claims()


def _killed(work) -> None:
    """Run in a process of its own what ends in its kill."""
    pid = os.fork()
    if pid == 0:
        try:
            work()
        finally:
            os._exit(1)
    assert os.WTERMSIG(os.waitpid(pid, 0)[1]) == signal.SIGKILL


def _leave_three(folder) -> None:
    """A file, a folder and a database with its journal, all unfinished."""
    with writing(folder / "map.geojson"), making(folder / "bag") as bag, writing(folder / "map.gpkg") as database:
        bag.mkdir()
        (bag / "a").write_text("half")
        connection = sqlite3.connect(database, isolation_level=None)
        connection.execute("PRAGMA cache_size = 1")
        connection.execute("CREATE TABLE t (a)")
        connection.execute("BEGIN")
        connection.executemany("INSERT INTO t VALUES (?)", [("x" * 3000,)] * 50)
        os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("next_write", [claim, lambda folder: write_text(folder / "map.geojson", "new")])
def test_leftovers_of_a_killed_process_go_with_the_next_write(tmp_path, next_write):
    folder = tmp_path / "out"
    folder.mkdir()
    _killed(lambda: _leave_three(folder))
    left = {path.name for path in folder.iterdir()}
    assert len(left) == 4 and all(name.startswith(".") for name in left)
    assert any(name.endswith(".gpkg-journal") for name in left)
    next_write(folder)
    assert [path.name for path in folder.iterdir() if path.name.startswith(".")] == []


def test_a_folder_goes_at_once(tmp_path):
    parts = tmp_path / "parts"
    remove_folder(parts)
    parts.mkdir()
    for name in "abc":
        (parts / name).write_text(name)

    def cut_short():
        shutil.rmtree = lambda path, **_: os.kill(os.getpid(), signal.SIGKILL)
        remove_folder(parts)

    _killed(cut_short)
    assert not parts.exists() and len(list(tmp_path.iterdir())) == 1
    sweep(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_a_living_process_writes_stays(tmp_path):
    reading, telling = os.pipe()
    pid = os.fork()
    if pid == 0:
        with writing(tmp_path / "map.geojson"):
            os.write(telling, b".")
            time.sleep(60)
        os._exit(1)
    os.read(reading, 1)
    with writing(tmp_path / "own") as own:
        sweep(tmp_path)
        assert own.exists() and len(list(tmp_path.iterdir())) == 2
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    sweep(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["own"]


def test_only_names_of_ours_go_and_only_links_of_links(tmp_path):
    folder, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    (elsewhere / "kept").write_text("x")
    ended = os.fork()
    if ended == 0:
        os._exit(0)
    os.waitpid(ended, 0)
    prefix = temporary_prefix("map").replace(str(os.getpid()), str(ended))
    others = [
        ".bashrc",
        ".map-abcd1234.gpkg",
        prefix.lstrip(".") + "abcd1234.gpkg",
        prefix + "abcd",
        prefix + "ABCD1234",
    ]
    for name in others:
        (folder / name).write_text("of the user")
    (folder / (prefix + "abcd1234.gpkg")).write_text("left over")
    (folder / (prefix + "abcd1235")).symlink_to(elsewhere)
    sweep(folder)
    assert sorted(path.name for path in folder.iterdir()) == sorted(others)
    assert (elsewhere / "kept").exists()


def test_of_another_machine_only_what_nobody_touched_for_a_day_goes(tmp_path):
    machine = temporary_prefix("map").split("-")[1]
    other = temporary_prefix("map").replace(machine, "0" * 6 if machine != "0" * 6 else "1" * 6)
    fresh, old = tmp_path / f"{other}abcd1234.csv", tmp_path / f"{other}abcd1235.csv"
    for path in (fresh, old):
        path.write_text("x")
    os.utime(old, (time.time() - 90000.0,) * 2)
    sweep(tmp_path)
    assert list(tmp_path.iterdir()) == [fresh]


def test_a_long_name_keeps_room_for_its_mark(tmp_path):
    path = tmp_path / ("é" * 120 + ".csv")
    write_text(path, "whole")
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
