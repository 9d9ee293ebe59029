"""nuScenes map expansion: `expansion/*.json` (room: maps; host).

In: a parsed expansion. Out: SemanticMap in the metres of the map's own frame, in which the poses of the logs are given.
The format has no heights, no widths and no dashes: see NuScenesStyle. Stop lines and crosswalks are areas.
"""

from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.curves import without_repeats
from semloc_jax.maps.elements import VIRTUAL, MapElement
from semloc_jax.maps.io.paint import assuming, strokes
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.storage import FARTHEST_M
from semloc_jax.structs import ElementClass

_PAINTED_STOPS = frozenset({"STOP_SIGN", "TRAFFIC_LIGHT", "YIELD"})
"""Types of stop line areas that are painted; the others mark where to wait at crossings and turns."""

_LINES, _AREAS = ("lane_divider", "road_divider", "traffic_light"), ("ped_crossing", "stop_line")
"""Layers whose lines and areas are wanted."""
_LONGEST_M = 2e4
"""A longer lane has a corrupt coordinate; our choice."""


@dataclass(frozen=True)
class NuScenesStyle:
    """Sizes that the format leaves open, for Boston and Singapore alike; all are our choice."""

    width_m: float = 0.12
    double_gap_m: float = 0.12
    dash_m: float = 3.0
    gap_m: float = 6.0


def is_nuscenes(document: Any) -> bool:
    """Returns whether a parsed JSON document is a nuScenes map expansion."""
    nodes = document.get("node") if isinstance(document, Mapping) else None
    return isinstance(nodes, Collection) and not isinstance(nodes, str | Mapping) and "lane_divider" in document


def map_from_nuscenes(document: Mapping[str, Any], name: str, style: NuScenesStyle | None = None) -> SemanticMap:
    """Returns the map in a parsed map expansion: dividers, crosswalks, stop lines, traffic lights.

    Args:
        document: the expansion, whole or as a JsonFile.
        name: name of its file, for messages.
        style: widths and dashes that the format leaves open.

    Raises:
        SemlocError: missing or broken parts.
    """
    try:
        nodes = _Nodes(document["node"])
        lines = _used(document, "line", _LINES, "node_tokens", nodes)
        areas = _used(document, "polygon", _AREAS, "exterior_node_tokens", nodes)
        elements = [
            *_dividers(document, nodes, lines, style or NuScenesStyle()),
            *_areas(document, "ped_crossing", ElementClass.CROSSWALK, nodes, areas),
            *_areas(document, "stop_line", ElementClass.STOP_LINE, nodes, areas),
            *_lights(document, nodes, lines),
        ]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        what = f"{type(error).__name__} {str(error)[:60]}"
        raise SemlocError(f"map {name}: cannot be read ({what}); expected a nuScenes map expansion") from error
    return SemanticMap(tuple(elements), None, name, frame="nuScenes map frame")


class _Nodes:
    """Positions of the nodes, and their places in the table by token."""

    def __init__(self, nodes: Collection[Mapping[str, Any]]):
        self.rows: dict[str, int] = {}
        xy = array("d")
        for node in nodes:
            self.rows[node["token"]] = len(xy) // 2
            xy.extend((float(node["x"]), float(node["y"])))
        self._xy = np.array(xy).reshape(-1, 2)

    def points(self, rows: Sequence[int]) -> np.ndarray:
        """Returns the positions of nodes, `float64[k 3]`, height 0."""
        return np.column_stack([self._xy[list(rows)], np.zeros(len(rows))])


def _used(
    document: Mapping[str, Any], table: str, layers: Sequence[str], member: str, nodes: _Nodes
) -> dict[str, "array[int]"]:
    """Returns the nodes of each line or area that one of the layers refers to, by token."""
    wanted = {item[f"{table}_token"] for layer in layers for item in document.get(layer, [])}
    found = {}
    for item in document.get(table, []):
        if item["token"] in wanted:
            found[item["token"]] = array("q", [nodes.rows[token] for token in item[member]])
    return found


def _dividers(
    document: Mapping[str, Any], nodes: _Nodes, lines: Mapping[str, Sequence[int]], style: NuScenesStyle
) -> Iterator[MapElement]:
    """Yields the dividers between lanes and between roads, one element for each run of one type."""
    sizes = (style.width_m, style.double_gap_m, style.dash_m, style.gap_m)
    for layer in ("lane_divider", "road_divider"):
        for divider in document.get(layer, []):
            segments = divider.get(f"{layer}_segments", [])
            kinds = {nodes.rows.get(segment["node_token"]): str(segment["segment_type"]) for segment in segments}
            for index, (kind, rows) in enumerate(_runs(lines[divider["line_token"]], kinds)):
                points = without_repeats(nodes.points(rows))
                if len(points) < 2:
                    continue
                told = {"nuscenes": kind, "layer": layer}
                line = MapElement(
                    f"{divider['token']}_{index}", ElementClass.LANE_MARKING, points, has_height=False, attributes=told
                )
                words = _stroke_words(kind)
                if words:
                    yield from strokes(assuming(line, "width"), words, *sizes)
                else:
                    yield MapElement(line.id, line.label, points, style=VIRTUAL, has_height=False, attributes=told)


def lane_lines(document: Mapping[str, Any], name: str) -> Iterator[np.ndarray]:
    """Yields the centre lines of lanes and of their ways through crossings, `float64[k 3]`, in the frame of the map.

    A line is a chain of Dubins paths: three parts each, of one radius, to the left, straight on or to the right.

    Args:
        document: the expansion, whole or as a JsonFile.
        name: name of its file, for messages.

    Raises:
        SemlocError: a malformed path.
    """
    paths = document.get("arcline_path_3", {})
    for token, chain in paths.items() if isinstance(paths, Mapping) else ():
        try:
            places = [_dubins(path) for path in chain]
        except (KeyError, TypeError, ValueError) as error:
            what = f"{type(error).__name__} {str(error)[:60]}"
            raise SemlocError(f"map {name}: lane {str(token)[:40]} cannot be read ({what})") from error
        if places:
            yield without_repeats(np.vstack(places))


def _dubins(path: Mapping[str, Any]) -> np.ndarray:
    """Returns places at most 0.5 m apart along one path, `float64[k 3]`, height 0."""
    x, y, heading = (float(value) for value in path["start_pose"])
    radius_m, lengths_m = float(path["radius"]), [float(value) for value in path["segment_length"]]
    if not (radius_m > 0.0 and min(lengths_m) >= 0.0 and sum(lengths_m) < _LONGEST_M and abs(x) + abs(y) < FARTHEST_M):
        raise ValueError(f"radius {radius_m:g}, lengths {lengths_m}")
    places = [np.array([[x, y, 0.0]])]
    for turn, length_m in zip(path["shape"], lengths_m, strict=True):
        bend = {"L": 1.0, "S": 0.0, "R": -1.0}[turn] / radius_m
        s = np.linspace(0.0, length_m, int(2.0 * length_m) + 2)[1:]
        # The chord of an arc: sin(a) / a of its length, half-way between the headings of its ends.
        chord, course = s * np.sinc(0.5 * bend * s / np.pi), heading + 0.5 * bend * s
        places.append(np.column_stack([x + chord * np.cos(course), y + chord * np.sin(course), np.zeros(len(s))]))
        (x, y, _), heading = places[-1][-1], heading + bend * length_m
    return np.vstack(places)


def _runs(rows: Sequence[int], kinds: Mapping[int | None, str]) -> list[tuple[str, list[int]]]:
    """Returns the runs of one type along a line; a node states the type of the segment that starts at it."""
    found: list[tuple[str, list[int]]] = []
    for start, end in pairwise(rows):
        kind = kinds.get(start, "NIL")
        if not found or found[-1][0] != kind:
            found.append((kind, [start]))
        found[-1][1].append(end)
    return found


def _stroke_words(kind: str) -> list[str]:
    """Returns solid or dashed for each stroke of a type such as DOUBLE_DASHED_WHITE; none for zigzags and NIL."""
    words = kind.lower().split("_")
    found = [word for word in words if word in ("solid", "dashed")]
    return found * 2 if "double" in words and len(found) == 1 else found


def _areas(
    document: Mapping[str, Any],
    layer: str,
    label: ElementClass,
    nodes: _Nodes,
    areas: Mapping[str, Sequence[int]],
) -> Iterator[MapElement]:
    """Yields the areas of a layer; stop areas without paint are logical."""
    for item in document.get(layer, []):
        points = without_repeats(nodes.points(areas[item["polygon_token"]]), closed=True)
        kind = str(item.get("stop_line_type", ""))
        if len(points) > 2:
            style = VIRTUAL if kind and kind not in _PAINTED_STOPS else ""
            told = {"nuscenes": kind or layer}
            yield MapElement(
                str(item["token"]), label, points, closed=True, style=style, has_height=False, attributes=told
            )


def _lights(document: Mapping[str, Any], nodes: _Nodes, lines: Mapping[str, Sequence[int]]) -> Iterator[MapElement]:
    """Yields traffic lights as logical ones: the format states neither their height nor their size."""
    for item in document.get("traffic_light", []):
        points = nodes.points(lines[item["line_token"]])
        if len(points) >= 2:
            told = {"nuscenes": str(item.get("traffic_light_type", ""))}
            axis = points[[0, -1]]
            yield MapElement(
                str(item["token"]),
                ElementClass.TRAFFIC_LIGHT,
                axis,
                style=VIRTUAL,
                has_height=False,
                attributes=told,
            )
