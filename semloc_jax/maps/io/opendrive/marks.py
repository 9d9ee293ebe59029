"""What is painted along lane borders: <roadMark> laid out as strokes and bars (room: maps; host).

In: a Road. Out: map elements. Lengths and spaces of dashes come from the file; see OpenDriveStyle for what it leaves
open. Where two strokes are only named ("solid broken"), the first is the inner one, on the centre lane the left one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import VIRTUAL, MapElement
from semloc_jax.maps.io.opendrive.road import Lane, LaneSection, Road
from semloc_jax.maps.io.xml_stream import number
from semloc_jax.structs import ElementClass

_UNPAINTED = frozenset({"none", "grass", "edge", "botts dots", "custom", ""})
_SHORTEST_PERIOD_M = 0.05
_MOST_BARS = 50_000
_DRIVEN = frozenset(
    "driving entry exit onRamp offRamp connectingRamp slipLane bidirectional bus taxi HOV parking stop biking".split()
)


@dataclass(frozen=True)
class OpenDriveStyle:
    """Sizes that an OpenDRIVE file may leave open. All are our choice; `assumed` marks the elements that use them."""

    standard_width_m: float = 0.12
    bold_width_m: float = 0.25
    double_gap_m: float = 0.12
    """Clear distance of the two strokes of a double line."""
    dash_m: float = 3.0
    gap_m: float = 6.0
    stop_line_width_m: float = 0.5
    head_ratio: float = 2.6
    """Height of the head of a traffic light against its width, where the file gives pole and head in one."""
    pole_radius_m: float = 0.06
    """Radius of the pole below such a head."""
    tallest_head_m: float = 1.5
    """A traffic light that is taller stands on the ground with its pole."""


class _Stroke(NamedTuple):
    """One line of a mark, with places relative to the start of the mark; space 0 is a solid line."""

    offset_t: float
    start: float
    length: float
    space: float
    width: float
    once: bool
    assumed: tuple[str, ...]


def mark_elements(road: Road, style: OpenDriveStyle) -> Iterator[MapElement]:
    """Yields what is painted along the lane borders of a road, curbs, and unpainted borders of driven lanes."""
    for index, section in enumerate(road.sections):
        for lane in section.lanes.values():
            name = f"r{road.id}_s{index}_l{lane.id}"
            spans = list(_mark_spans(lane, section, road.where))
            for number_of_mark, (mark, start, end) in enumerate(spans):
                yield from _mark(road, section, lane, mark, start, end, f"{name}_m{number_of_mark}", style)
            if lane.kind == "curb":
                yield _curb(road, section, lane, name)
            if not spans and lane.kind in _DRIVEN and lane.id != 0:
                points = road.border(section, lane.id, section.start, section.end)
                yield MapElement(f"{name}_border", ElementClass.LANE_MARKING, points, style=VIRTUAL)


def _mark_spans(lane: Lane, section: LaneSection, where: str) -> Iterator[tuple[Element, float, float]]:
    """Yields each mark of a lane with the s where it begins and where the next one or the section ends it."""
    starts = [section.start + number(mark, "sOffset", where) for mark in lane.marks]
    order = np.argsort(starts, kind="stable")
    bounds = [*(starts[i] for i in order), section.end]
    for i, (start, end) in zip(order, pairwise(bounds), strict=True):
        start, end = max(start, section.start), min(end, section.end)
        if end - start > 1e-3:
            yield lane.marks[i], start, end


def _mark(
    road: Road,
    section: LaneSection,
    lane: Lane,
    mark: Element,
    start: float,
    end: float,
    name: str,
    style: OpenDriveStyle,
) -> Iterator[MapElement]:
    """Yields the elements of one mark: strokes, bars, a curb, or a logical line where nothing is painted."""
    kind = mark.get("type", "none")
    attributes: dict[str, Any] = {"opendrive": kind, "lane": lane.kind}
    if mark.get("color", "standard") != "standard":
        attributes["color"] = mark.get("color")
    if kind == "curb":
        points = road.border(section, lane.id, start, end)
        yield MapElement(name, ElementClass.CURB, points, style="solid", attributes=attributes)
    elif kind in _UNPAINTED:
        if lane.kind in _DRIVEN or lane.id == 0:
            points = road.border(section, lane.id, start, end)
            yield MapElement(name, ElementClass.LANE_MARKING, points, style=VIRTUAL, attributes=attributes)
    else:
        for index, stroke in enumerate(_strokes(mark, lane.id, road.where, style)):
            stroke_name = f"{name}_{index}"
            told = {**attributes, "assumed": list(stroke.assumed)} if stroke.assumed else attributes
            yield from _paint(road, section, lane, stroke, start, end, stroke_name, told)


def _paint(
    road: Road,
    section: LaneSection,
    lane: Lane,
    stroke: _Stroke,
    start: float,
    end: float,
    name: str,
    attributes: dict[str, Any],
) -> Iterator[MapElement]:
    """Yields one stroke of a mark as a line, or its dashes as bars."""
    first = start + stroke.start
    values = {"width_m": stroke.width, "attributes": attributes}
    if stroke.space <= 0.0 and not stroke.once:
        if end - first > 1e-3:
            points = road.border(section, lane.id, first, end, stroke.offset_t)
            yield MapElement(name, ElementClass.LANE_MARKING, points, style="solid", **values)
        return
    period = stroke.length + stroke.space
    count = 1 if stroke.once else max(int(np.ceil((end - first) / period)), 0)
    if count > _MOST_BARS:
        raise SemlocError(f"{road.where}: {count} dashes in one mark; expected less than {_MOST_BARS}")
    bars = [(first + k * period, min(first + k * period + stroke.length, end)) for k in range(count)]
    bars = [(start, stop) for start, stop in bars if stop - start > 1e-2]
    is_known = "dashes" not in stroke.assumed
    values |= {"style": "dashed", "true_ends": (is_known, is_known)}
    for k, points in enumerate(road.borders(section, lane.id, bars, stroke.offset_t)):
        yield MapElement(f"{name}_{k}", ElementClass.LANE_MARKING, points, **values)


def _strokes(mark: Element, lane_id: int, where: str, style: OpenDriveStyle) -> list[_Stroke]:
    """Returns the strokes of a mark: as the file lays them out, else after its name."""
    assumed: tuple[str, ...] = ()
    width = number(mark, "width", where, limit=10.0)
    if width <= 0.0:
        width = style.bold_width_m if mark.get("weight") == "bold" else style.standard_width_m
        assumed = ("width",)
    lines = [_line(line, width, assumed, where, False) for line in mark.findall("type/line")]
    lines += [_line(line, width, assumed, where, True) for line in mark.findall("explicit/line")]
    if lines:
        return lines
    words = [word for word in mark.get("type", "").split() if word in ("solid", "broken")] or ["solid"]
    shift = 0.5 * (width + style.double_gap_m)
    # Towards the centre lane is to the left of a right border, to the right of a left one.
    inner = shift if lane_id <= 0 else -shift
    offsets = [0.0] if len(words) == 1 else [inner, -inner]
    found = []
    for word, offset in zip(words, offsets, strict=False):
        if word == "broken":
            told = (*assumed, "dashes")
            found.append(_Stroke(offset, 0.5 * style.gap_m, style.dash_m, style.gap_m, width, False, told))
        else:
            found.append(_Stroke(offset, 0.0, 0.0, 0.0, width, False, assumed))
    return found


def _line(line: Element, width: float, assumed: tuple[str, ...], where: str, once: bool) -> _Stroke:
    """Returns one stroke as the file lays it out; `once` is a single bar of an explicit mark."""
    own = number(line, "width", where, limit=10.0)
    width, assumed = (own, ()) if own > 0.0 else (width, assumed)
    length, space = (max(number(line, key, where, limit=1e6), 0.0) for key in ("length", "space"))
    offset_t = number(line, "tOffset", where, limit=100.0)
    start = max(number(line, "sOffset", where, limit=1e6), 0.0)
    if once:
        return _Stroke(offset_t, start, length, 0.0, width, True, assumed)
    if space > 0.0 and length + space < _SHORTEST_PERIOD_M:
        raise SemlocError(f"{where}: dashes of {length:g} m every {length + space:g} m; expected at least 5 cm")
    return _Stroke(offset_t, start, length, space if length > 0.0 else 0.0, width, False, assumed)


def _curb(road: Road, section: LaneSection, lane: Lane, name: str) -> MapElement:
    """Returns the edge between the road and a lane that is a curb: its inner border."""
    inner = lane.id - int(np.sign(lane.id))
    points = road.border(section, inner, section.start, section.end)
    return MapElement(f"{name}_curb", ElementClass.CURB, points, style="solid")
