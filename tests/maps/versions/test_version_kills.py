"""A kill at any moment of writing a version leaves the old map or the new one, each with a history that leads back."""

import os
import random
import signal
import sys

import pytest

from semloc_jax.maps.versions.difference import difference
from semloc_jax.maps.versions.history import history_of, roll_back, version_at, versions_of, write_version
from semloc_jax.maps.versions.sdiff import write_sdiff
from semloc_jax.maps.versions.state import MapState, read_state
from semloc_jax.reports.versions import report_applied
from tests.maps.versions.made_maps import road

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
CHANGES = ("open", "os.rename", "os.remove", "os.mkdir", "shutil.copyfile", "os.chmod", "sqlite3.connect")


def killed_at(step: int, run) -> bool:
    """Runs in a child that is killed at the n-th change of a file; whether it got that far."""
    pid = os.fork()
    if pid == 0:
        left = step

        def watch(event, values):
            nonlocal left
            is_read = event == "open" and isinstance(values[1], str) and values[1].startswith("r")
            if event in CHANGES and not is_read:
                left -= 1
                if left == 0:
                    os.kill(os.getpid(), signal.SIGKILL)

        try:
            sys.addaudithook(watch)
            run()
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(pid, 0)[1])


def made(folder):
    """A map with two versions, and the file that leads to a third."""
    path = folder / "map.gpkg"
    first, second, third = MapState(road(9)), MapState(road(11, 4), 2), MapState(road(12, 5), 3)
    write_version(first, path)
    write_version(second, path, first, path, "second")
    write_sdiff(difference(second, third), second, folder / "d.sdiff")
    return path, second, third


def kills(folder, steps):
    path, second, third = made(folder)
    finished = 0
    for step in steps:
        done = not killed_at(step, lambda: report_applied(path, folder / "d.sdiff", path))
        state = read_state(path)
        assert state.digest in (second.digest, third.digest)
        assert not done or state.digest == third.digest
        rows = versions_of(path)
        assert [row.version for row in rows] == list(range(state.version, 0, -1))
        assert version_at(path, 1).content == MapState(road(9)).content
        finished += done
        write_version(second, path)
    return finished


def test_a_kill_leaves_the_old_version_or_the_new(tmp_path):
    assert 0 < kills(tmp_path, range(1, 40, 3)) < 13
    assert not [p for p in history_of(tmp_path / "map.gpkg").iterdir() if p.suffix != ".sdiff"][1:]


@pytest.mark.slow
def test_200_kills_leave_the_old_version_or_the_new(tmp_path):
    random.seed(4)
    assert kills(tmp_path, [random.randint(1, 40) for _ in range(200)]) < 200


@pytest.mark.slow
def test_a_killed_rollback_leaves_the_old_version_or_the_new(tmp_path):
    path, second, _ = made(tmp_path)
    for step in range(1, 40, 4):
        done = not killed_at(step, lambda: roll_back(path, 1))
        state = read_state(path)
        assert (state.version, state.content) in ((2, second.content), (3, MapState(road(9)).content))
        assert not done or state.version == 3
        assert version_at(path, 2).digest == second.digest
        write_version(second, path)


def test_a_history_goes_with_the_map_that_was_made_of_it(tmp_path):
    path, second, third = made(tmp_path)
    report_applied(path, tmp_path / "d.sdiff", tmp_path / "next.gpkg")
    assert [row.version for row in versions_of(tmp_path / "next.gpkg")] == [3, 2, 1]
    assert version_at(tmp_path / "next.gpkg", 2).digest == second.digest
    assert read_state(path).digest == second.digest and read_state(tmp_path / "next.gpkg").digest == third.digest
    again = roll_back(tmp_path / "next.gpkg", 1)
    assert (again.version, again.content) == (4, MapState(road(9)).content)
    roll_back(tmp_path / "next.gpkg", 3, tmp_path / "three.gpkg")
    assert [row.version for row in versions_of(tmp_path / "three.gpkg")] == [3, 2, 1]
