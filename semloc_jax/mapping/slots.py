"""Parking slots out of the lines that divide them (room: mapping; host).

In: slot lines of a map, the way of the vehicle, where other vehicles stood. Out: slots: corners, type, occupancy.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from semloc_jax.geometry.umeyama import umeyama
from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.maps import Belief, MapElement
from semloc_jax.structs import ElementClass

PERPENDICULAR, PARALLEL, ANGLED = "perpendicular", "parallel", "angled"
_OPPOSITE_DEG, _OPPOSITE_M = 3.0, 0.3
"""Dividers that face each other across a back line lie on one line."""
_BACK_TO_BACK_M = (8.5, 13.0)
"""From the mouth of a slot to that of the slot behind it."""
_SAME_DEPTH_M, _SAME_BY_ENDS_M = 0.15, 0.3
"""Depths nearer than this are one: by mouths back to back, and by where dividers end, which wear and vehicles hide."""


@dataclass(frozen=True)
class SlotConfig:
    """What makes a slot. Lengths of entrances are those of AVM-SLAM, a little wider; the rest is ours.

    Args:
        entrance_m: shortest and longest entrance of a slot one drives into.
        parallel_m: the same of a slot along the aisle.
        divider_m: shortest and longest line between slots one drives into.
        parallel_divider_m: the same between slots along the aisle.
        askew_deg: dividers of one slot differ by no more.
        right_angle_deg: entrances farther from a right angle belong to angled slots.
        least_angle_deg: sharpest angle between entrance and divider.
        depth_m: shallowest and deepest slot one drives into.
        touch_m: a bar across a divider begins no farther from it.
        covered_share: share of the looks at a place that end at a vehicle from which one stands there: behind one,
            looks from other sides see the road.
        occupied_share: share of such places in the middle of a slot from which it is taken.
        assumed_depth_m: depth of a slot one drives into and of one along the aisle where nothing tells it: of single
            frames; None leaves such slots out.
    """

    entrance_m: tuple[float, float] = (2.1, 3.3)
    parallel_m: tuple[float, float] = (3.9, 6.9)
    divider_m: tuple[float, float] = (1.5, 7.5)
    parallel_divider_m: tuple[float, float] = (1.6, 3.2)
    askew_deg: float = 4.0
    right_angle_deg: float = 12.0
    least_angle_deg: float = 35.0
    depth_m: tuple[float, float] = (4.0, 6.5)
    touch_m: float = 0.25
    covered_share: float = 0.85
    occupied_share: float = 0.25
    assumed_depth_m: tuple[float, float] | None = None


@dataclass(frozen=True)
class Divider:
    """A line between slots, from its end at the aisle to its end at the back.

    Attributes:
        id: of its element.
        mouth: `float64[2]`, where it begins at the aisle [m].
        inward: unit `float64[2]` from there.
        length_m: what was seen of it, to the middle of the line at the back.
        is_whole: whether its end at the back was seen.
        z_m: height of its mouth.
    """

    id: str
    mouth: Float[np.ndarray, " 2"]
    inward: Float[np.ndarray, " 2"]
    length_m: float
    is_whole: bool
    z_m: float

    def moved_with(self, old: MapElement, new: MapElement) -> "Divider":
        """The divider where its line was moved: its mouth goes with the nearest end, which masks show."""
        before, after = old.points[:, :2], new.points[:, :2]
        turn = umeyama(after, before).R_a_b
        end = int(np.linalg.norm(before - self.mouth, axis=1).argmin())
        return replace(self, mouth=after[end] + turn @ (self.mouth - before[end]), inward=turn @ self.inward)


def find_slots(
    lines: Sequence[MapElement],
    beliefs: dict[str, Belief],
    way: Float[np.ndarray, "n 2"],
    vehicles: EvidenceGrid,
    config: SlotConfig | None = None,
    in_rows: Sequence[Divider] = (),
) -> list[tuple[MapElement, Belief]]:
    """The slots between the lines, each with the belief of the lines it is made of.

    Args:
        lines: slot lines.
        beliefs: by id.
        way: where the vehicle drove [m]: slots open to it.
        vehicles: how often other vehicles hide a place.
        config: None for the defaults.
        in_rows: dividers of rows; lines that they are named after are none besides.
    """
    config = config or SlotConfig()
    named = {divider.id for divider in in_rows}
    dividers = [*(d for d in find_dividers(lines, way, config) if d.id not in named), *in_rows]
    found = _neighbours(dividers, config)
    shared = {(kind, d.id): _shared_depth(kind, d, dividers, config) for kind, *pair in found for d in pair}
    typical = _typical_depths(found, shared, config)
    slots = []
    for kind, one, other in found:
        depth_m = _depth_of(kind, [one, other], shared, typical.get(kind), config)
        if depth_m is None and config.assumed_depth_m is not None:
            depth_m = config.assumed_depth_m[kind == PARALLEL]
        if depth_m is None:
            continue
        corners = np.array(
            [one.mouth, other.mouth, other.mouth + depth_m * other.inward, one.mouth + depth_m * one.inward]
        )
        z_m = np.array([one.z_m, other.z_m, other.z_m, one.z_m])
        words = {"kind": kind}
        taken = _taken(corners, vehicles, config.covered_share)
        if taken is not None:
            words |= {"occupied": bool(taken >= config.occupied_share)}
        name = f"slot_{len(slots)}"
        element = MapElement(
            name, ElementClass.PARKING_SLOT, np.column_stack([corners, z_m]), closed=True, attributes=words
        )
        slots.append((element, _weaker(beliefs[one.id], beliefs[other.id])))
    return slots


def split_crossbars(lines: Sequence[MapElement], config: SlotConfig | None = None) -> list[MapElement]:
    """The lines with each short bar across the mouth of a divider cut where the divider passes through it."""
    config = config or SlotConfig()
    kept: list[MapElement] = []
    for line in lines:
        pieces = _cut(line, [other for other in lines if other is not line], config)
        kept += [replace(piece, id=f"{line.id}{'' if k == 0 else f'_{k}'}") for k, piece in enumerate(pieces)]
    return kept


def find_dividers(lines: Sequence[MapElement], way: Float[np.ndarray, "n 2"], config: SlotConfig) -> list[Divider]:
    """The lines that may stand between slots, with the end that opens to the aisle first."""
    found = []
    for line in lines:
        xy = line.points[:, :2]
        length_m = float(np.linalg.norm(xy[-1] - xy[0]))
        if not config.divider_m[0] <= length_m <= config.divider_m[1]:
            continue
        away_m = [float(np.linalg.norm(way - end, axis=1).min()) for end in (xy[0], xy[-1])]
        order = slice(None) if away_m[0] <= away_m[1] else slice(None, None, -1)
        (mouth, back), ends = xy[[0, -1]][order], line.true_ends[order]
        if not ends[0]:
            continue
        z_m = float(line.points[0 if away_m[0] <= away_m[1] else -1, 2])
        inward = (back - mouth) / length_m
        # Where a line runs along the back, the divider ends at its far rim: its middle bounds the slot.
        has_back = any(_passes(other, back, inward, config) for other in lines if other is not line)
        depth_m = length_m - 0.5 * line.width_m if ends[1] and has_back else length_m
        found.append(Divider(line.id, mouth, inward, depth_m, ends[1], z_m))
    return found


def divider_groups(dividers: list[Divider], config: SlotConfig) -> list[list[Divider]]:
    """Dividers that hold slots between them, row by row; the longest row first, those of no row left out."""
    group = list(range(len(dividers)))
    for a, one in enumerate(dividers):
        for b in range(a + 1, len(dividers)):
            if group[a] != group[b] and _kind(one, dividers[b], config) is not None:
                kept, gone = group[a], group[b]
                group = [kept if name == gone else name for name in group]
    rows = [[d for d, name in zip(dividers, group, strict=True) if name == own] for own in dict.fromkeys(group)]
    return sorted((row for row in rows if len(row) > 1), key=lambda row: -len(row))


def split_double(lines: Sequence[MapElement], dividers: Sequence[Divider], config: SlotConfig) -> list[MapElement]:
    """The lines, those in two that run from aisle to aisle through two rows back to back, beside dividers of one."""
    found: list[MapElement] = []
    for line in lines:
        start, end = line.points[[0, -1], :2]
        length_m = float(np.linalg.norm(end - start))
        halves = [
            Divider(line.id, mouth, (other - mouth) / max(length_m, 1e-9), 0.5 * length_m, True, 0.0)
            for mouth, other in ((start, end), (end, start))
        ]
        is_double = _BACK_TO_BACK_M[0] <= length_m <= _BACK_TO_BACK_M[1] and any(
            _kind(half, divider, config) is not None for half in halves for divider in dividers
        )
        if not is_double:
            found.append(line)
            continue
        middle = 0.5 * (line.points[0] + line.points[-1])
        parts = np.stack([line.points[0], middle]), np.stack([middle, line.points[-1]])
        ends = (line.true_ends[0], True), (True, line.true_ends[1])
        names = line.id, f"{line.id}_back"
        found += [
            replace(line, id=name, points=points, true_ends=told)
            for name, points, told in zip(names, parts, ends, strict=True)
        ]
    return found


def _passes(line: MapElement, place: np.ndarray, inward: np.ndarray, config: SlotConfig) -> bool:
    """Whether a line passes a place across a direction."""
    start, end = line.points[[0, -1], :2]
    step = end - start
    length_m = float(np.linalg.norm(step))
    along = step / length_m
    if abs(along[0] * inward[1] - along[1] * inward[0]) < np.sin(np.deg2rad(config.least_angle_deg)):
        return False
    offset = place - start
    off_m = abs(along[0] * offset[1] - along[1] * offset[0])
    return bool(off_m < config.touch_m and -config.touch_m < offset @ along < length_m + config.touch_m)


def _neighbours(dividers: list[Divider], config: SlotConfig) -> list[tuple[str, Divider, Divider]]:
    """Pairs that hold a slot between them, with its type; of pairs that overlap the narrowest stays."""
    pairs = []
    for a, one in enumerate(dividers):
        for other in dividers[a + 1 :]:
            kind = _kind(one, other, config)
            if kind is not None:
                pairs.append((float(np.linalg.norm(other.mouth - one.mouth)), kind, one, other))
    pairs.sort(key=lambda pair: pair[0])
    taken: list[tuple[Divider, Divider]] = []
    found = []
    for _, kind, one, other in pairs:
        if any(_overlap(one, other, *pair) for pair in taken):
            continue
        taken.append((one, other))
        # The entrance runs with the slot on its left.
        step = other.mouth - one.mouth
        is_left = step[0] * one.inward[1] - step[1] * one.inward[0] > 0.0
        found.append((kind, one, other) if is_left else (kind, other, one))
    return found


def _kind(one: Divider, other: Divider, config: SlotConfig) -> str | None:
    step = other.mouth - one.mouth
    width_m = float(np.linalg.norm(step))
    if not 0.5 * config.entrance_m[0] < width_m <= config.parallel_m[1]:
        return None
    if one.inward @ other.inward < np.cos(np.deg2rad(config.askew_deg)):
        return None
    inward = one.inward + other.inward
    cosine = float(step @ inward) / (width_m * float(np.linalg.norm(inward)))
    off_deg = float(np.rad2deg(np.arcsin(min(abs(cosine), 1.0))))
    across_m = width_m * float(np.sqrt(1.0 - min(cosine**2, 1.0)))
    low, high = config.parallel_divider_m
    seen_short = all(low <= d.length_m <= high for d in (one, other))
    is_short = seen_short and one.is_whole and other.is_whole
    # What hides the end of one does not hide how long the other is.
    may_be_short = seen_short and (one.is_whole or other.is_whole)
    if off_deg <= config.right_angle_deg:
        if config.entrance_m[0] <= width_m <= config.entrance_m[1] and not is_short:
            return PERPENDICULAR
        return PARALLEL if may_be_short and config.parallel_m[0] <= width_m <= config.parallel_m[1] else None
    is_angled = off_deg <= 90.0 - config.least_angle_deg and config.entrance_m[0] <= across_m <= config.entrance_m[1]
    return ANGLED if is_angled and not is_short else None


def _overlap(one: Divider, other: Divider, third: Divider, fourth: Divider) -> bool:
    """Whether the entrances of two pairs share more than an end."""
    step = other.mouth - one.mouth
    length_m = float(np.linalg.norm(step))
    along = step / length_m
    if abs(float((third.mouth - one.mouth) @ [-along[1], along[0]])) > 0.5:
        return False
    spans = sorted(((third.mouth - one.mouth) @ along, (fourth.mouth - one.mouth) @ along))
    return bool(min(length_m, spans[1]) - max(0.0, spans[0]) > 0.3 and one.inward @ third.inward > 0.0)


_Shared = dict[tuple[str, str], float | None]
"""Half of the way to the mouth behind, by the type of a slot and the id of its divider."""


def _shared_depth(kind: str, divider: Divider, dividers: list[Divider], config: SlotConfig) -> float | None:
    """Half of the way to the mouth of the divider behind: two rows back to back share their back line."""
    if kind == PARALLEL:  # two rows of these are not as deep together as one of others
        return None
    low, high = config.depth_m
    for other in dividers:
        if divider.inward @ other.inward > -np.cos(np.deg2rad(_OPPOSITE_DEG)):
            continue
        step = other.mouth - divider.mouth
        ahead_m = float(step @ divider.inward)
        off_m = abs(float(step[0] * divider.inward[1] - step[1] * divider.inward[0]))
        if off_m < _OPPOSITE_M and low <= 0.5 * ahead_m <= high:
            return 0.5 * ahead_m
    return None


def _typical_depths(found: list[tuple[str, Divider, Divider]], shared: _Shared, config: SlotConfig) -> dict[str, float]:
    """Typical depth of the slots of each type: by the rows back to back, else by the dividers that were seen whole."""
    behind: dict[str, list[float]] = {}
    whole: dict[str, list[float]] = {}
    for kind, *pair in found:
        for divider in pair:
            if (half := shared[kind, divider.id]) is not None:
                behind.setdefault(kind, []).append(half)
            elif _is_deep(kind, divider, config):
                whole.setdefault(kind, []).append(divider.length_m)
    return {kind: float(np.median(behind.get(kind, whole.get(kind)))) for kind in {*behind, *whole}}


def _is_deep(kind: str, divider: Divider, config: SlotConfig) -> bool:
    """Whether a divider was seen to its end at a depth that slots of a type have; a gap in the paint ends it early."""
    low, high = config.parallel_divider_m if kind == PARALLEL else config.depth_m
    return divider.is_whole and low <= divider.length_m <= high


def _depth_of(
    kind: str,
    pair: list[Divider],
    shared: _Shared,
    typical_m: float | None,
    config: SlotConfig,
) -> float | None:
    """Depth of a slot: the typical one of its type, where what it shows itself is not clearly another one."""
    own = [half for divider in pair if (half := shared[kind, divider.id]) is not None]
    same_m = _SAME_DEPTH_M if own else _SAME_BY_ENDS_M
    own = own or [d.length_m for d in pair if _is_deep(kind, d, config)]
    if not own or (typical_m is not None and abs(np.mean(own) - typical_m) < same_m):
        return typical_m
    return float(np.mean(own))


def _taken(corners: Float[np.ndarray, "4 2"], vehicles: EvidenceGrid, covered_share: float) -> float | None:
    """Share of the places in the middle of a slot where a vehicle stands; None where nobody looked."""
    across, inward = np.meshgrid(np.linspace(0.25, 0.75, 8), np.linspace(0.25, 0.75, 8))
    u, v = across.ravel()[:, None], inward.ravel()[:, None]
    front = corners[0] + u * (corners[1] - corners[0])
    back = corners[3] + u * (corners[2] - corners[3])
    total, hits = vehicles.sums(front + v * (back - front), 0)
    looked = total > 0.0
    return float((hits[looked] > covered_share * total[looked]).mean()) if total.sum() > 0.5 else None


def _weaker(one: Belief, other: Belief) -> Belief:
    """What two lines say together about the slot between them: no more than the weaker one."""
    first = [b.first_seen_s for b in (one, other) if b.first_seen_s is not None]
    last = [b.last_seen_s for b in (one, other) if b.last_seen_s is not None]
    return Belief(
        max(one.sigma_across_m, other.sigma_across_m),
        max(one.sigma_along_m, other.sigma_along_m),
        min(one.existence_logit, other.existence_logit),
        min(one.num_seen, other.num_seen),
        max(one.num_missed, other.num_missed),
        max(first, default=None),
        min(last, default=None),
        one.provenance,
    )


def _cut(bar: MapElement, others: list[MapElement], config: SlotConfig) -> list[MapElement]:
    start, end = bar.points[0], bar.points[-1]
    length_m = float(np.linalg.norm((end - start)[:2]))
    if not 0.5 < length_m < config.divider_m[0]:
        return [bar]
    along = (end - start)[:2] / length_m
    for other in others:
        xy = other.points[:, :2]
        if float(np.linalg.norm(xy[-1] - xy[0])) < config.divider_m[0]:
            continue
        inward = (xy[-1] - xy[0]) / np.linalg.norm(xy[-1] - xy[0])
        sine = abs(along[0] * inward[1] - along[1] * inward[0])
        if sine < np.sin(np.deg2rad(config.least_angle_deg)):
            continue
        for tip in (xy[0], xy[-1]):
            offset = tip - start[:2]
            off_m = abs(along[0] * offset[1] - along[1] * offset[0])
            # Where the middle of the divider crosses that of the bar.
            across = offset[1] * inward[0] - offset[0] * inward[1]
            s_m = float(across / (along[1] * inward[0] - along[0] * inward[1]))
            if off_m < config.touch_m and 0.2 < s_m < length_m - 0.2:
                half = 0.5 * other.width_m / sine
                share = np.array([0.0, (s_m - half) / length_m, (s_m + half) / length_m, 1.0])
                places = start + share[:, None] * (end - start)
                return [bar.with_points(places[:2]), bar.with_points(places[2:])]
    return [bar]
