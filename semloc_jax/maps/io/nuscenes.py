"""nuScenes map expansion: `expansion/*.json` (room: maps; host).

In: a parsed expansion. Out: SemanticMap in the metres of the map's own frame, in which the poses of the logs are given.
The format has no heights, no widths and no dashes: see NuScenesStyle. Stop lines and crosswalks are areas.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.curves import without_repeats
from semloc_jax.maps.elements import VIRTUAL, MapElement
from semloc_jax.maps.io.paint import assuming, strokes
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.structs import ElementClass

_PAINTED_STOPS = frozenset({"STOP_SIGN", "TRAFFIC_LIGHT", "YIELD"})
"""Types of stop line areas that stand for paint; the others are waits at crossings and turns."""


@dataclass(frozen=True)
class NuScenesStyle:
    """Sizes that the format leaves open, for Boston and Singapore alike; all are ours."""

    width_m: float = 0.12
    double_gap_m: float = 0.12
    dash_m: float = 3.0
    gap_m: float = 6.0


def is_nuscenes(document: Any) -> bool:
    """Returns whether a parsed JSON document is a nuScenes map expansion."""
    return isinstance(document, Mapping) and "lane_divider" in document and isinstance(document.get("node"), list)


def map_from_nuscenes(document: Mapping[str, Any], name: str, style: NuScenesStyle | None = None) -> SemanticMap:
    """Returns the map in a parsed map expansion: dividers, crosswalks, stop lines, traffic lights.

    Args:
        document: the expansion.
        name: name of its file, for messages.
        style: widths and dashes that the format leaves open.

    Raises:
        SemlocError: missing or broken parts.
    """
    try:
        nodes = {node["token"]: (float(node["x"]), float(node["y"]), 0.0) for node in document["node"]}
        lines = {line["token"]: line["node_tokens"] for line in document.get("line", [])}
        areas = {area["token"]: area["exterior_node_tokens"] for area in document.get("polygon", [])}
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


def _points(nodes: Mapping[str, tuple], tokens: Sequence[str]) -> np.ndarray:
    return np.array([nodes[token] for token in tokens], dtype=np.float64).reshape(-1, 3)


def _dividers(
    document: Mapping[str, Any], nodes: Mapping[str, tuple], lines: Mapping[str, Any], style: NuScenesStyle
) -> Iterator[MapElement]:
    """Yields the dividers between lanes and between roads, one element for each run of one type."""
    sizes = (style.width_m, style.double_gap_m, style.dash_m, style.gap_m)
    for layer in ("lane_divider", "road_divider"):
        for divider in document.get(layer, []):
            segments = divider.get(f"{layer}_segments", [])
            kinds = {segment["node_token"]: str(segment["segment_type"]) for segment in segments}
            for index, (kind, tokens) in enumerate(_runs(lines[divider["line_token"]], kinds)):
                points = without_repeats(_points(nodes, tokens))
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


def _runs(tokens: Sequence[str], kinds: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    """Returns the runs of one type along a line; a node tells the type of the segment that begins at it."""
    found: list[tuple[str, list[str]]] = []
    for start, end in pairwise(tokens):
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
    nodes: Mapping[str, tuple],
    areas: Mapping[str, Any],
) -> Iterator[MapElement]:
    """Yields the areas of a layer; stop areas that stand for no paint are logical."""
    for item in document.get(layer, []):
        points = without_repeats(_points(nodes, areas[item["polygon_token"]]), closed=True)
        kind = str(item.get("stop_line_type", ""))
        if len(points) > 2:
            style = VIRTUAL if kind and kind not in _PAINTED_STOPS else ""
            told = {"nuscenes": kind or layer}
            yield MapElement(
                str(item["token"]), label, points, closed=True, style=style, has_height=False, attributes=told
            )


def _lights(document: Mapping[str, Any], nodes: Mapping[str, tuple], lines: Mapping[str, Any]) -> Iterator[MapElement]:
    """Yields traffic lights as logical ones: the format tells neither their height nor their size."""
    for item in document.get("traffic_light", []):
        points = _points(nodes, lines[item["line_token"]])
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
