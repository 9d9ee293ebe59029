"""The map that many drives make (room: mapping; host).

In: packed drives, a base map or none. Out: MergedMap: elements with beliefs, what changed in the course of the drives,
which drives were not trusted. A function of the set of drives: no order of arrival, no grouping changes a bit of it.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.map_shapes import kind_of
from semloc_jax.geometry import polyline
from semloc_jax.mapping.crowd.fusion import Distrusted, Fused, FusionConfig, Progress, fused
from semloc_jax.mapping.crowd.heights import heights
from semloc_jax.mapping.crowd.line_runs import lines_of
from semloc_jax.mapping.crowd.looks import directions, looks_of
from semloc_jax.mapping.crowd.presence import Looks, Presence, PresenceConfig, presence
from semloc_jax.mapping.crowd.sights import Sights, base_sights, sights_of
from semloc_jax.maps import Belief, BeliefMap, MapElement, SemanticMap
from semloc_jax.maps.curves import simplify
from semloc_jax.maps.io.packed_drive import PackedDrive
from semloc_jax.maps.versions.state import in_canonical_order

_CELL_M = 0.005
_THIN_M = 0.01
_LEAST_SIGMA_M = 0.005
_MOST_LOGIT = 6.0
_SURVEYED_M, _DRIVEN_M = 0.02, 1.5
CROWD = "crowd"
"""Provenance of what drives made together."""


@dataclass(frozen=True)
class MergeConfig:
    """How drives are merged. All values are ours.

    Args:
        fusion: where everything is.
        presence: what is still there.
        identity_m: what went and came again no farther away is one thing that moved.
        moved_m: less is no move.
    """

    fusion: FusionConfig = field(default_factory=FusionConfig)
    presence: PresenceConfig = field(default_factory=PresenceConfig)
    identity_m: float = 1.0
    moved_m: float = 0.3


@dataclass(frozen=True)
class CrowdChange:
    """One thing that changed while the drives went by.

    Attributes:
        id: of the element.
        change: added, removed or moved.
        element: as it is, or as it was.
        existence: probability that it is there now.
        moved_m: how far it moved.
        drive: name of the first drive after which more spoke for the change than against it.
        num_seen, num_missed: drives that saw it, and that would have.
    """

    id: str
    change: str
    element: MapElement
    existence: float
    moved_m: float
    drive: str
    num_seen: int
    num_missed: int


@dataclass(frozen=True)
class MergedMap:
    """The map of many drives.

    Attributes:
        beliefs: the map.
        changes: what came, went and moved.
        distrusted: drives that disagree with the others.
        detected: P_D by class, over all that was visible.
        false: P_F by class.
        fused: where everything is.
    """

    beliefs: BeliefMap
    changes: tuple[CrowdChange, ...]
    distrusted: tuple[Distrusted, ...]
    detected: dict[str, float]
    false: dict[str, float]
    fused: Fused


def merged(
    base: BeliefMap | None,
    drives: Sequence[PackedDrive],
    config: MergeConfig | None = None,
    progress: Progress = lambda items, _: items,
) -> MergedMap:
    """Merges drives into a map.

    Args:
        base: the map before any of the drives; None where there is none.
        drives: in the order of time; see `in_order`.
        config: None for the defaults.
        progress: shows how far it has come.

    Raises:
        SemlocError: no drive, or none fits any other.
    """
    config = config or MergeConfig()
    if not drives:
        raise SemlocError("merge: no drives; give files of `semloc pack`")
    origin = base.map.origin if base is not None else next((d.origin for d in drives if d.origin is not None), None)
    sights = [sights_of(drive, origin) for drive in drives]
    if base is not None and any(not e.is_logical for e in base.map.elements):
        sights.insert(0, base_sights(base, _frame_sigma(base)))
    found = fused(sights, config.fusion, progress)
    looks, station_looks, columns = looks_of(found, config.presence.days)
    there, along_lines = presence(looks, config.presence), presence(station_looks, config.presence)
    z, station_z = heights(found)
    names = [sights[k].name for k in columns]
    ids = [_id_of(sights, drives, *row) for row in found.world.source.tolist()]
    elements = _things(found, z, ids)
    elements, changes = _identified(elements, looks, there, names, config)
    known = [(elements[k], _belief(found, looks, there, k)) for k in np.flatnonzero(there.now > 0.5).tolist()]
    runs = lines_of(found.world.lines, station_z, station_looks, along_lines)
    known += [(_named(run.element, sights, drives, run.source, run.part), run.belief) for run in runs]
    known = [(_rounded(element), belief) for element, belief in known]
    if base is not None:
        known += [(e, base.beliefs[e.id]) for e in base.map.elements if e.is_logical]
    held = {e.id: (e, b) for e, b in known}
    if not held:
        raise SemlocError(f"merge: nothing stays of {len(drives)} drives; do they show the same road?")
    ordered = in_canonical_order(e for e, _ in held.values())
    name, frame = (base.map.name, base.map.frame) if base is not None else (CROWD, "")
    result = BeliefMap(SemanticMap(tuple(ordered), origin, name, frame=frame), {e.id: held[e.id][1] for e in ordered})
    rates = [_by_class(world, seen) for world, seen in ((looks, there), (station_looks, along_lines))]
    kinds = [np.unique(found.world.kind.astype(str)).tolist(), sorted({line.kind for line in found.world.lines})]
    detected = {k: d for names_, (ds, _) in zip(kinds, rates, strict=True) for k, d in zip(names_, ds, strict=False)}
    false = {k: f for names_, (_, fs) in zip(kinds, rates, strict=True) for k, f in zip(names_, fs, strict=False)}
    return MergedMap(result, tuple(changes), tuple(found.distrusted.values()), detected, false, found)


def in_order(drives: Sequence[tuple[PackedDrive, str]]) -> list[PackedDrive]:
    """Drives with the hashes of their files in the order of time: by date, by name as people count, by hash."""

    def key(item: tuple[PackedDrive, str]) -> tuple:
        drive, digest = item
        parts = [(int(p), "") if p.isdigit() else (-1, p) for p in _words(drive.name)]
        return (drive.when_s if drive.when_s is not None else 0.0, parts, digest)

    return [drive for drive, _ in sorted(drives, key=key)]


def _words(name: str) -> list[str]:
    words, digits = [""], False
    for letter in name:
        is_digit = letter in "0123456789"
        if is_digit != digits:
            words.append("")
        digits = is_digit
        words[-1] += letter
    return words


def _frame_sigma(base: BeliefMap) -> float:
    """How far a base map may be off as a whole: one that a drive made lies where its satellite fixes put it."""
    driven = any(b.num_seen > 0 and b.provenance != CROWD for b in base.beliefs.values())
    return _DRIVEN_M if driven else _SURVEYED_M


def _id_of(sights: list[Sights], drives: Sequence[PackedDrive], place: int, row: int) -> str:
    """The id of a thing: that of the base map, else made of the first drive that saw it."""
    element = sights[place].things.elements[row]
    if sights[place].is_base:
        return element.id
    return _made_id(kind_of(element), drives[place - int(sights[0].is_base)], element.id)


def _named(
    element: MapElement, sights: list[Sights], drives: Sequence[PackedDrive], place: int, part: int
) -> MapElement:
    """The part of a line with its id."""
    name = element.id
    if not sights[place].is_base:
        name = _made_id(kind_of(element), drives[place - int(sights[0].is_base)], element.id)
    return replace(element, id=f"{name}_{part}" if part else name)


def _made_id(kind: str, drive: PackedDrive, name: str) -> str:
    """A short id that tells nothing of the drive."""
    text = repr((drive.name, drive.when_s, drive.source, name))
    return f"{kind}_{hashlib.sha256(text.encode('utf-8', 'replace')).hexdigest()[:8]}"


def _things(found: Fused, z: np.ndarray, ids: list[str]) -> list[MapElement]:
    """Every thing as an element: the shape that the first drive saw, where and as large as all say."""
    world = found.world
    along, half = directions(found)
    elements = []
    for k, (place, row) in enumerate(world.source.tolist()):
        things = found.drives[place].sights.things
        element = things.elements[row]
        offset = element.points[:, :2] - things.centre[row]
        if world.half_m[k].any():
            old = np.stack([things.along[row], [-things.along[row, 1], things.along[row, 0]]])
            new = np.stack([along[k], [-along[k, 1], along[k, 0]]])
            grown = half[k] / np.maximum(things.half_m[row], 1e-3)
            grown = np.where(things.half_m[row] > 0.05, grown, 1.0)
            offset = (offset @ old.T * grown) @ new
        points = np.column_stack([world.centre[k] + offset, element.points[:, 2] - element.points[:, 2].min() + z[k]])
        elements.append(replace(element, id=ids[k], points=points, attributes={}))
    return elements


def _identified(
    elements: list[MapElement], looks: Looks, there: Presence, names: list[str], config: MergeConfig
) -> tuple[list[MapElement], list[CrowdChange]]:
    """What went and came again near by is one thing that moved: it keeps its id. And all changes."""
    was = looks.is_based | (there.then.max(axis=1, initial=0.0) > 0.8)
    gone = np.flatnonzero(was & (there.now <= 0.5))
    looked = np.where(looks.visible | looks.seen, there.then, 1.0).min(axis=1, initial=1.0)
    is_new = (looked < 0.2) | bool(looks.is_based.any())
    came = np.flatnonzero((there.now > 0.5) & is_new & ~looks.is_based)
    links: dict[int, tuple[int, float]] = {}
    middle = np.array([e.points[:, :2].mean(axis=0) for e in elements]).reshape(-1, 2)
    if len(gone) and len(came):
        apart = np.linalg.norm(middle[came][:, None] - middle[gone][None], axis=2)
        same = np.array([[kind_of(elements[a]) == kind_of(elements[b]) for b in gone] for a in came])
        apart = np.where(same, apart, np.inf)
        rows, columns = linear_sum_assignment(np.minimum(apart, config.identity_m))
        links = {int(came[i]): (int(gone[j]), float(apart[i, j])) for i, j in zip(rows, columns, strict=True)}
        links = {k: v for k, v in links.items() if v[1] < config.identity_m}
    kept = list(elements)
    for new, (old, _) in links.items():
        kept[new] = replace(elements[new], id=elements[old].id)
    linked = {old for old, _ in links.values()}
    changes = [_change(kept, looks, there, names, k, "removed", 0.0) for k in gone.tolist() if k not in linked]
    for k in came.tolist():
        old, moved_m = links.get(k, (-1, 0.0))
        if old < 0 or moved_m >= config.moved_m:
            changes.append(_change(kept, looks, there, names, k, "added" if old < 0 else "moved", moved_m))
    return kept, changes


def _change(
    elements: list[MapElement], looks: Looks, there: Presence, names: list[str], k: int, what: str, moved_m: float
) -> CrowdChange:
    then = there.then[k] > 0.5
    flips = np.flatnonzero(then[1:] != then[:-1])
    drive = names[int(flips[-1]) + 1] if len(flips) else names[-1]
    seen = looks.seen[k]
    counts = int(seen.sum()), int((looks.visible[k] & ~seen).sum())
    return CrowdChange(elements[k].id, what, elements[k], float(there.now[k]), moved_m, drive, *counts)


def _belief(found: Fused, looks: Looks, there: Presence, k: int) -> Belief:
    information = np.zeros(2)
    for drive, seen in zip(found.drives, found.seen, strict=True):
        for row in seen.pairs[seen.pairs[:, 1] == k, 0]:
            information += (drive.sights.things.sigma_m[row] * seen.factor[:2]) ** -2.0
    along_m, across_m = np.maximum(np.maximum(information, 1.0) ** -0.5, _LEAST_SIGMA_M).round(3)
    seen_by, missed_by = int(looks.seen[k].sum()), int((looks.visible[k] & ~looks.seen[k]).sum())
    return Belief(float(across_m), float(along_m), logit_of(there.now[k]), seen_by, missed_by, provenance=CROWD)


def logit_of(probability: float) -> float:
    """Log odds in steps of a half, no surer than 99.75 %."""
    p = float(np.clip(probability, 1e-6, 1.0 - 1e-6))
    return float(np.clip(np.round(2.0 * np.log(p / (1.0 - p))) / 2.0, -_MOST_LOGIT, _MOST_LOGIT))


def _rounded(element: MapElement) -> MapElement:
    """On the grid of the crowd map; widths to the centimetre, lines without vertices that say nothing."""
    points = element.points
    if not element.closed and len(points) > 2:
        points = simplify(points, _THIN_M)
    points = np.rint(points / _CELL_M) * _CELL_M
    points = np.rint(points * 1000.0) / 1000.0 + 0.0
    if not element.closed and len(points) > 1:
        steps = polyline.arc_length(points)
        points = points[np.append(True, np.diff(steps) > 0.0)] if steps[-1] > 0.0 else points
    normal = None if element.normal is None else np.round(element.normal, 3) + 0.0
    sizes = {name: round(getattr(element, name), 3) for name in ("width_m", "radius_m", "radius_top_m", "height_m")}
    return replace(element, points=points, normal=normal, **sizes)


def _by_class(looks: Looks, there: Presence) -> tuple[list[float], list[float]]:
    """P_D of each class over all that was visible, and P_F."""
    detected = []
    for kind in range(int(looks.kind.max(initial=-1)) + 1):
        own = looks.kind == kind
        weight = np.where((looks.visible | looks.seen)[own], there.then[own], 0.0)
        detected.append(float((weight * looks.seen[own]).sum() / max(weight.sum(), 1e-9)))
    return detected, there.false.tolist()
