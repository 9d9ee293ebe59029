"""Rows of parking slots: perpendicular, parallel and angled, with entrance bars and numbers (room: simulation; host).

In: where a row begins and runs. Out: its map elements, and the paint of its numbers.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float

from semloc_jax.maps import MapElement
from semloc_jax.simulation.surface import Surface
from semloc_jax.structs import ElementClass

LINE_M = 0.12
"""Width of painted bars."""
_STUB_M = 0.6
"""An entrance is painted as two short bars with the way in between them."""
_NUMBER_AT_M, _LETTER_M = 0.35, (0.3, 0.52)
_LETTER_GAP_M, _STROKE_M = 0.11, 0.07
_KINDS = {"perp": np.pi / 2, "par": np.pi / 2, "ang": np.pi / 3}
"""Angle between the row and the sides of its slots."""


@dataclass(frozen=True)
class SlotRow:
    """Slots side by side along an aisle.

    Args:
        name: its letter.
        kind: `perp`, `par` or `ang`.
        corner_xy: front corner of the first slot [m].
        along_rad: direction of the row.
        side: 1 if the slots lie to the left of that direction, -1 to the right.
        count: number of slots.
        pitch_m: length of the front of a slot.
        depth_m: from front to back, square to the row.
    """

    name: str
    kind: str
    corner_xy: tuple[float, float]
    along_rad: float
    side: float
    count: int
    pitch_m: float
    depth_m: float

    def at(self, a_m: Float[np.ndarray, " n"], b_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Places `a_m` along the front and `b_m` deep, the latter along the sides of the slots."""
        lean = np.asarray(b_m) / np.tan(_KINDS[self.kind])
        along = np.array([np.cos(self.along_rad), np.sin(self.along_rad)])
        deep = self.side * np.array([-along[1], along[0]])
        return np.array(self.corner_xy) + (np.asarray(a_m) + lean)[:, None] * along + np.asarray(b_m)[:, None] * deep

    @property
    def half_line_m(self) -> float:
        """Half the width of a side line, measured along the front."""
        return 0.5 * LINE_M / float(np.sin(_KINDS[self.kind]))

    def outline(self, slot: int) -> Float[np.ndarray, "4 2"]:
        """Corners of a slot on the middles of its bars, the entrance first."""
        a = self.pitch_m * (slot + np.array([0.0, 1.0, 1.0, 0.0]))
        return self.at(a, self.depth_m * np.array([0.0, 0.0, 1.0, 1.0]))

    def slot_id(self, slot: int) -> str:
        """Name of a slot."""
        return f"{self.name}_slot{slot}"

    def heading_in(self) -> float:
        """Direction from the entrance to the back of a slot [rad]; along the row for parallel ones."""
        if self.kind == "par":
            return self.along_rad
        step = np.diff(self.at(np.zeros(2), np.array([0.0, 1.0])), axis=0)[0]
        return float(np.arctan2(step[1], step[0]))


def row_elements(row: SlotRow, surface: Surface, has_back: bool, is_numbered: bool) -> list[MapElement]:
    """Bars between slots, at the entrances and, for one row of a pair, at the back; the slots themselves."""
    half, end_m = row.half_line_m, row.count * row.pitch_m
    bars = [
        (f"{row.name}_div{k}", (k * row.pitch_m - half, k * row.pitch_m + half), (0.0, row.depth_m))
        for k in range(row.count + 1)
    ]
    stub_m = min(_STUB_M, 0.3 * row.pitch_m)
    for k in range(row.count):
        first, last = k * row.pitch_m + half, (k + 1) * row.pitch_m - half
        bars.append((f"{row.name}_ent{k}_0", (first, first + stub_m), (0.0, LINE_M)))
        bars.append((f"{row.name}_ent{k}_1", (last - stub_m, last), (0.0, LINE_M)))
    if has_back:
        bars.append(
            (f"{row.name}_back", (-half, end_m + half), (row.depth_m - 0.5 * LINE_M, row.depth_m + 0.5 * LINE_M))
        )
    elements = [_bar(row, surface, name, a, b) for name, a, b in bars]
    for k in range(row.count):
        number = {"number": slot_number(row, k)} if is_numbered else {}
        attributes = {"class": "parking_slot", "occupied": False, "kind": row.kind, "note": _NOTE, **number}
        corners = surface.drape(row.outline(k))
        label = ElementClass.PARKING_SLOT
        elements.append(MapElement(row.slot_id(k), label, corners, closed=True, attributes=attributes))
    return elements


_NOTE = "corner 0,1 = entrance; centre lines of the painted bars"


def slot_number(row: SlotRow, slot: int) -> str:
    """What is painted at a slot, e.g. B07."""
    return f"{row.name}{slot + 1:02d}"


def _bar(row: SlotRow, surface: Surface, name: str, a: tuple[float, float], b: tuple[float, float]) -> MapElement:
    a_m, b_m = np.array(a)[[0, 1, 1, 0]], np.array(b)[[0, 0, 1, 1]]
    count = max(2, round(max(np.ptp(a_m), np.ptp(b_m))) + 1)
    share = np.linspace(0.0, 1.0, count, endpoint=False)
    a_m, b_m = ((v[:, None] + (np.roll(v, -1) - v)[:, None] * share).ravel() for v in (a_m, b_m))
    attributes = {"class": "slot_line", "color": "white", "width": LINE_M}
    return MapElement(name, ElementClass.SLOT_LINE, surface.drape(row.at(a_m, b_m)), closed=True, attributes=attributes)


def number_box(row: SlotRow, slot: int) -> Float[np.ndarray, "4 2"]:
    """Corners of the field that a number is painted in, lower left first for who drives in."""
    width_m = 3 * _LETTER_M[0] + 2 * _LETTER_GAP_M
    middle = row.pitch_m * (slot + 0.5)
    a = middle + 0.5 * width_m * np.array([-1.0, 1.0, 1.0, -1.0])
    a = a if row.side > 0 else a[[1, 0, 3, 2]]
    return row.at(a, _NUMBER_AT_M + _LETTER_M[1] * np.array([0.0, 0.0, 1.0, 1.0]))


def number_paint(row: SlotRow, slot: int) -> shapely.Geometry:
    """The strokes of the number of a slot, seen from above."""
    corner, right, _, top = number_box(row, slot)
    across, up = (right - corner) / np.linalg.norm(right - corner), (top - corner) / np.linalg.norm(top - corner)
    strokes = []
    for place, letter in enumerate(slot_number(row, slot)):
        begin_m = place * (_LETTER_M[0] + _LETTER_GAP_M)
        for segment in _SEGMENTS_OF[letter]:
            ends = np.array(_SEGMENTS[segment]) * _LETTER_M + [begin_m, 0.0]
            strokes.append(shapely.LineString(corner + ends[:, :1] * across + ends[:, 1:] * up))
    inked = shapely.union_all([stroke.buffer(0.5 * _STROKE_M, cap_style="square") for stroke in strokes])
    return inked.intersection(shapely.Polygon(number_box(row, slot)))


_SEGMENTS = {
    "a": ((0, 1), (1, 1)),
    "b": ((1, 1), (1, 0.5)),
    "c": ((1, 0.5), (1, 0)),
    "d": ((0, 0), (1, 0)),
    "e": ((0, 0), (0, 0.5)),
    "f": ((0, 0.5), (0, 1)),
    "g": ((0, 0.5), (1, 0.5)),
    "m": ((0.5, 0), (0.5, 1)),
}
"""Strokes in a field of 1 x 1: those of a seven-segment display, and one down the middle."""
_SEGMENTS_OF = {
    "0": "abcdef", "1": "bc", "2": "abdeg", "3": "abcdg", "4": "bcfg", "5": "acdfg", "6": "acdefg", "7": "abc",
    "8": "abcdefg", "9": "abcdfg", "A": "abcefg", "B": "cdefg", "C": "adef", "D": "bcdeg", "E": "adefg", "F": "aefg",
    "G": "acdef", "H": "bcefg", "J": "bcde", "K": "efgm", "L": "def", "N": "abcef", "P": "abefg", "T": "am",
    "U": "bcdef", "Y": "bcdfg",
}  # fmt: skip
LETTERS = "ABCDEFGHJKLNPTUY"
"""Names of rows, in order."""
