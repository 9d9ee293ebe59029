"""Windows of the map: each is sampled once, whoever asks first, and a window that was begun ahead is the same."""

import threading

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.localization import map_window
from semloc_jax.localization.map_window import GRID_M, MapWindows
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.structs import ElementClass

HERE, AHEAD = np.zeros(3), np.array([GRID_M, 0.0, 0.0])


@pytest.fixture
def windows():
    line = np.array([[-50.0, 2.0, 0.0], [50.0, 2.0, 0.0]])
    pole = np.array([[12.0, 4.0, 0.0], [12.0, 4.0, 4.0]])
    elements = (
        MapElement("line", ElementClass.LANE_MARKING, line, width_m=0.12),
        MapElement("pole", ElementClass.POLE, pole, radius_m=0.1),
    )
    return MapWindows(SemanticMap(elements), 30.0, 0.5, 1024)


def test_a_window_that_was_begun_ahead_is_sampled_once_and_is_the_same(windows, monkeypatch):
    expected = windows.around(AHEAD)
    windows._windows.clear()
    sampled, begun, may_go_on = [], threading.Event(), threading.Event()
    sample_within = map_window.sample_within

    def slowly(local_map, *settings):
        sampled.append(threading.current_thread().name)
        begun.set()
        assert may_go_on.wait(10.0)
        return sample_within(local_map, *settings)

    monkeypatch.setattr(map_window, "sample_within", slowly)
    windows.prepare(AHEAD)
    assert begun.wait(10.0)
    windows.prepare(AHEAD)
    threading.Timer(0.05, may_go_on.set).start()
    found = windows.around(AHEAD)
    assert found is windows.around(AHEAD)
    assert len(sampled) == 1 and sampled[0] != threading.main_thread().name
    np.testing.assert_array_equal(found.samples.p_map, expected.samples.p_map)
    assert found.element_ids == expected.element_ids
    assert found.is_standing.tolist() == [name == "pole" for name in found.element_ids]


def test_what_fails_ahead_is_raised_for_whoever_asks_and_tried_anew(windows, monkeypatch):
    sample_within = map_window.sample_within

    def fails(*_):
        raise SemlocError("too many samples")

    monkeypatch.setattr(map_window, "sample_within", fails)
    with pytest.raises(SemlocError, match="too many samples"):
        windows.around(HERE)
    monkeypatch.setattr(map_window, "sample_within", sample_within)
    assert windows.around(HERE).nearest_m(HERE[:2]) < 2.5
