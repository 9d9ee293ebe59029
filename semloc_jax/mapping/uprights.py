"""Poles, pillars, signs and traffic lights of a map: elements, and how often each was seen (room: mapping; host).

In: Sightings, then masks and poses. Out: MapElements; Belief of each.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.mapping.existence import ExistenceConfig, existence_logit, raised
from semloc_jax.mapping.kept_counts import KeptCounts
from semloc_jax.mapping.pillars import pillar
from semloc_jax.mapping.sightings import UPRIGHT, RayTable, column
from semloc_jax.mapping.triangulation import HeightOf, Standing, TriangulationConfig, stand
from semloc_jax.maps import Belief, MapElement
from semloc_jax.perception import ClassTable
from semloc_jax.structs import ElementClass

_PLACES = 8
"""Places along the axis of each that are looked at."""
_NEAR_M, _FAR_M = 3.0, 30.0
_LEAST_PX, _LEAST_BOARD_PX = 1.5, 4.0
"""A thinner thing need not show, nor a board that is narrower as it is seen: masks lose small patches."""
_BESIDE_PX = (-1, 0, 1)
_DECOYS_M = np.array([[2.5, 0.0], [0.0, 2.5]])
"""What is seen where nothing stands tells how often masks show what is not there."""
_FILLS = ((0.62, "triangle"), (0.88, "circle"), (np.inf, "rectangle"))
"""Share of its box that a board of each shape fills, up to."""
_LEAST_SHARE = 0.65
"""Of the visible looks that must show a thing."""


@dataclass(frozen=True)
class Upright:
    """An element that stands, and how well its place is known."""

    element: MapElement
    sigma_m: float


def uprights_of(
    sightings: Float[np.ndarray, "n 13"], height_of: HeightOf, config: TriangulationConfig | None = None
) -> list[Upright]:
    """Every pole, pillar, sign and traffic light that the sightings of a drive agree on.

    Args:
        sightings: rows, see `sightings.COLUMNS`.
        height_of: height of the road.
        config: None for the defaults.
    """
    found = []
    for label in UPRIGHT:
        own = sightings[column(sightings, "label") == float(label)]
        for k, thing in enumerate(stand(own, config)):
            element = _SHAPES[label](f"{label.name.lower()}_{k}", thing, own[thing.rows], height_of)
            found.append(Upright(element, float(np.sqrt(np.linalg.eigvalsh(thing.covariance)[-1]))))
    return found


def _pole(name: str, thing: Standing, rows: np.ndarray, height_of: HeightOf) -> MapElement:
    foot_m = thing.foot_m if thing.knows_foot else min(float(height_of(thing.xy[None])[0]), thing.foot_m)
    ends = np.array([[*thing.xy, foot_m], [*thing.xy, max(thing.top_m, foot_m + 0.1)]])
    radius_m = 0.5 * thing.width_m
    return MapElement(name, ElementClass.POLE, ends, radius_m=radius_m, radius_top_m=radius_m)


def _light(name: str, thing: Standing, rows: np.ndarray, height_of: HeightOf) -> MapElement:
    ends = np.array([[*thing.xy, thing.foot_m], [*thing.xy, max(thing.top_m, thing.foot_m + 0.1)]])
    return MapElement(name, ElementClass.TRAFFIC_LIGHT, ends, width_m=thing.width_m)


def _sign(name: str, thing: Standing, rows: np.ndarray, height_of: HeightOf) -> MapElement:
    """A board that faces those who saw it, from either side; seen askew it looks narrower than it is."""
    to_camera = rows[:, 2:4] - thing.xy
    range_m = np.linalg.norm(to_camera, axis=1)
    near = range_m <= np.median(range_m)
    ray = to_camera[near] / range_m[near, None]
    # Those before it and those behind it see along one axis: their mean would face neither.
    axis = np.linalg.eigh(ray.T @ ray)[1][:, -1]
    normal = np.append(axis if axis @ ray.sum(axis=0) >= 0.0 else -axis, 0.0)
    fill = float(np.median(column(rows, "fill")[near]))
    shape = next(word for most, word in _FILLS if fill < most)
    height_m = max(thing.top_m - thing.foot_m, 0.1)
    width_m = float(np.quantile(column(rows, "width") * range_m, 0.8))
    if shape == "circle":
        width_m = height_m
    side = np.array([-normal[1], normal[0], 0.0])
    centre = np.array([*thing.xy, 0.5 * (thing.foot_m + thing.top_m)])
    points = centre + _outline(shape) * [0.5 * width_m, 0.5 * height_m] @ np.stack([side, [0.0, 0.0, 1.0]])
    return MapElement(name, ElementClass.SIGN, points, closed=True, shape=shape, normal=normal)


def _outline(shape: str) -> Float[np.ndarray, "k 2"]:
    """Corners of a board of width and height 2."""
    if shape == "circle":
        turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        return np.stack([np.cos(turn), np.sin(turn)], axis=1)
    corners = {"triangle": [[-1, -1], [1, -1], [0, 1]], "rectangle": [[-1, -1], [1, -1], [1, 1], [-1, 1]]}
    return np.array(corners[shape], dtype=np.float64)


_SHAPES = {
    ElementClass.POLE: _pole,
    ElementClass.SIGN: _sign,
    ElementClass.TRAFFIC_LIGHT: _light,
    ElementClass.PILLAR: pillar,
}


class UprightCounting(KeptCounts):
    """Counts looks at what stands over a drive."""

    COUNTED = ("num_seen", "num_missed", "first_s", "last_s")

    def __init__(self, uprights: Sequence[Upright], table: ClassTable, config: ExistenceConfig | None = None):
        self.uprights = uprights
        self.config = config or ExistenceConfig()
        places = np.array([_axis(upright.element) for upright in uprights]).reshape(-1, _PLACES, 3)
        decoys = [places + np.append(by, 0.0) for by in _DECOYS_M]
        self._places = np.concatenate([places, *decoys])
        widths = [_width_m(upright.element) for upright in uprights]
        self._width_m = np.tile(widths, 1 + len(decoys))
        normals = [np.zeros(2) if u.element.normal is None else u.element.normal[:2] for u in uprights]
        self._normal = np.tile(np.array(normals).reshape(-1, 2), (1 + len(decoys), 1))
        self._least_px = np.where(self._normal.any(axis=1), _LEAST_BOARD_PX, _LEAST_PX)
        labels = np.array([int(upright.element.label) for upright in uprights], dtype=np.int64)
        self._label = np.tile(labels, 1 + len(decoys))
        own, hides = np.zeros((2, len(ElementClass), 256), bool)
        for label in UPRIGHT:
            channel = table.channel_of(label)
            if channel >= 0:
                own[label, list(table.channels[channel].mask_ids)] = True
        hides[:, list(table.unusable_ids)] = True
        hides |= own.any(axis=0) & ~own
        self._own, self._hides = own, hides
        n = len(self._places)
        self.num_seen, self.num_missed = np.zeros(n, int), np.zeros(n, int)
        self.first_s, self.last_s = np.full(n, np.inf), np.full(n, -np.inf)

    def add(
        self,
        masks: Sequence[UInt8[np.ndarray, "h w"]],
        tables: Sequence[RayTable],
        T_map_base: Float[np.ndarray, "4 4"],
        time_s: float,
    ) -> None:
        """Counts one frame.

        Args:
            masks: of every camera.
            tables: of their cameras.
            T_map_base: pose of the vehicle.
            time_s: when.
        """
        away_m = np.linalg.norm(self._places[:, 0, :2] - T_map_base[:2, 3], axis=1)
        near = np.flatnonzero((away_m > _NEAR_M) & (away_m < _FAR_M))
        if not len(near):
            return
        p_base = (self._places[near] - T_map_base[:3, 3]) @ T_map_base[:3, :3]
        shown, hits = np.zeros(len(near)), np.zeros(len(near))
        for mask, table in zip(masks, tables, strict=True):
            thick = self._width_rad(near, T_map_base, away_m[near]) >= self._least_px[near] * table.px_rad
            visible, is_hit = self._look(mask, table, p_base, self._label[near])
            shown += visible.sum(axis=1) * thick
            hits += (visible & is_hit).sum(axis=1) * thick
        enough = shown >= 0.5 * _PLACES
        share = np.divide(hits, shown, out=np.zeros(len(near)), where=shown > 0)
        seen = near[enough & (share >= self.config.seen_share)]
        self.num_seen[seen] += 1
        self.num_missed[near[enough & (share <= self.config.missed_share)]] += 1
        self.first_s[seen] = np.minimum(self.first_s[seen], time_s)
        self.last_s[seen] = np.maximum(self.last_s[seen], time_s)

    def _width_rad(self, near: np.ndarray, T_map_base: np.ndarray, away_m: np.ndarray) -> np.ndarray:
        """How wide things look [rad]: a board from aside is narrow."""
        is_board = self._normal[near].any(axis=1)
        ray = (self._places[near, 0, :2] - T_map_base[:2, 3]) / away_m[:, None]
        facing = np.abs(np.einsum("ij,ij->i", self._normal[near], ray))
        return self._width_m[near] * np.where(is_board, facing, 1.0) / away_m

    def _look(
        self, mask: np.ndarray, table: RayTable, p_base: np.ndarray, label: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of every place, whether the mask shows what is there, and whether that is the thing."""
        T = table.T_base_cam
        # As many as a power of two: a camera is compiled anew for every number of points.
        room = np.zeros((max(1 << (len(p_base) - 1).bit_length(), 64), *p_base.shape[1:]))
        room[: len(p_base)] = (p_base - T[:3, 3]) @ T[:3, :3]
        uv, valid = (np.asarray(part) for part in table.camera.project(room))
        valid = (valid & np.asarray(table.camera.in_image(uv[..., 0], uv[..., 1], 2.0)))[: len(p_base)]
        uv = uv[: len(p_base)]
        column_px, row_px = np.rint(np.where(valid[..., None], uv, 0.0)).astype(np.int64).transpose(2, 0, 1)
        ids = np.stack([mask[row_px, np.clip(column_px + by, 0, mask.shape[1] - 1)] for by in _BESIDE_PX])
        is_own = self._own[label[:, None], ids].any(axis=0)
        return valid & (is_own | ~self._hides[label[:, None], ids[len(_BESIDE_PX) // 2]]), is_own

    def detection_rates(self) -> dict[ElementClass, float]:
        """Share of the visible looks at things that stay and were seen five times which show them, by class."""
        n = len(self.uprights)
        sure = (self.num_seen[:n] >= 5) & self.stays()
        return {label: self._rate(np.flatnonzero(sure & (self._label[:n] == label))) for label in self._labels()}

    def false_rates(self) -> dict[ElementClass, float]:
        """Share of the visible looks at places beside things that show one, by class."""
        n = len(self.uprights)
        beside = np.arange(len(self._label)) >= n
        return {label: self._rate(np.flatnonzero(beside & (self._label == label))) for label in self._labels()}

    def _labels(self) -> list[ElementClass]:
        return [label for label in UPRIGHT if (self._label == label).any()]

    def _rate(self, rows: np.ndarray) -> float:
        # One look of either kind is taken for granted: few looks prove neither 0 nor 1.
        return float((self.num_seen[rows].sum() + 1) / ((self.num_seen + self.num_missed)[rows].sum() + 2))

    def stays(self) -> Bool[np.ndarray, " n"]:
        """Whether each thing was seen nearly as often as such things are: a crossing of bearings to others is not."""
        n = len(self.uprights)
        share = self.num_seen[:n] / np.maximum((self.num_seen + self.num_missed)[:n], 1)
        return share >= _LEAST_SHARE

    def beliefs(self, provenance: str, priors: Sequence[float] | None = None) -> list[Belief]:
        """The belief in each thing.

        Args:
            provenance: name of the drive.
            priors: log odds of each before the drive; None for those of something that nobody knew.
        """
        detected, false, found = self.detection_rates(), self.false_rates(), []
        for k, upright in enumerate(self.uprights):
            label = upright.element.label
            seen, missed = int(self.num_seen[k]), int(self.num_missed[k])
            logit = existence_logit(seen, missed, detected[label], false[label], self.config)
            logit = logit if priors is None else raised(logit, priors[k], self.config)
            sigma_m = float(np.hypot(upright.sigma_m, self.config.floor_m))
            times = (float(self.first_s[k]), float(self.last_s[k])) if seen else (None, None)
            found.append(Belief(sigma_m, sigma_m, logit, seen, missed, *times, provenance))
        return found


def _axis(element: MapElement) -> Float[np.ndarray, "k 3"]:
    """Places on the axis of a thing [m]: of a pole above what stands around its foot."""
    if element.label == ElementClass.PILLAR:
        low = element.points.mean(axis=0)
        high = low + [0.0, 0.0, element.height_m]
    elif element.closed:
        middle, top = element.points.mean(axis=0), element.points[:, 2].max()
        low = middle - [0.0, 0.0, 0.7 * (top - middle[2])]
        high = 2.0 * middle - low
    else:
        low, high = element.points[[0, -1]]
    part = (np.arange(_PLACES) + 0.5) / _PLACES
    return low + part[:, None] * (high - low)


def _width_m(element: MapElement) -> float:
    if element.label == ElementClass.POLE:
        return 2.0 * element.radius_m
    if element.label == ElementClass.PILLAR:
        return float(np.linalg.norm(np.diff(element.points[:3, :2], axis=0), axis=1).min())
    return element.width_m if not element.closed else float(np.ptp(element.points[:, 2]))
