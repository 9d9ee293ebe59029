"""A map from a drive: look, gather, draw lines, count, keep what is there, lay it (room: mapping; host).

In: a drive, its masks, poses of its frames. Out: MadeMap: a BeliefMap and what was looked at.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import polyline
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.alike_marks import painted_alike
from semloc_jax.mapping.base_map import BaseConfig, Change, Countable, Known, aged_logit, taken_in
from semloc_jax.mapping.curb_edges import FOOT_M, LooksAt, edges_of
from semloc_jax.mapping.drive_looks import DriveLooks, step_between_m
from semloc_jax.mapping.evidence_grid import TILE
from semloc_jax.mapping.existence import Counting, ExistenceConfig
from semloc_jax.mapping.joint import RefineConfig
from semloc_jax.mapping.looking import Gatherer, Looker, RoadLookConfig
from semloc_jax.mapping.parts import Parts
from semloc_jax.mapping.road_profile import RoadProfile
from semloc_jax.mapping.row_bars import with_bars
from semloc_jax.mapping.row_lines import PaintAt
from semloc_jax.mapping.settling import Progress, SettleConfig, settled_in
from semloc_jax.mapping.short_dashes import SPOT_OFF_M
from semloc_jax.mapping.slot_numbers import numbered, outside_of_rows
from semloc_jax.mapping.slot_rows import MappedRow, draw_rows
from semloc_jax.mapping.slots import SlotConfig, find_slots, split_crossbars
from semloc_jax.mapping.triangulation import TriangulationConfig
from semloc_jax.mapping.twins import without_twins
from semloc_jax.mapping.uprights import HeightOf, Upright, UprightCounting, uprights_of
from semloc_jax.mapping.vectorize import VectorConfig, elements_of
from semloc_jax.mapping.worn_paint import pieces_joined, rows_completed
from semloc_jax.maps import Belief, BeliefMap, MapElement, SemanticMap
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.structs import ElementClass

_BARE_SHARE = 0.2
"""Cells with a smaller share of paint are bare road."""


@dataclass(frozen=True)
class MapConfig:
    """How a map is made. All values are ours.

    Args:
        look: how the road is looked at.
        vector: what becomes an element.
        existence: what counts as seen and missed.
        slots: what makes a slot.
        triangulation: what makes a pole, a sign or a traffic light.
        base: how a map that is there already takes the drive in.
        refine: how the way is made to agree with the map.
        settle: how elements are laid where the masks have them.
        uprights: whether these are looked for.
        min_seen: frames that must have seen an element.
    """

    look: RoadLookConfig = field(default_factory=RoadLookConfig)
    vector: VectorConfig = field(default_factory=VectorConfig)
    existence: ExistenceConfig = field(default_factory=ExistenceConfig)
    slots: SlotConfig = field(default_factory=SlotConfig)
    triangulation: TriangulationConfig = field(default_factory=TriangulationConfig)
    base: BaseConfig = field(default_factory=BaseConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    settle: SettleConfig = field(default_factory=SettleConfig)
    uprights: bool = True
    min_seen: int = 3


@dataclass(frozen=True)
class MadeMap:
    """A map that a drive made.

    Attributes:
        belief_map: elements with their beliefs.
        rejected: elements that were born and did not stay, with their beliefs.
        detection_rates: share of visible looks that show an element, by class.
        false_rates: share of looks at bare road that show paint, by class.
        gatherer: what was looked at.
        changes: what the drive removed from a base map and added to it.
    """

    belief_map: BeliefMap
    rejected: BeliefMap
    detection_rates: dict[ElementClass, float]
    false_rates: dict[ElementClass, float]
    gatherer: Gatherer
    changes: tuple[Change, ...] = ()

    def seen(self, xy_map: Float[np.ndarray, "n 2"], num_looks: int) -> Bool[np.ndarray, " n"]:
        """Whether places of the map [m] were looked at in at least so many frames."""
        return self.gatherer.paint.seen(xy_map, num_looks)


def make_map(
    drive: Drive,
    masks: MaskSource,
    frames: Sequence[Frame],
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    config: MapConfig | None = None,
    origin: GeoOrigin | None = None,
    progress: Progress = lambda items, _: items,
    looker: Looker | None = None,
    parts: Parts | None = None,
    base: BeliefMap | None = None,
) -> MadeMap:
    """Make a map along given poses.

    Args:
        drive: the drive.
        masks: what its cameras see.
        frames: in time order.
        Ts_map_base: pose of each frame; z of the base frame is 0 on the road.
        config: None for the defaults.
        origin: place of the map frame on the earth, where known.
        progress: shows how far it has come.
        looker: that of the drive with `config.look`, where several maps are made; None makes it.
        parts: where what is finished leaves memory; those of a run that was killed are taken in. None keeps all.
        base: map that is there already, in the frame of the poses: the drive updates its beliefs and adds to it.

    Raises:
        SemlocError: no frames, poses that are not finite, masks without paint, or nothing that stays.
    """
    config = config or MapConfig()
    _check_poses(drive, frames, Ts_map_base)
    looker = looker or Looker(drive, masks, config.look, step_between_m(Ts_map_base))
    gatherer = Gatherer(masks.table, config.look.spacing_m)
    looks = DriveLooks(looker, frames, Ts_map_base, progress, parts)
    looks.gather(gatherer, config.uprights)
    born = _born(gatherer, Ts_map_base, config, looks.profile)
    planes = {layer.label: layer.planes for layer in gatherer.layers}
    old = Countable.of(base, Ts_map_base[:, :2, 3], planes, config.uprights)
    off_m = [_off_m(e, config) for e in born.paint] + [config.base.off_m] * len(old.paint)
    counting = Counting([*born.shown, *old.paint], planes, gatherer.layer_of_id, config.existence, off_m)
    standing = UprightCounting([*born.uprights, *old.uprights], masks.table, config.existence)
    looks.count(counting, standing)
    told = _all_told((counting, standing), born, base, config, _false_rates(gatherer), drive.name)
    if not any(told.stays) and not told.looked_at:
        raise SemlocError(
            f"drive {drive.name}: none of {len(told.stays)} candidates was seen in {config.min_seen} frames; check "
            f"that masks '{masks.name}' show paint near the vehicle and that the cameras are where the calibration says"
        )
    kept = [known for known, stay in zip(told.new, told.stays, strict=True) if stay]
    rejected = [known for known, stay in zip(told.new, told.stays, strict=True) if not stay]
    laid = settled_in([e for e, _ in kept], masks, frames, Ts_map_base, config.settle, progress)
    kept = _with_slots(kept, laid, born.rows, Ts_map_base, gatherer, config)
    made, changes = _map_of(kept, origin, drive.name), []
    if base is not None:
        made, changes = taken_in(base, told.looked_at, kept, config.base)
    rates = counting.detection_rates() | standing.detection_rates()
    rejected_map = _map_of(rejected, origin, drive.name)
    return MadeMap(made, rejected_map, rates, told.false_rates, gatherer, tuple(changes))


def _check_poses(drive: Drive, frames: Sequence[Frame], Ts_map_base: np.ndarray) -> None:
    if not len(frames) or len(frames) != len(Ts_map_base) or not np.isfinite(Ts_map_base).all():
        raise SemlocError(
            f"drive {drive.name}: {len(frames)} frames and {len(Ts_map_base)} poses; expected at least one frame and a "
            "finite pose for each"
        )


class _AllTold(NamedTuple):
    """What a drive says of all elements together: of its own, which of these stay, and of those of a base map."""

    new: list[Known]
    stays: list[bool]
    looked_at: dict[str, Belief]
    false_rates: dict[ElementClass, float]


def _all_told(
    counted: tuple[Counting, UprightCounting],
    born: "_Born",
    base: BeliefMap | None,
    config: MapConfig,
    false_rates: dict[ElementClass, float],
    name: str,
) -> _AllTold:
    in_row = {own for row in born.rows for place in row.places for own in place.ids}
    (counting, standing), existence = counted, config.existence
    priors = [existence.row_logit if e.id in in_row else existence.prior_logit for e in born.paint]
    elements = [*born.paint, *counting.elements[len(born.paint) :]]
    flat = _told(elements, priors, counting.beliefs, base, config, false_rates, name)
    priors = [existence.prior_logit] * len(born.uprights)
    upright = _told([u.element for u in standing.uprights], priors, standing.beliefs, base, config, name)
    stays = [_stays(b, config) for _, b in flat.new]
    stays += [often and _stays(b, config) for (_, b), often in zip(upright.new, standing.stays(), strict=False)]
    false_rates = false_rates | standing.false_rates()
    return _AllTold(flat.new + upright.new, stays, flat.old | upright.old, false_rates)


def _with_slots(
    kept: list[Known],
    laid: Sequence[MapElement],
    rows: Sequence[MappedRow],
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    gatherer: Gatherer,
    config: MapConfig,
) -> list[Known]:
    """What stays where it was laid, once each, with the slots between its lines and the numbers in them."""
    drawn = {e.id: e for e, _ in kept}
    kept = without_twins([(e, b) for e, (_, b) in zip(laid, kept, strict=True)])
    lines = {e.id: e for e, _ in kept if e.label == ElementClass.SLOT_LINE}
    in_rows = [d.moved_with(drawn[d.id], lines[d.id]) for row in rows for d in row.dividers(set(lines))]
    beliefs = {e.id: b for e, b in kept}
    slots = find_slots(list(lines.values()), beliefs, Ts_map_base[:, :2, 3], gatherer.vehicles, config.slots, in_rows)
    marks = [known for known in kept if known[0].label == ElementClass.ROAD_MARK]
    marks, numbers = numbered(marks, slots, _looks_at(gatherer, ElementClass.ROAD_MARK))
    marks = outside_of_rows(marks, rows)
    whole = painted_alike([mark for mark, _ in marks])
    marks = [(mark, belief) for mark, (_, belief) in zip(whole, marks, strict=True)] + numbers
    return [known for known in kept if known[0].label != ElementClass.ROAD_MARK] + marks + slots


class _Born(NamedTuple):
    """What may be on the road and beside it."""

    paint: list[MapElement]
    shown: list[MapElement]
    """What masks can show of each: of a worn bar that its row has completed, what is left."""
    uprights: list[Upright]
    rows: list[MappedRow]


def _born(gatherer: Gatherer, Ts_map_base: np.ndarray, config: MapConfig, profile: RoadProfile | None) -> _Born:
    height_of: HeightOf = road_height(Ts_map_base, profile)
    uprights = uprights_of(gatherer.sightings.all(), height_of, config.triangulation)
    pieces = pieces_joined(elements_of(gatherer.paint, gatherer.layers, height_of, config.vector))
    elements = rows_completed(pieces)
    lines = [element for element in elements if element.label == ElementClass.SLOT_LINE]
    curbs = [element for element in elements if element.label == ElementClass.CURB]
    others = [element for element in elements if element.label not in (ElementClass.SLOT_LINE, ElementClass.CURB)]
    others += edges_of(curbs, Ts_map_base[:, :2, 3], _looks_at_curbs(gatherer, config.vector.min_looks))
    paint_at = _looks_at(gatherer, ElementClass.SLOT_LINE)
    drawn = with_bars(draw_rows(lines, Ts_map_base[:, :2, 3], paint_at if lines else None, config.slots), paint_at)
    paint = others + split_crossbars(drawn.lines, config.slots)
    left = {piece.id: piece for piece in pieces if piece.label == ElementClass.CROSSWALK}
    return _Born(paint, [left.get(element.id, element) for element in paint], uprights, drawn.rows)


def _looks_at(gatherer: Gatherer, label: ElementClass) -> PaintAt | None:
    """Weight of all looks at places, and of those that show a class; None where masks do not show it."""
    planes = [plane for layer in gatherer.layers if layer.label == label for plane in layer.planes]

    def paint_at(xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = [gatherer.paint.sums(xy, plane) for plane in planes]
        return found[0][0], sum(hits for _, hits in found)

    return paint_at if planes else None


def _looks_at_curbs(gatherer: Gatherer, min_looks: int) -> LooksAt:
    planes = [plane for layer in gatherer.layers if layer.label == ElementClass.CURB for plane in layer.planes]

    def looks_at(xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        found = [gatherer.paint.sums(xy, plane) for plane in planes]
        return found[0][0], sum(shows for _, shows in found), gatherer.paint.seen(xy, min_looks)

    return looks_at


def _off_m(element: MapElement, config: MapConfig) -> float:
    """How far beside an element of this drive looks show it [m]."""
    if element.label == ElementClass.CURB:  # it is at its edge: half of the looks show the road there
        return FOOT_M
    is_spot = element.style == "dashed" and polyline.arc_length(element.points)[-1] < config.vector.shortest_line_m
    return SPOT_OFF_M if is_spot else 0.0


class _Told(NamedTuple):
    """What a drive says of elements: of its own, and of those that a base map holds, by id."""

    new: list[Known]
    old: dict[str, Belief]


def _told(
    elements: Sequence[MapElement],
    priors: Sequence[float],
    beliefs_of: Callable[..., list[Belief]],
    base: BeliefMap | None,
    config: MapConfig,
    *words: dict[ElementClass, float] | str,
) -> _Told:
    """The beliefs of a counting: the first elements are new, with these log odds; the others those of the base map."""
    num_new = len(priors)
    aged = [aged_logit(base.beliefs[e.id].existence_logit, config.base.survival) for e in elements[num_new:]]
    beliefs = beliefs_of(*words, [*priors, *aged])
    known = list(zip(elements, beliefs, strict=True))
    return _Told(known[:num_new], {e.id: b for e, b in known[num_new:] if b.num_seen + b.num_missed})


def _stays(belief: Belief, config: MapConfig) -> bool:
    return belief.existence_logit > 0.0 and belief.num_seen >= config.min_seen


def _map_of(known: Sequence[Known], origin: GeoOrigin | None, name: str) -> BeliefMap:
    return BeliefMap(SemanticMap(tuple(e for e, _ in known), origin, name), {e.id: b for e, b in known})


def road_height(
    Ts_map_base: Float[np.ndarray, "n 4 4"], profile: RoadProfile | None = None
) -> Callable[[Float[np.ndarray, "n 2"]], np.ndarray]:
    """Height of the road [m] at places of the map: that of the plane of the vehicle when it was nearest.

    Args:
        Ts_map_base: poses of the vehicle.
        profile: by how much the road beside each of them is higher than its plane; None where it is not.
    """
    tree = cKDTree(Ts_map_base[:, :2, 3])

    def height_of(xy_map: Float[np.ndarray, "n 2"]) -> np.ndarray:
        # The mean of a few neighbours takes the sway of the springs out.
        k = min(9, len(Ts_map_base))
        rows = tree.query(xy_map, k=[*range(1, k + 1)])[1]
        T = Ts_map_base[rows]
        normal = T[..., :3, 2]
        offset = xy_map[:, None] - T[..., :2, 3]
        height_m = (T[..., 2, 3] - (normal[..., :2] * offset).sum(axis=-1) / normal[..., 2]).mean(axis=1)
        if profile is None:
            return height_m
        return height_m + profile.at(rows[:, 0], (offset[:, 0] * T[:, 0, :2, 1]).sum(axis=1))

    return height_of


def _false_rates(gatherer: Gatherer) -> dict[ElementClass, float]:
    """Share of the looks at bare road that show paint of each class."""
    shown, looked = dict.fromkeys(gatherer.layers, 0.0), dict.fromkeys(gatherer.layers, 0.0)
    size = np.full(2, TILE)
    for tile in gatherer.paint.tiles:
        weight = gatherer.paint.plane(0, tile * TILE, size)
        for layer in gatherer.layers:
            shows = sum(gatherer.paint.plane(2 + plane, tile * TILE, size) for plane in layer.planes)
            bare = (weight > 0) & (shows < _BARE_SHARE * weight)
            shown[layer] += float(shows[bare].sum(dtype=np.float64))
            looked[layer] += float(weight[bare].sum(dtype=np.float64))
    return {layer.label: shown[layer] / max(looked[layer], 1e-9) for layer in gatherer.layers}
