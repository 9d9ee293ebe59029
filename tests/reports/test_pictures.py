"""Pictures of the map over images."""

import inspect
from types import SimpleNamespace

import numpy as np

from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.reports import pictures
from semloc_jax.structs import ElementClass


def test_elements_are_drawn_in_the_order_in_which_they_are_seen(monkeypatch):
    """Of contours that cross, the last one lies on top: in the order of a set it was another one in each process."""
    order = [f"line{k}" for k in (7, 2, 9, 4, 1, 8)]
    ids = np.array(order + order[::-1], dtype=object)
    shown = SimpleNamespace(where=lambda chosen: np.flatnonzero(chosen))
    monkeypatch.setattr(pictures, "camera_picture", lambda *_: (np.zeros((4, 4, 3), np.uint8), shown, ids))
    line = MapElement("line1", ElementClass.LANE_MARKING, np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]), width_m=0.1)
    source = SimpleNamespace(cameras=("front",))
    panels = inspect.unwrap(pictures.element_panels)  # stand-ins pass no check of types
    ((_, _, contours),) = panels(SemanticMap((line,)), source, None, np.eye(4))
    assert list(contours) == order
