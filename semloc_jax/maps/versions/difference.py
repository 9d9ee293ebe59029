"""What makes one version of a map out of another: removed, modified and added elements (room: maps; host).

In: two MapStates. Out: MapDifference; applied to the first it gives the second with every bit, and to no other map.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.versions.records import POINTS, Record, element_of, is_column
from semloc_jax.maps.versions.state import DATUM, MapState, datum_of, in_canonical_order, state_of

CANONICAL = "canonical"


@dataclass(frozen=True)
class MapDifference:
    """A step from one version to another.

    Attributes:
        base: digest of the version it belongs on.
        base_version: its number.
        target: digest of the version it leads to.
        members: what the file of the target states besides its elements.
        removed: ids.
        modified: changed columns of elements as they were published, by id, in the order of the base.
        added: columns of new elements, by id, in the order of the target.
        order: place of each element of the target in the order that comes by itself: those of the base, then the added
            ones; None where it is that order, `CANONICAL` where it is that of `in_canonical_order`.
        note: what made the step, for people.
    """

    base: str
    base_version: int
    target: str
    members: dict[str, Any]
    removed: tuple[str, ...]
    modified: dict[str, Record]
    added: dict[str, Record]
    order: tuple[int, ...] | str | None = None
    note: str = ""

    @property
    def version(self) -> int:
        """Number of the version it leads to."""
        return int(self.members["map_version"])

    @property
    def counts(self) -> str:
        """How much changes, in words."""
        return f"{len(self.added)} added, {len(self.modified)} modified, {len(self.removed)} removed"

    def moved(self) -> list[str]:
        """Ids of elements whose points are others now."""
        return [name for name, columns in self.modified.items() if POINTS in columns]


def difference(base: MapState, target: MapState, note: str = "") -> MapDifference:
    """The step from one version to another; an element is known by its id."""
    old, new = base.records, target.records
    removed = tuple(name for name in old if name not in new)
    modified = {}
    for name, record in old.items():
        if name in new and (columns := changed_columns(record, new[name])):
            modified[name] = columns
    added = {name: record for name, record in new.items() if name not in old}
    natural = [*(name for name in old if name in new), *added]
    place = {name: k for k, name in enumerate(natural)}
    order = None if natural == list(new) else tuple(place[name] for name in new)
    if order is not None and list(new) == [e.id for e in in_canonical_order(target.map.elements)]:
        order = CANONICAL
    return MapDifference(
        base.digest, base.version, target.digest, target.members, removed, modified, added, order, note
    )


def applied(base: MapState, step: MapDifference) -> MapState:
    """The version that a step leads to.

    Raises:
        SemlocError: the step belongs on another version, or what comes out is not what it promises.
    """
    if step.base != base.digest:
        raise SemlocError(
            f"map {base.map.name}: version {base.version} ({base.digest[:12]}), and the difference is for version "
            f"{step.base_version} ({step.base[:12]}); apply it to that one"
        )
    gone = set(step.removed)
    if not gone.union(step.modified) <= base.records.keys() or not base.records.keys().isdisjoint(step.added):
        raise SemlocError(f"difference to version {step.version}: names elements that are not there; get it again")
    names = [name for name in base.records if name not in gone]
    datum = datum_of(step.members.get(DATUM))
    elements = {e.id: e for e in base.map.elements} if datum == base.datum else {}
    for name in names if datum != base.datum else step.modified:
        record = {**base.records[name], **step.modified.get(name, {})}
        elements[name] = element_of(name, {key: v for key, v in record.items() if is_column(key, record)}, datum)
    for name, record in step.added.items():
        elements[name] = element_of(name, record, datum)
    found = state_of(_ordered([elements[name] for name in (*names, *step.added)], step.order), step.members)
    if found.digest != step.target:
        raise SemlocError(
            f"difference to version {step.version}: gives {found.digest[:12]} but states {step.target[:12]}; "
            "get it again"
        )
    return found


def changed_columns(old: Mapping[str, Any], new: Mapping[str, Any]) -> Record:
    """Columns of a record that the other lacks or has otherwise."""
    return {key: value for key, value in new.items() if key not in old or not _same(old[key], value)}


def _same(one: Any, other: Any) -> bool:
    """Whether a file would keep both alike: 1 and 1.0 differ, 0.0 and -0.0 too."""
    return type(one) is type(other) and repr(one) == repr(other)


def _ordered(elements: Sequence[MapElement], order: Sequence[int] | str | None) -> Sequence[MapElement]:
    if order is None:
        return elements
    if isinstance(order, str):
        return in_canonical_order(elements)
    if sorted(order) != list(range(len(elements))):
        raise SemlocError("difference: its order names elements twice or not at all; get it again")
    return [elements[k] for k in order]
