"""The map that many drives make (room: mapping; host).

In: packed drives, a base map or none. Out: MergedMap: elements with beliefs, what changed in the course of the drives,
which drives were not trusted. A function of the set of drives: no order of arrival, no grouping changes a bit of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.mapping.crowd.changes import ChangeConfig, CrowdChange, identified
from semloc_jax.mapping.crowd.elements import beliefs_of, id_of, rounded, things_of
from semloc_jax.mapping.crowd.exclusion import one_in_each_place
from semloc_jax.mapping.crowd.fusion import Distrusted, Fused, FusionConfig, Progress, fused
from semloc_jax.mapping.crowd.heights import heights
from semloc_jax.mapping.crowd.line_runs import LineRun, lines_of
from semloc_jax.mapping.crowd.looks import looks_of
from semloc_jax.mapping.crowd.looks_chain import Looks, PresenceConfig
from semloc_jax.mapping.crowd.presence import Presence, presence
from semloc_jax.mapping.crowd.shapes import are_placed
from semloc_jax.mapping.crowd.sights import CROWD, Base, Sights, base_sights, sights_of
from semloc_jax.mapping.way_sigmas import WaySigmas
from semloc_jax.maps import Belief, BeliefMap, GeoOrigin, MapElement, SemanticMap
from semloc_jax.maps.io.packed_drive import PackedDrive
from semloc_jax.maps.versions.state import in_canonical_order

Known = tuple[MapElement, Belief]


@dataclass(frozen=True)
class MergeConfig:
    """How drives are merged.

    Args:
        fusion: where everything is.
        presence: what is still there.
        changes: what counts as a change.
        block: so many drives of a cell are solved together; what they make is the base of those after them.
    """

    fusion: FusionConfig = field(default_factory=FusionConfig)
    presence: PresenceConfig = field(default_factory=PresenceConfig)
    changes: ChangeConfig = field(default_factory=ChangeConfig)
    block: int = 32


@dataclass(frozen=True)
class Rate:
    """How well drives show a class.

    Attributes:
        shown, visible: looks at things that are there, those that showed them, and all; weighted by existence.
        false: P_F.
    """

    shown: float
    visible: float
    false: float

    @property
    def detected(self) -> float:
        """P_D over all that was visible."""
        return self.shown / max(self.visible, 1e-9)

    def __add__(self, after: "Rate") -> "Rate":
        return Rate(self.shown + after.shown, self.visible + after.visible, after.false)


@dataclass(frozen=True)
class MergedMap:
    """The map of many drives.

    Attributes:
        beliefs: the map.
        changes: what came, went and moved.
        distrusted: drives that disagree with the others.
        rates: how well drives show what is there, by class.
        fused: where everything is.
    """

    beliefs: BeliefMap
    changes: tuple[CrowdChange, ...]
    distrusted: tuple[Distrusted, ...]
    rates: dict[str, Rate]
    fused: Fused

    @property
    def detected(self) -> dict[str, float]:
        """P_D by class."""
        return {kind: rate.detected for kind, rate in self.rates.items()}


@dataclass(frozen=True)
class MergedSights:
    """What drives in one frame make together; see `MergedMap`.

    Attributes:
        known: elements and how sure they are.
        changes, distrusted, rates, fused: see `MergedMap`.
    """

    known: tuple[Known, ...]
    changes: tuple[CrowdChange, ...]
    distrusted: tuple[Distrusted, ...]
    rates: dict[str, Rate]
    fused: Fused


def merged(
    base: BeliefMap | None,
    drives: Sequence[PackedDrive],
    config: MergeConfig | None = None,
    progress: Progress = lambda items, _: items,
) -> MergedMap:
    """Merges drives of one place into a map, all in one solve.

    Args:
        base: the map before any of the drives; None where there is none.
        drives: in the order of time; see `in_order`.
        config: None for the defaults.
        progress: shows how far it has come.

    Raises:
        SemlocError: no drive, none fits any other, or nothing stays of them.
    """
    if not drives:
        raise SemlocError("merge: no drives; give files of `semloc pack`")
    origin = origin_of(base, drives)
    sights = [sights_of(drive, origin) for drive in drives]
    if base is not None and has_things(base):
        sights.insert(0, base_sights(Base.of(base)))
    result = merged_sights(sights, config or MergeConfig(), progress)
    known = list(result.known)
    if base is not None:
        known += [(e, base.beliefs[e.id]) for e in base.map.elements if e.is_logical]
    if not known:
        raise SemlocError(f"merge: nothing stays of {len(drives)} drives; do they show the same road?")
    beliefs = map_of(known, base, origin)
    return MergedMap(beliefs, result.changes, result.distrusted, result.rates, result.fused)


def merged_sights(
    sights: Sequence[Sights], config: MergeConfig, progress: Progress = lambda items, _: items
) -> MergedSights:
    """What drives in one frame saw, a base map first where there is one, as elements with beliefs.

    Raises:
        SemlocError: none fits any other.
    """
    found = fused(list(sights), config.fusion, progress)
    looks, station_looks, columns = looks_of(found, config.presence)
    there, along_lines = presence(looks, config.presence), presence(station_looks, config.presence)
    placed = are_placed(found)
    there = one_in_each_place(found.world, looks, there, config.presence, placed)
    there = replace(there, stays=there.stays & placed, was=there.was & placed)
    z, station_z = heights(found)
    names = [sights[k].name for k in columns]
    elements, changes = identified(things_of(found, z), looks, there, names, config.changes)
    beliefs = beliefs_of(found, looks, there)
    known = [(elements[k], beliefs[k]) for k in np.flatnonzero(there.stays).tolist()]
    known += [
        (_named(run, sights[run.source]), run.belief) for run in lines_of(found, station_z, station_looks, along_lines)
    ]
    known = known if found.is_surveyed else _with_shared(known, found.sigmas)
    kinds = np.unique(found.world.kind.astype(str)).tolist(), sorted({line.kind for line in found.world.lines})
    rates = _rates(kinds[0], looks, there) | _rates(kinds[1], station_looks, along_lines)
    return MergedSights(tuple(known), tuple(changes), tuple(found.distrusted.values()), rates, found)


def _with_shared(known: Sequence[Known], sigmas: WaySigmas) -> list[Known]:
    """With what all around each element shares: drives made all of it."""
    middles = np.array([e.points[:, :2].mean(axis=0) for e, _ in known]).reshape(-1, 2)
    place_m, turn_rad = sigmas.around(middles)
    shared = zip(place_m.round(3).tolist(), turn_rad.round(5).tolist(), strict=True)
    return [
        (e, replace(b, sigma_place_m=of_place, sigma_turn_rad=of_turn))
        for (e, b), (of_place, of_turn) in zip(known, shared, strict=True)
    ]


def summed_rates(first: Mapping[str, Rate], after: Mapping[str, Rate]) -> dict[str, Rate]:
    """Rates over the looks of both."""
    none = Rate(0.0, 0.0, 0.0)
    return {k: first.get(k, none) + after.get(k, none) if k in after else first[k] for k in sorted({*first, *after})}


def map_of(known: Sequence[Known], base: BeliefMap | None, origin: GeoOrigin | None) -> BeliefMap:
    """The map of elements and their beliefs, in the canonical order."""
    held = {e.id: (e, b) for e, b in known}
    ordered = in_canonical_order(e for e, _ in held.values())
    name, frame = (base.map.name, base.map.frame) if base is not None else (CROWD, "")
    return BeliefMap(SemanticMap(tuple(ordered), origin, name, frame=frame), {e.id: held[e.id][1] for e in ordered})


def origin_of(base: BeliefMap | None, drives: Sequence[PackedDrive]) -> GeoOrigin | None:
    """Place of the map on the earth: that of the base, else of the first drive that knows its own."""
    if base is not None:
        return base.map.origin
    return next((d.origin for d in drives if d.origin is not None), None)


def has_things(beliefs: BeliefMap) -> bool:
    """Whether a map holds anything that drives could see."""
    return any(not e.is_logical for e in beliefs.map.elements)


def _named(run: LineRun, sights: Sights) -> MapElement:
    """The part of a line with its id."""
    if run.is_surveyed:
        return run.element
    name = id_of(sights, run.element)
    return rounded(replace(run.element, id=f"{name}_{run.part}" if run.part else name))


def _rates(kinds: Sequence[str], looks: Looks, there: Presence) -> dict[str, Rate]:
    """How well drives show what is there, by class."""
    found = {}
    for row, kind in enumerate(kinds):
        own = looks.kind == row
        weight = np.where((looks.visible | looks.seen)[own], there.then[own], 0.0)
        found[kind] = Rate(float((weight * looks.seen[own]).sum()), float(weight.sum()), float(there.false[row]))
    return found
