"""The state of a run is written often enough, behind its lines, and the last one whatever ends the run."""

from types import SimpleNamespace

import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Frame
from semloc_jax.localization.checkpoint import Checkpoint
from semloc_jax.localization.pipeline import Pipeline
from semloc_jax.reports import track
from semloc_jax.reports.track_log import TrackLog

RIG = Rig((PinholeCamera(500.0, 500.0, 320.0, 200.0, 640, 400),), np.eye(4)[None], ("front",))
FRAMES = [Frame(k, f"{k:06d}", 0.2 * k, "", RIG, {}) for k in range(12)]


class Played(Pipeline):
    """A drive whose frames take 0.2 s each; it ends before `until`."""

    def __init__(self, clock, realtime=False, until=None):
        self.clock, self.until, self.config = clock, until, SimpleNamespace(realtime=realtime)

    def run(self, frames, start, on_frame):
        for index in range(start.next_frame if start else 0, len(frames)):
            if index == self.until:
                raise KeyboardInterrupt
            self.clock[0] += 0.2
            on_frame(Checkpoint(None, index + 1, True), SimpleNamespace(frame_id=frames[index].id))
            yield index


@pytest.fixture
def followed(monkeypatch, tmp_path):
    """Follows a drive; gives what was written, in order: lines by their frame, states by their next frame."""
    written, clock = [], [0.0]
    monkeypatch.setattr(track.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(track.checkpoint, "save", lambda at, path: written.append(at.next_frame))

    class Lines(TrackLog):
        def __init__(self):
            pass

        def append(self, frame, result):
            written.append(frame.id)

    def follow(start=None, **played):
        last = track._drive(Played(clock, **played), FRAMES, start, Lines(), tmp_path / "state.npz")
        return last.next_frame if last else None

    return follow, written


def test_a_state_follows_its_lines_every_half_second_and_at_the_end(followed):
    follow, written = followed
    assert follow() == 12
    assert [one for one in written if isinstance(one, int)] == [3, 6, 9, 12]
    assert [one for one in written if isinstance(one, str)] == [frame.id for frame in FRAMES]
    assert written.index(6) == written.index("000005") + 1


def test_whatever_ends_a_run_leaves_the_state_of_its_last_frame(followed):
    follow, written = followed
    with pytest.raises(KeyboardInterrupt):
        follow(until=8)
    assert written[-1] == 8 and written.count(8) == 1


def test_a_run_without_a_frame_writes_no_state(followed):
    follow, written = followed
    assert follow(start=Checkpoint(None, 12, True)) == 12
    with pytest.raises(KeyboardInterrupt):
        follow(until=0)
    assert written == []


def test_a_run_in_real_time_writes_every_state(followed):
    follow, written = followed
    assert follow(realtime=True) == 12
    assert [one for one in written if isinstance(one, int)] == list(range(1, 13))
