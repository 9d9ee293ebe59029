"""Slots and obstacles as a recording: whole or not at all, and in one line where the library is missing."""

import sys

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.viz.recording import RecordedThing, object_recording


def things(num):
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.0, 2.0]])
    return [RecordedThing(f"cone {k}", corners + k, "#ff6d00", k > 0, 0.9) for k in range(num)]


def test_a_recording_is_whole(tmp_path):
    pytest.importorskip("rerun")
    path, empty = tmp_path / "a.rrd", tmp_path / "empty.rrd"
    with object_recording(empty):
        pass
    with object_recording(path) as recording:
        for k in range(3):
            T = np.eye(4)
            T[0, 3] = k
            recording.add(0.2 * k, T, things(3 - k))
    assert path.read_bytes()[:4] == empty.read_bytes()[:4]
    assert path.stat().st_size > empty.stat().st_size + 1000
    with pytest.raises(ValueError, match="stop"), object_recording(tmp_path / "b.rrd"):
        raise ValueError("stop")
    assert not (tmp_path / "b.rrd").exists()
    with pytest.raises(SemlocError, match="no folder"), object_recording(tmp_path / "none" / "a.rrd"):
        pass


def test_nobody_wants_one(tmp_path):
    with object_recording(None) as recording:
        assert recording is None


def test_without_the_library_it_is_said_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(SemlocError, match="rerun-sdk is not installed.*leave out --rrd"):
        with object_recording(tmp_path / "a.rrd"):
            pass
