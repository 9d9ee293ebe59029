"""What a Lanelet2 way cannot say about an element, kept in one tag of its own (room: maps; host).

In: an element. Out: the tag `semloc`, which other programs pass over, and the same element back.
"""

import json
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import MapElement
from semloc_jax.structs import ElementClass

TAG = "semloc"
_DEFAULTS: dict[str, Any] = {
    "closed": False,
    "width_m": 0.0,
    "radius_m": 0.0,
    "radius_top_m": 0.0,
    "height_m": 0.0,
    "style": "",
    "shape": "",
}


def to_tag(element: MapElement, drawn: np.ndarray) -> str:
    """Returns the value of the tag: everything but the points that the way itself draws.

    Args:
        element: the element.
        drawn: nodes of its way, `[k 3]`.
    """
    members: dict[str, Any] = {"id": element.id, "class": element.label.name}
    members |= {key: getattr(element, key) for key, usual in _DEFAULTS.items() if getattr(element, key) != usual}
    if element.true_ends != (True, True):
        members["true_ends"] = list(element.true_ends)
    if not element.has_height:
        members["has_height"] = False
    if element.normal is not None:
        members["normal"] = [float(v) for v in element.normal]
    if drawn.shape != element.points.shape or not np.array_equal(drawn, element.points):
        members["points"] = (element.points - drawn[0]).round(6).tolist()
    if element.attributes:
        members["attributes"] = dict(element.attributes)
    return json.dumps(members, allow_nan=False)


def from_tag(text: str, drawn: np.ndarray, has_height: bool, where: str) -> MapElement:
    """Returns the element that `to_tag` wrote.

    Args:
        text: value of the tag.
        drawn: nodes of its way in the map frame, `[k 3]` [m].
        has_height: whether the nodes came with heights.
        where: what to say before messages.

    Raises:
        SemlocError: the tag was edited or truncated.
    """
    try:
        members = json.loads(text)
        points = drawn
        if "points" in members:
            points = drawn[0] + np.array(members["points"], dtype=np.float64).reshape(-1, 3)
        elif members.get("closed") and len(points) > 1 and np.array_equal(points[0], points[-1]):
            points = points[:-1]
        values = {key: type(usual)(members.get(key, usual)) for key, usual in _DEFAULTS.items()}
        sizes = [values[key] for key in values if key.endswith("_m")]
        normal = members.get("normal")
        true_ends = members.get("true_ends", [True, True])
        attributes = members.get("attributes", {})
        if not (np.isfinite(points).all() and np.isfinite(sizes).all() and isinstance(attributes, dict)):
            raise ValueError("numbers that are not finite")
        return MapElement(
            id=str(members["id"]),
            label=ElementClass[members["class"]],
            points=points,
            normal=None if normal is None else np.array(normal, dtype=np.float64).reshape(3),
            true_ends=(bool(true_ends[0]), bool(true_ends[1])),
            has_height=has_height and bool(members.get("has_height", True)),
            attributes=attributes,
            **values,
        )
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise SemlocError(f"{where}: its tag `{TAG}` cannot be read ({str(error)[:60]}); remove the tag") from error
