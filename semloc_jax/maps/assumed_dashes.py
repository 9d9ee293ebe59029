"""Dashes whose places nobody wrote down (room: maps; host).

In: elements of a map. Out: the same elements, in which bars that only a reader laid out are one line without ends.
A format that says "broken" and no more tells where the sides of a line are, not where its bars begin: bars laid out at
some phase would hold a vehicle along the road, half a period off and sure of it.
"""

from collections.abc import Sequence

import numpy as np

from semloc_jax.maps.elements import MapElement

DASHES = "dashes"
"""What an element says in its attribute `assumed` where its bars are a reader's."""
_LONGEST_GAP_M = 30.0
"""A wider gap is no gap between the bars of one line: something else lies between them."""


def has_assumed_dashes(element: MapElement) -> bool:
    """Returns whether the place of the bar along its line is a reader's guess."""
    return DASHES in element.attributes.get("assumed", ())


def joined_dashes(elements: Sequence[MapElement]) -> list[MapElement]:
    """Returns the elements with neighbouring assumed bars of one line joined; all others stay as they are.

    A joined line has the name and the sizes of its first bar, and no true ends.

    Args:
        elements: bars of a line follow one another and are named LINE_0, LINE_1 ..., as the readers have them.
    """
    found: list[MapElement] = []
    line: list[MapElement] = []
    for element in elements:
        if line and not _goes_on(line[-1], element):
            found.append(_joined(line))
            line = []
        if has_assumed_dashes(element):
            line.append(element)
        else:
            found.append(element)
    return found + ([_joined(line)] if line else [])


def _goes_on(bar: MapElement, element: MapElement) -> bool:
    """Returns whether an element is the next bar of the line that a bar belongs to, or a part of the same bar."""
    if not has_assumed_dashes(element) or element.label != bar.label:
        return False
    is_same_line = element.id.rpartition("_")[0] == bar.id.rpartition("_")[0]
    return is_same_line and float(np.linalg.norm(element.points[0, :2] - bar.points[-1, :2])) < _LONGEST_GAP_M


def _joined(bars: Sequence[MapElement]) -> MapElement:
    return bars[0].with_points(np.vstack([bar.points for bar in bars]), (False, False))
