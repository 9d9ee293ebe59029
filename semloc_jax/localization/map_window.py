"""The part of the map around the vehicle, sampled once and kept while the vehicle drives through it (room:
localization; host).

In: a SemanticMap and a place. Out: MapWindow. Which window belongs to a place depends on the place alone, so that a
resumed run sees the same samples as an uninterrupted one.
"""

import threading
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from semloc_jax.alignment.frame_localizer import sample_within
from semloc_jax.maps import LocalMap, SemanticMap
from semloc_jax.structs import STANDING_CLASSES, MapSamples

GRID_M = 10.0
"""Windows are centred on a grid of this width."""
_KEPT = 8


AHEAD = "map sampled ahead"
"""Name of the threads that do it: each keeps its map until it ends."""


@dataclass(frozen=True)
class MapWindow:
    """Elements and samples around a place.

    Attributes:
        local_map: Elements, lines cut at the radius.
        samples: Samples in `local_map.frame`, of fixed capacity.
        rows: Which element of the map each element is, or is a part of, `int64[element]`.
    """

    local_map: LocalMap
    samples: MapSamples
    rows: np.ndarray

    @cached_property
    def element_ids(self) -> tuple[str, ...]:
        """Id of each element of the local map; the parts of a cut line share theirs."""
        return tuple(element.id for element in self.local_map.elements)

    @cached_property
    def is_standing(self) -> np.ndarray:
        """Whether each element stands upright, `bool[element]`."""
        return np.array([element.label in STANDING_CLASSES for element in self.local_map.elements], bool)

    @cached_property
    def _points_xy(self) -> np.ndarray:
        valid = np.asarray(self.samples.valid)
        return self.local_map.frame.to_map(np.asarray(self.samples.p_map)[valid, :2])

    def nearest_m(self, xy: np.ndarray) -> float:
        """Horizontal distance from a place of the map frame to the nearest sample [m]; infinite without samples."""
        if not len(self._points_xy):
            return float("inf")
        return float(np.min(np.hypot(*(self._points_xy - xy).T)))


class MapWindows:
    """Windows of one map, the last few kept."""

    def __init__(self, semantic_map: SemanticMap, radius_m: float, spacing_m: float, capacity: int):
        """Prepare a map.

        Args:
            semantic_map: The map.
            radius_m: How far a camera looks; the window reaches farther by half a grid cell.
            spacing_m: Distance of samples along a contour.
            capacity: Rows of samples; where the map holds more, the spacing grows.
        """
        self.map, self.radius_m, self.spacing_m, self.capacity = semantic_map, radius_m, spacing_m, capacity
        self._windows: OrderedDict[tuple[int, ...], Future[MapWindow]] = OrderedDict()
        self._lock = threading.Lock()

    def around(self, p_map: np.ndarray) -> MapWindow:
        """The window of a place of the map frame, `[3]` [m]. Several threads may ask."""
        key, window, is_new = self._entry(p_map)
        if is_new:
            self._sample(key, window)
        return window.result()

    def prepare(self, p_map: np.ndarray) -> None:
        """Begin to sample the window of a place that will be asked for, in a thread of its own."""
        key, window, is_new = self._entry(p_map)
        if is_new:
            threading.Thread(target=self._sample, args=(key, window), name=AHEAD, daemon=True).start()

    def _entry(self, p_map: np.ndarray) -> tuple[tuple[int, ...], Future[MapWindow], bool]:
        """The key of a place, its window, and whether whoever asked has to fill it."""
        key = tuple(int(k) for k in np.round(p_map / GRID_M))
        with self._lock:
            is_new = key not in self._windows
            if is_new:
                self._windows[key] = Future()
                while len(self._windows) > _KEPT:
                    self._windows.popitem(last=False)
            else:
                self._windows.move_to_end(key)
            return key, self._windows[key], is_new

    def _sample(self, key: tuple[int, ...], window: Future[MapWindow]) -> None:
        center = np.array(key, dtype=np.float64) * GRID_M
        try:
            local_map = self.map.query(center, self.radius_m + 0.71 * GRID_M)
            samples = sample_within(local_map, self.spacing_m, self.capacity)
            rows = self.map.rows_of(element.id for element in local_map.elements)
            window.set_result(MapWindow(local_map, samples, rows))
        except BaseException as error:
            with self._lock:
                self._windows.pop(key, None)
            window.set_exception(error)  # raised again by whoever asks
