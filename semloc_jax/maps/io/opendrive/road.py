"""One OpenDRIVE road: reference line, heights, banking, lanes and their borders (room: maps; host).

In: a <road> element. Out: Road, which maps (s, t, h) to the map frame and knows where every lane border runs.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.curves import simplify
from semloc_jax.maps.io.opendrive.plan_view import PlanView
from semloc_jax.maps.io.opendrive.profile import LateralShape, Profile
from semloc_jax.maps.io.xml_stream import number

_SAME_PLACE_M = 1e-6
_SIMPLE_M = 0.001
"""Vertices that move a border less than this are left out."""
_CHORD_ERROR_M = 0.001
_LONGEST_M = 2e5
_MOST_PLACES = 300_000
_MOST_WORK = 500_000_000
"""Places times the square of the number of lanes: what the borders of one road may cost."""
_MOST_LANES = 100
_CAR_LANES = frozenset({"driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane", "bidirectional"})


@dataclass(frozen=True)
class Lane:
    """One lane of a section.

    Attributes:
        id: number, positive to the left of the centre lane, which is 0.
        kind: type, such as driving or sidewalk.
        width: over s.
        border: over s, where the file gives borders in place of widths.
        height: rise of the outer border above the road surface, over s.
        marks: the <roadMark> elements.
    """

    id: int
    kind: str
    width: Profile
    border: Profile
    height: Profile
    marks: tuple[Element, ...]


@dataclass(frozen=True)
class LaneSection:
    """Lanes between two places of a road; `lanes` by id."""

    start: float
    end: float
    lanes: dict[int, Lane]
    offset: Profile

    def border_t(self, lane_id: int, s: np.ndarray) -> np.ndarray:
        """Returns t of the outer border of a lane at `s` `[n]`; of the centre line for lane 0 [m]."""
        t = self.offset.at(s)
        lane = self.lanes.get(lane_id)
        if lane is not None and len(lane.border.starts):
            return t + lane.border.at(s)
        side = int(np.sign(lane_id))
        for inner in range(side, lane_id + side, side or 1):
            if inner in self.lanes:
                t = t + side * self.lanes[inner].width.at(s)
        return t

    def lift(self, lane_id: int, s: np.ndarray) -> np.ndarray:
        """Returns how far the outer border of a lane lies above the road surface at `s` `[n]` [m]."""
        return self.lanes[lane_id].height.at(s) if lane_id in self.lanes else np.zeros_like(s)


@dataclass(frozen=True)
class Road:
    """A road of the file.

    Attributes:
        id: as in the file.
        length: along the reference line [m].
        drives_right: whether traffic keeps to the right.
        places: dense places along the reference line, `float64[n]` [m].
        xml: the element, for objects and signals.
    """

    id: str
    length: float
    drives_right: bool
    where: str
    plan: PlanView
    elevation: Profile
    superelevation: Profile
    shape: LateralShape
    sections: tuple[LaneSection, ...]
    places: np.ndarray = field(repr=False)
    xml: Element = field(repr=False)

    @classmethod
    def from_xml(cls, xml: Element, name: str) -> "Road":
        """Returns the road in a <road> element of the map `name`.

        Raises:
            SemlocError: no geometry, or numbers that no road has.
        """
        where = f"map {name}: road {xml.get('id', '?')[:40]}"
        plan = PlanView.from_xml(xml.find("planView"), where)
        length = min(number(xml, "length", where, plan.length), plan.length) or plan.length
        if not 0.0 < length <= _LONGEST_M:
            raise SemlocError(f"{where}: length {length:g} m; expected more than 0 and at most {_LONGEST_M:g}")
        elevation = Profile.from_records(xml.findall("elevationProfile/elevation"), where)
        banking = Profile.from_records(xml.findall("lateralProfile/superelevation"), where)
        sections = _sections(xml, length, where)
        places = _places(plan, elevation, banking, sections, length, where)
        return cls(
            id=xml.get("id", ""),
            length=length,
            drives_right=xml.get("rule", "RHT") != "LHT",
            where=where,
            plan=plan,
            elevation=elevation,
            superelevation=banking,
            shape=LateralShape.from_records(xml.findall("lateralProfile/shape"), where),
            sections=sections,
            places=places[(places >= 0.0) & (places <= length)],
            xml=xml,
        )

    def locate(self, s: np.ndarray, t: np.ndarray, h: np.ndarray | float = 0.0) -> np.ndarray:
        """Returns points `[n 3]` [m] of the file's frame: `s` along, `t` to the left of the road, `h` straight up."""
        s, t = np.broadcast_arrays(np.asarray(s, dtype=np.float64), np.asarray(t, dtype=np.float64))
        x, y, heading = self.plan.at(s)
        pitch, roll = np.arctan(self.elevation.slope(s)), self.superelevation.at(s)
        lift = self.shape.at(s, t)
        # The road is turned by heading, then pitch, then roll about its own axes.
        left = t * np.cos(roll) - lift * np.sin(roll)
        normal = t * np.sin(roll) + lift * np.cos(roll)
        ahead = -normal * np.sin(pitch)
        up = self.elevation.at(s) + normal * np.cos(pitch) + h
        return np.stack(
            [
                x + ahead * np.cos(heading) - left * np.sin(heading),
                y + ahead * np.sin(heading) + left * np.cos(heading),
                up,
            ],
            axis=-1,
        )

    def heading(self, s: float) -> float:
        """Returns the direction of the reference line at `s` [rad]."""
        return float(self.plan.at(np.array([s]))[2][0])

    def borders(
        self, section: LaneSection, lane_id: int, spans: list[tuple[float, float]], shift_m: float = 0.0
    ) -> list[np.ndarray]:
        """Returns the outer border of a lane over each span from start to end, all located at once; see `border`."""
        parts = [self.between(start, end) for start, end in spans]
        s = np.concatenate([np.zeros(0), *parts])
        t = section.border_t(lane_id, s) + shift_m
        points = self.locate(s, t, section.lift(lane_id, s))
        cuts = np.cumsum([len(part) for part in parts])[:-1]
        return [simplify(part, _SIMPLE_M) if len(part) > 2 else part for part in np.split(points, cuts) if len(part)]

    def border(self, section: LaneSection, lane_id: int, start: float, end: float, shift_m: float = 0.0) -> np.ndarray:
        """Returns the outer border of a lane from `start` to `end`, moved `shift_m` to the left, `[k 3]` [m]."""
        return self.borders(section, lane_id, [(start, end)], shift_m)[0]

    def driving_lanes(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yields the left and the right border of each lane for cars in its direction of travel, `[k 3]` [m]."""
        for section in self.sections:
            for lane in section.lanes.values():
                if lane.id == 0 or lane.kind not in _CAR_LANES:
                    continue
                inner = lane.id - int(np.sign(lane.id))
                near, far = (self.border(section, number, section.start, section.end) for number in (inner, lane.id))
                left, right = (near, far) if lane.id < 0 else (far, near)
                # Seen along the road; lanes of the other direction are turned round, which swaps their sides.
                yield (left, right) if (lane.id < 0) == self.drives_right else (right[::-1], left[::-1])

    def between(self, start: float, end: float) -> np.ndarray:
        """Returns `start`, the dense places between, and `end`."""
        inside = self.places[np.searchsorted(self.places, start + 1e-4) : np.searchsorted(self.places, end - 1e-4)]
        return np.concatenate([[start], inside, [end]])


def _places(
    plan: PlanView, elevation: Profile, banking: Profile, sections: tuple[LaneSection, ...], length: float, where: str
) -> np.ndarray:
    """Returns places along a road between which straight lines follow everything on it, ascending.

    Raises:
        SemlocError: so many that no real road needs them.
    """
    found = [plan.samples(where), elevation.samples(length, _CHORD_ERROR_M)]
    found.append(banking.samples(length, 0.1 * _CHORD_ERROR_M))
    work = 0
    for section in sections:
        found.append(_section_knots(section))
        count = sum(len(part) for part in found)
        work += count * len(section.lanes) ** 2
        if count > _MOST_PLACES or work > _MOST_WORK:
            raise SemlocError(f"{where}: {count} places on {len(section.lanes)} lanes; expected what a road needs")
    return np.unique(np.concatenate(found))


def _sections(xml: Element, length: float, where: str) -> tuple[LaneSection, ...]:
    offset = Profile.from_records(xml.findall("lanes/laneOffset"), where)
    records = sorted(xml.findall("lanes/laneSection"), key=lambda record: number(record, "s", where))
    starts = [number(record, "s", where) for record in records]
    found = []
    for record, start, end in zip(records, starts, [*starts, length][1:], strict=True):
        end = min(end, length)
        if end - start > _SAME_PLACE_M:
            lanes = [_lane(lane, start, where) for side in record for lane in side.findall("lane")]
            found.append(LaneSection(start, end, {lane.id: lane for lane in lanes}, offset))
    return tuple(found)


def _lane(xml: Element, start: float, where: str) -> Lane:
    text = xml.get("id", "")
    try:
        lane_id = int(text)
    except ValueError:
        lane_id = 10_000
    if abs(lane_id) > _MOST_LANES:
        raise SemlocError(f"{where}: lane id '{text[:40]}'; expected a whole number within {_MOST_LANES}")
    heights = Profile.from_records(xml.findall("height"), where, "sOffset", start)
    outer = np.array([number(record, "outer", where) for record in xml.findall("height")])
    order = np.argsort([number(record, "sOffset", where) for record in xml.findall("height")], kind="stable")
    steps = np.column_stack([outer[order], np.zeros((len(outer), 3))]) if len(outer) else heights.cubics
    return Lane(
        id=lane_id,
        kind=xml.get("type", "none"),
        width=Profile.from_records(xml.findall("width"), where, "sOffset", start),
        border=Profile.from_records(xml.findall("border"), where, "sOffset", start),
        height=Profile(heights.starts, steps),
        marks=tuple(xml.findall("roadMark")),
    )


def _section_knots(section: LaneSection) -> np.ndarray:
    profiles = [section.offset] + [p for lane in section.lanes.values() for p in (lane.width, lane.border)]
    places = [profile.samples(section.end, _CHORD_ERROR_M) for profile in profiles]
    return np.concatenate([[section.start, section.end], *places])
