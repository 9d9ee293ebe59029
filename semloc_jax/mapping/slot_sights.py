"""Parking slots in single frames, from masks (room: mapping; host).

In: frames, masks, poses in odom. Out: the slots that each frame shows, with what a camera knows of their corners.
The lines of one frame go through the same steps as those of a whole map: one rule of geometry for both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.mapping.looking import Gatherer, Look, Looker, RoadLookConfig
from semloc_jax.mapping.object_tracks import wrapped
from semloc_jax.mapping.slot_rows import draw_rows
from semloc_jax.mapping.slots import ANGLED, PERPENDICULAR, Divider, SlotConfig, find_slots, split_crossbars
from semloc_jax.mapping.vectorize import VectorConfig, elements_of
from semloc_jax.maps import Belief, MapElement
from semloc_jax.perception.ground_contact import SightErrors, ground_covariance
from semloc_jax.structs import ElementClass

_AHEAD_M = 7.0
_TELLING_M, _MOSTLY = 2.0, 0.85
"""How much of the lines beside a slot must be in view for a miss to count."""
_FEWEST_PLACES = 8
_FACED = 0.77
"""Cosine of the largest angle between a line of sight and the direction into a slot: 40 deg."""
_BAR_M, _AT_MOUTH_M, _BAR_SINE = (0.4, 2.0), 0.5, 0.15
"""Length of bars across the end of a divider, how near to it, and how far off a right angle."""
_EVEN_M, _UNEVEN_M, _ROW_M, _SAME_WAY = 0.06, 0.1, 2.0, 0.995
"""Entrances of a row lie on one line to the first; ends off by more than the second, and less than the third, were not
seen; slots of one row point the same way."""
_ONE_FRAME = Belief(0.1, 0.1, 0.0, num_seen=1)


@dataclass(frozen=True)
class SlotSightConfig:
    """How slots of single frames are found. Lengths are those of the road; all values are ours.

    Args:
        look: how the road is looked at: a camera sees the ground usefully to some 8 m.
        vector: how paint becomes lines; a frame is one look.
        slots: what makes a slot.
        errors: of a camera, that make the covariance of a ground point.
        window: frames whose looks are laid over each other before lines are followed, or whose marking points have to
            agree: 1 is single frames.
        window_m: way that they may span; the odometry drifts.
        is_by_rows: whether what is seen of the other slots of a row says where a divider and its mouth are.
    """

    look: RoadLookConfig = field(default_factory=lambda: RoadLookConfig(range_m=9.0))
    vector: VectorConfig = field(default_factory=lambda: VectorConfig(min_looks=1, joined_gap_m=1.0))
    slots: SlotConfig = field(default_factory=lambda: SlotConfig(assumed_depth_m=(5.0, 2.2)))
    errors: SightErrors = field(default_factory=SightErrors)
    window: int = 5
    window_m: float = 4.0
    is_by_rows: bool = True

    def __post_init__(self) -> None:
        if self.window < 1:
            raise SemlocError(f"slots: window {self.window}; expected at least 1 frame")


@dataclass(frozen=True)
class Slot:
    """One parking slot as seen in one frame.

    Attributes:
        kind: perpendicular, parallel or angled.
        pose: `float64[3]` x, y [m] of the middle of its entrance and the direction from there into it [rad].
        width_m: of the entrance.
        depth_m: from the entrance to the back.
        skew_rad: how far the entrance is from a right angle to the direction into the slot.
        occupied: whether another vehicle stands in it; None where nobody could see.
        covariance: `float64[3 3]` of the pose.
        is_faced: whether a camera looks into it: from aside the car in the next slot hides it.
        by_height: as of other sights; looks of many cameras and frames are laid over each other, so that they lean to
            no side.
    """

    kind: str
    pose: Float[np.ndarray, " 3"]
    width_m: float
    depth_m: float
    skew_rad: float
    occupied: bool | None
    covariance: Float[np.ndarray, "3 3"]
    is_faced: bool = True
    by_height: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class SlotFrame:
    """The slots of one frame in odom, and what of the road it shows."""

    slots: list[Slot]
    looks: list[Look]

    def shows_slot(self, corners: Float[np.ndarray, "2 2"], yaw_rad: float) -> bool:
        """Whether the entrance of a slot and the lines on both sides of it can be seen: what finds it.

        Args:
            corners: both ends of the entrance in odom [m].
            yaw_rad: direction into the slot.
        """
        inward = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
        places = corners[:, None] + np.linspace(0.0, _TELLING_M, 9)[:, None] * inward
        return bool((self.shows(places.reshape(-1, 2)).reshape(2, -1).mean(axis=1) >= _MOSTLY).all())

    def shows(self, xy: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Whether any camera shows places of odom and nothing stands before them."""
        seen = np.zeros(len(xy), bool)
        for look in self.looks:
            rows = look.rows_of(xy)
            seen |= (rows >= 0) & ~look.hidden[np.maximum(rows, 0)]
        return seen


class SlotObserver:
    """Finds the slots of one frame after the other."""

    def __init__(self, drive: Drive, masks: MaskSource, config: SlotSightConfig | None = None):
        self.config = config or SlotSightConfig()
        if not any(ElementClass.SLOT_LINE in channel.classes for channel in masks.table.channels):
            raise SemlocError(
                f"masks {masks.name}: class table {masks.table.name} knows no slot_line; give masks that show the "
                "lines of parking slots, or a class table with the class slot_line"
            )
        self.masks, self.looker = masks, Looker(drive, masks, self.config.look)
        rig = drive.rig.select(masks.cameras)
        self._recent: list[list[Look]] = []
        self._places = np.asarray(rig.T_base_cam, np.float64)[:, :3, 3]
        self._focal_px = np.array([float(camera.fx) for camera in rig.cameras])

    def at(self, frame: Frame, index: int, Ts_odom_base: Float[np.ndarray, "n 4 4"]) -> SlotFrame:
        """The slots of a frame.

        Args:
            frame: the frame.
            index: its place among the poses.
            Ts_odom_base: pose of every frame.
        """
        T = Ts_odom_base[index]
        looks = list(self.looker.looks(frame, index, Ts_odom_base))
        gatherer = self._gathered(index, looks, Ts_odom_base)
        lines, in_row = self._lines(gatherer, T)
        beliefs = dict.fromkeys([part.id for part in (*lines, *in_row)], _ONE_FRAME)
        found = find_slots(lines, beliefs, own_way(T), gatherer.vehicles, self.config.slots, in_row)
        elements = upright([element for element, _ in found], lines, self.config.slots)
        mouths = in_rows(elements)
        taken = [is_taken(element.points[:4, :2], gatherer.vehicles) for element in elements]
        found = zip(elements, mouths, taken, strict=True)
        return SlotFrame([self._slot(e, mouth, occupied, T) for e, mouth, occupied in found], looks)

    def _gathered(self, index: int, looks: list[Look], Ts_odom_base: Float[np.ndarray, "n 4 4"]) -> Gatherer:
        """The looks of the last frames, each at its place in odom."""
        here = Ts_odom_base[index, :2, 3]
        recent = [
            kept
            for kept in self._recent
            if np.linalg.norm(Ts_odom_base[kept[0].frame, :2, 3] - here) < self.config.window_m
        ]
        self._recent = [*recent, looks][-self.config.window :]
        gatherer = Gatherer(self.masks.table, self.config.look.spacing_m)
        for look in (look for kept in self._recent for look in kept):
            gatherer.add(look)
        return gatherer

    def _lines(self, gatherer: Gatherer, T: np.ndarray) -> tuple[list[MapElement], list[Divider]]:
        """Slot lines, and the dividers that rows of them have."""
        layers = [layer for layer in gatherer.layers if layer.label == ElementClass.SLOT_LINE]
        lines = elements_of(gatherer.paint, layers, lambda xy: np.full(len(xy), T[2, 3]), self.config.vector)
        if not self.config.is_by_rows:
            return split_crossbars(lines, self.config.slots), []
        drawn = draw_rows(lines, own_way(T), None, self.config.slots)
        kept = {line.id for line in drawn.lines}
        return split_crossbars(drawn.lines, self.config.slots), [d for row in drawn.rows for d in row.dividers(kept)]

    def _slot(self, element: MapElement, mouth: Float[np.ndarray, "2 2"], occupied: bool | None, T: np.ndarray) -> Slot:
        first, second = mouth
        step, inward = second - first, (element.points[3] - element.points[0])[:2]
        width_m, depth_m = float(np.linalg.norm(step)), float(np.linalg.norm(inward))
        yaw = np.arctan2(inward[1], inward[0])
        # The entrance runs with the slot on its left: its normal to the left points inward.
        skew = wrapped(yaw - np.arctan2(step[0], -step[1]))
        known = [self.ground_covariance(T[:2, :2].T @ (corner - T[:2, 3])) for corner in (first, second)]
        C = T[:2, :2] @ (0.5 * (known[0] + known[1])) @ T[:2, :2].T
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = C
        covariance[2, 2] = 0.25 * float(np.trace(known[0] + known[1])) / width_m**2
        pose = np.array([*(0.5 * (first + second)), yaw])
        kind = str(element.attributes["kind"])
        sight = T[:2, :2].T @ (pose[:2] - T[:2, 3]) - self._places[:, :2]
        into = T[:2, :2].T @ inward / depth_m
        is_faced = bool((sight @ into > _FACED * np.linalg.norm(sight, axis=1)).any())
        return Slot(kind, pose, width_m, depth_m, float(skew), occupied, covariance, is_faced)

    def ground_covariance(self, xy_base: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "2 2"]:
        """Covariance [m^2] of a place on the road as its nearest camera sees it."""
        offset = xy_base - self._places[:, :2]
        k = int(np.linalg.norm(offset, axis=1).argmin())
        return ground_covariance(offset[k], float(self._places[k, 2]), float(self._focal_px[k]), self.config.errors)


def own_way(T: np.ndarray) -> Float[np.ndarray, "n 2"]:
    """Where the vehicle drives, to which slots open: along its own axis, since a frame knows no more."""
    return T[:2, 3] + np.linspace(-_AHEAD_M, _AHEAD_M, 57)[:, None] * T[:2, 0] / np.linalg.norm(T[:2, 0])


def is_taken(corners: Float[np.ndarray, "4 2"], vehicles: EvidenceGrid) -> bool | None:
    """Whether most places in the middle of a slot that a camera looks at end at a vehicle; None where it sees too few.

    Places count alike, near or far: a car that stands deep in its slot leaves the better seen part of it bare.
    """
    u, v = (axis.ravel()[:, None] for axis in np.meshgrid(np.linspace(0.25, 0.75, 6), np.linspace(0.25, 0.75, 8)))
    front, back = (a + u * (b - a) for a, b in ((corners[0], corners[1]), (corners[3], corners[2])))
    total, hits = vehicles.sums(front + v * (back - front), 0)
    seen = total > 0.0
    return bool((hits[seen] > 0.5 * total[seen]).mean() > 0.5) if seen.sum() >= _FEWEST_PLACES else None


def upright(elements: Sequence[MapElement], lines: Sequence[MapElement], config: SlotConfig) -> list[MapElement]:
    """Slots that only look askew, since the end of a divider was missed, as perpendicular ones.

    Told by the bars across the ends of its dividers and by the other slots that point the same way. What would be too
    wide or too narrow then is no slot.
    """
    found = []
    for element in elements:
        corners = element.points[:4, :2]
        inward = (corners[3] - corners[0]) / np.linalg.norm(corners[3] - corners[0])
        if element.attributes["kind"] == ANGLED:
            along = (corners[1] - corners[0]) / np.linalg.norm(corners[1] - corners[0])
            votes = sum(_vote(line, corners[:2], inward, along) for line in lines)
            for other in elements:
                step = (other.points[3] - other.points[0])[:2]
                if other is not element and step @ inward > _SAME_WAY * np.linalg.norm(step):
                    votes += 0 if other.attributes["kind"] == ANGLED else 1
            if votes > 0:
                across_m = abs(float((corners[1] - corners[0]) @ [-inward[1], inward[0]]))
                if not config.entrance_m[0] <= across_m <= config.entrance_m[1]:
                    continue
                element = replace(element, attributes={**element.attributes, "kind": PERPENDICULAR})
        found.append(element)
    return found


def _vote(line: MapElement, mouth: np.ndarray, inward: np.ndarray, along: np.ndarray) -> int:
    """1 where a bar at the entrance is at a right angle to the slot, -1 where it runs along an entrance askew."""
    ends = line.points[[0, -1], :2]
    step = ends[1] - ends[0]
    length_m = float(np.linalg.norm(step))
    if not _BAR_M[0] < length_m < _BAR_M[1]:
        return 0
    places = ends[0] + np.linspace(0.0, 1.0, 9)[:, None] * step
    if np.linalg.norm(places[:, None] - mouth, axis=2).min() > _AT_MOUTH_M:
        return 0
    if abs(step @ inward) < _BAR_SINE * length_m:
        return 1
    return -1 if abs(step @ along) > _SAME_WAY * length_m else 0


def in_rows(elements: Sequence[MapElement]) -> list[Float[np.ndarray, "2 2"]]:
    """Both ends of the entrance of each slot [m], moved out to the line on which the entrances of its row lie.

    A mask misses paint at the end of a divider, it hardly ever adds any: of ends that ought to lie side by side the
    ones nearer to the aisle are right. Slots at an angle stay as they are.
    """
    mouths = [element.points[:2, :2].copy() for element in elements]
    inward = [(element.points[3] - element.points[0])[:2] for element in elements]
    inward = [step / np.linalg.norm(step) for step in inward]
    for k, element in enumerate(elements):
        if element.attributes["kind"] == ANGLED:
            continue
        same = [
            j
            for j, other in enumerate(elements)
            if other.attributes["kind"] == element.attributes["kind"]
            and inward[j] @ inward[k] > _SAME_WAY
            and abs(float((mouths[j].mean(axis=0) - mouths[k].mean(axis=0)) @ inward[k])) < _ROW_M
        ]
        ends = np.unique(np.round(np.concatenate([elements[j].points[:2, :2] for j in same]), 3), axis=0)
        deep = np.sort(ends @ inward[k])
        # The line of the row: the outermost place at which two dividers end; of two ends alone the outer one.
        steady = [d for d in deep if (np.abs(deep - d) < _EVEN_M).sum() > 1]
        line = float(np.median(deep[np.abs(deep - steady[0]) < _EVEN_M])) if steady else float(deep[0])
        for end in range(2):
            off_m = float(mouths[k][end] @ inward[k]) - line
            # An end beyond the line counts as wrong only where two others are on it.
            if _UNEVEN_M < off_m < _ROW_M or (steady and -_ROW_M < off_m < -_UNEVEN_M):
                mouths[k][end] -= off_m * inward[k]
    return mouths
