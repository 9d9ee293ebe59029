"""How often each element was seen and missed, and what that says about it (room: mapping; host).

In: elements, the looks of a drive. Out: Belief of each: existence from visible misses, covariance from the cameras.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from semloc_jax.geometry import polyline
from semloc_jax.mapping.kept_counts import KeptCounts
from semloc_jax.mapping.looking import Look
from semloc_jax.maps import Belief, MapElement
from semloc_jax.structs import ElementClass

_SCALES_PX_PER_M = (12.0, 18.0, 30.0)
"""Between them looks show elements about equally often; ours."""
_LEAST_LOOKS = 20
"""From so few the rate of a scale is not told."""
_LINE_STEP_M = 0.25
_AREA_STEP_M = 0.15
_MOST_LOGIT = 15.0


@dataclass(frozen=True)
class ExistenceConfig:
    """When a look says something about an element, and how sure a border in a mask is. All values are ours.

    Args:
        min_px_per_m: looks at coarser scale, across a line or along the line of sight on an area, say nothing.
        min_places: places of an element that must be visible, or all of a smaller one's half.
        seen_share: share of the visible places with its paint from which it counts as seen.
        missed_share: share up to which it counts as missed.
        prior_logit: existence before anything was seen.
        row_logit: the same of a line where a row of slots has one.
        most_per_look: no look says more: the looks of one pass repeat their mistakes.
        border_px: standard deviation of a border in a mask.
        pitch_deg: of the camera against the road.
        height_m: of the road against its plane.
        floor_m: no element is better known than this.
    """

    min_px_per_m: float = 8.0
    min_places: int = 6
    seen_share: float = 0.5
    missed_share: float = 0.2
    prior_logit: float = -2.0
    row_logit: float = 0.0
    most_per_look: float = 1.5
    border_px: float = 1.5
    pitch_deg: float = 0.3
    height_m: float = 0.05
    floor_m: float = 0.005


class Counting(KeptCounts):
    """Counts looks at elements over a drive."""

    COUNTED = ("num_seen", "num_missed", "seen_at", "missed_at", "first_s", "last_s", "information")

    def __init__(
        self,
        elements: Sequence[MapElement],
        planes_of: dict[ElementClass, tuple[int, ...]],
        plane_of_id: np.ndarray,
        config: ExistenceConfig | None = None,
        off_m: Sequence[float] | None = None,
    ):
        """Nothing is counted yet.

        Args:
            elements: what is looked at.
            planes_of: planes of each class.
            plane_of_id: plane of each mask id.
            config: None for the defaults.
            off_m: how far to either side of each element its paint may lie [m]: one of another map is not where this
                drive would draw it; None for nowhere but there.
        """
        self.elements = elements
        self.config = config or ExistenceConfig()
        self._plane_of_id = plane_of_id
        places = [_places(element) for element in elements]
        normals = [_normals(element, p) for element, p in zip(elements, places, strict=True)]
        sides = [_across(element) * off for element, off in zip(elements, off_m or [0.0] * len(elements), strict=True)]
        self._xy = np.concatenate([np.zeros((0, 2)), *places])
        self._normal = np.concatenate([np.zeros((0, 2)), *normals])
        self._owner = np.repeat(np.arange(len(elements)), [len(p) for p in places])
        self._side = np.array(sides).reshape(-1, 2)
        self._num_places = np.bincount(self._owner, minlength=len(elements))
        self._tree = cKDTree(self._xy) if len(self._xy) else None
        self._wanted = np.zeros((len(elements), int(plane_of_id.max()) + 2), dtype=bool)
        for k, element in enumerate(elements):
            self._wanted[k, list(planes_of[element.label])] = True
        n = len(elements)
        self.num_seen, self.num_missed = np.zeros(n, int), np.zeros(n, int)
        scales = len(_SCALES_PX_PER_M) + 1
        self.seen_at, self.missed_at = np.zeros((n, scales), int), np.zeros((n, scales), int)
        self.first_s, self.last_s = np.full(n, np.inf), np.full(n, -np.inf)
        self.information = np.zeros((n, 2, 2))

    def add(self, looks: Sequence[Look], time_s: float) -> None:
        """Counts one frame.

        Args:
            looks: one of each camera.
            time_s: when.
        """
        if self._tree is None or not looks:
            return
        n = len(self.elements)
        near = np.array(self._tree.query_ball_point(looks[0].T_map_base[:2, 3], 20.0), dtype=np.int64)
        if not len(near):
            return
        shown, hits, scale = np.zeros(n), np.zeros(n), np.zeros(n)
        gained = np.zeros((n, 2, 2))
        for look in looks:
            row = look.rows_of(self._xy[near])
            usable = row >= 0
            usable[usable] = ~look.hidden[row[usable]]
            row, places = row[usable], near[usable]
            px_per_m = self._px_per_m(look, row, places)
            fine = px_per_m >= self.config.min_px_per_m
            if not fine.any():
                continue
            row, places = row[fine], places[fine]
            owner = self._owner[places]
            shown += np.bincount(owner, minlength=n)
            scale += np.bincount(owner, px_per_m[fine], minlength=n)
            is_hit = self._wanted[owner, self._plane_of_id[look.ids[row]]] | self._beside(look, places, owner)
            hits += np.bincount(owner, is_hit, minlength=n)
            gained += self._gained(look, row, places, owner)
        enough = shown >= np.minimum(self.config.min_places, 0.5 * self._num_places)
        enough &= shown > 0
        share = np.divide(hits, shown, out=np.zeros(n), where=shown > 0)
        seen = enough & (share >= self.config.seen_share)
        missed = enough & (share <= self.config.missed_share)
        self.num_seen += seen
        self.num_missed += missed
        at = np.digitize(scale / np.maximum(shown, 1.0), _SCALES_PX_PER_M)
        self.seen_at[np.arange(n), at] += seen
        self.missed_at[np.arange(n), at] += missed
        self.first_s[seen] = np.minimum(self.first_s[seen], time_s)
        self.last_s[seen] = np.maximum(self.last_s[seen], time_s)
        self.information[seen] += gained[seen]

    def _px_per_m(self, look: Look, row: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Pixels for a metre across the line at each place: one that runs along the line of sight is seen from afar."""
        coarse, fine = look.table.coarse_px_per_m[row], look.table.fine_px_per_m[row]
        camera = look.T_map_base[:2, :2] @ look.table.camera_base[:2] + look.T_map_base[:2, 3]
        ray = self._xy[places] - camera
        ray = ray / np.maximum(np.linalg.norm(ray, axis=1), 1e-6)[:, None]
        normal = self._normal[places]
        ahead = (normal * ray).sum(axis=1)
        aside = normal[:, 1] * ray[:, 0] - normal[:, 0] * ray[:, 1]
        return np.where(normal.any(axis=1), np.hypot(coarse * ahead, fine * aside), coarse)

    def _beside(self, look: Look, places: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """Whether paint of an element is beside its places, where it may be."""
        found = np.zeros(len(places), bool)
        loose = np.flatnonzero(self._side[owner].any(axis=1))
        for sign in (1.0, -1.0) if len(loose) else ():
            row = look.rows_of(self._xy[places[loose]] + sign * self._side[owner[loose]])
            found[loose] |= (row >= 0) & self._wanted[owner[loose], self._plane_of_id[look.ids[np.maximum(row, 0)]]]
        return found

    def _gained(self, look: Look, row: np.ndarray, places: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """What one look tells about the place of each element, `[n 2 2]` [1/m^2]: less along the line of sight."""
        n, c = len(self.elements), self.config
        count = np.maximum(np.bincount(owner, minlength=n), 1)
        camera = look.T_map_base[:2, :2] @ look.table.camera_base[:2] + look.T_map_base[:2, 3]
        offset = self._xy[places] - camera
        mean = np.stack([np.bincount(owner, offset[:, k], n) for k in (0, 1)], axis=1) / count[:, None]
        coarse = np.bincount(owner, look.table.coarse_px_per_m[row], n) / count
        fine = np.bincount(owner, look.table.fine_px_per_m[row], n) / count
        d_m = np.maximum(np.linalg.norm(mean, axis=1), 1e-3)
        z_m = float(look.table.camera_base[2])
        tilt = (d_m**2 + z_m**2) / z_m * np.deg2rad(c.pitch_deg)
        along = (c.border_px / np.maximum(coarse, 1e-3)) ** 2 + tilt**2 + (d_m / z_m * c.height_m) ** 2
        across = (c.border_px / np.maximum(fine, 1e-3)) ** 2 + (d_m * np.deg2rad(c.pitch_deg)) ** 2
        ray = mean / d_m[:, None]
        side = np.stack([-ray[:, 1], ray[:, 0]], axis=1)
        both = ray[:, :, None] * ray[:, None] / along[:, None, None]
        both = both + side[:, :, None] * side[:, None] / across[:, None, None]
        return both * (np.bincount(owner, minlength=n) > 0)[:, None, None]

    def detection_rates(self) -> dict[ElementClass, float]:
        """Share of the visible looks at elements that were seen five times at least which show them, by class."""
        # One look of either kind is taken for granted: few looks prove neither 0 nor 1.
        return {label: (seen.sum() + 1) / ((seen + missed).sum() + 2) for label, (seen, missed) in self._looks.items()}

    def _rates_by_scale(self) -> dict[ElementClass, Float[np.ndarray, " s"]]:
        """The same at each scale: what is a pixel wide is shown less often."""
        whole, found = self.detection_rates(), {}
        for label, (seen, missed) in self._looks.items():
            looks = seen + missed
            found[label] = np.where(looks >= _LEAST_LOOKS, (seen + 1) / (looks + 2), whole[label])
        return found

    @property
    def _looks(self) -> dict[ElementClass, tuple[np.ndarray, np.ndarray]]:
        """Looks that showed elements seen five times at least, and looks that did not, by class and scale."""
        labels = np.array([int(element.label) for element in self.elements])
        sure, found = self.num_seen >= 5, {}
        for label in sorted({element.label for element in self.elements}):
            own = (labels == int(label)) & sure
            found[label] = self.seen_at[own].sum(axis=0), self.missed_at[own].sum(axis=0)
        return found

    def beliefs(
        self,
        false_rates: dict[ElementClass, float],
        provenance: str,
        priors: Sequence[float] | None = None,
    ) -> list[Belief]:
        """The belief in each element.

        Args:
            false_rates: share of the looks at bare road that show paint of a class.
            provenance: name of the drive.
            priors: log odds of each before the drive; None for those of something that nobody knew.
        """
        detected, found = self._rates_by_scale(), []
        for k, element in enumerate(self.elements):
            rates = detected[element.label], false_rates.get(element.label, 0.01)
            logit = existence_logit(self.seen_at[k], self.missed_at[k], *rates, self.config)
            logit = logit if priors is None else raised(logit, priors[k], self.config)
            across_m, along_m = self._sigmas(k, element)
            is_seen = np.isfinite(self.first_s[k])
            found.append(
                Belief(
                    across_m,
                    along_m,
                    logit,
                    int(self.num_seen[k]),
                    int(self.num_missed[k]),
                    float(self.first_s[k]) if is_seen else None,
                    float(self.last_s[k]) if is_seen else None,
                    provenance,
                )
            )
        return found

    def _sigmas(self, k: int, element: MapElement) -> tuple[float, float]:
        """Standard deviation across and along an element [m]."""
        xy = element.points[:, :2]
        edges = np.diff(np.vstack([xy, xy[:1]]) if element.closed else xy, axis=0)
        along = edges[np.linalg.norm(edges, axis=1).argmax()] if element.closed else xy[-1] - xy[0]
        along = along / max(float(np.linalg.norm(along)), 1e-9)
        # One metre where nothing was seen: such an element does not stay.
        covariance = np.linalg.inv(self.information[k] + np.eye(2))
        across = np.array([-along[1], along[0]])
        floor = self.config.floor_m
        return float(np.hypot(np.sqrt(across @ covariance @ across), floor)), float(
            np.hypot(np.sqrt(along @ covariance @ along), floor)
        )


def existence_logit(
    num_seen: Int[np.ndarray, " *s"] | int,
    num_missed: Int[np.ndarray, " *s"] | int,
    detection_rate: Float[np.ndarray, " *s"] | float,
    false_rate: float,
    config: ExistenceConfig,
) -> float:
    """Log odds that something is there.

    Args:
        num_seen: visible looks that showed it, at each scale.
        num_missed: visible looks that did not.
        detection_rate: share of the looks at such things that show them.
        false_rate: share of the looks at nothing that show one.
        config: what one look may say.
    """
    p_d = np.clip(detection_rate, 0.05, 0.99)
    p_f = np.clip(false_rate, 1e-3, 0.5 * p_d)
    gained = num_seen * np.minimum(np.log(p_d / p_f), config.most_per_look)
    lost = num_missed * np.maximum(np.log((1.0 - p_d) / (1.0 - p_f)), -config.most_per_look)
    return float(np.clip(config.prior_logit + np.sum(gained + lost), -_MOST_LOGIT, _MOST_LOGIT))


def raised(logit: float, prior: float, config: ExistenceConfig) -> float:
    """Log odds after looks at something that was known with other log odds before."""
    return float(np.clip(logit - config.prior_logit + prior, -_MOST_LOGIT, _MOST_LOGIT))


def _across(element: MapElement) -> Float[np.ndarray, " 2"]:
    """Unit direction across an open element; zero for an area, which is wide."""
    if element.closed:
        return np.zeros(2)
    step = element.points[-1, :2] - element.points[0, :2]
    return np.array([-step[1], step[0]]) / max(float(np.linalg.norm(step)), 1e-9)


def _places(element: MapElement) -> Float[np.ndarray, "k 2"]:
    """Places inside the paint of an element [m]."""
    xy = element.points[:, :2]
    if not element.closed:
        length_m = float(polyline.arc_length(xy)[-1])
        num = max(round(length_m / _LINE_STEP_M), 3)
        return polyline.interpolate(xy, (np.arange(num) + 0.5) * length_m / num)
    low, high = xy.min(axis=0), xy.max(axis=0)
    axes = [np.arange(low[k] + 0.5 * _AREA_STEP_M, high[k], _AREA_STEP_M) for k in (0, 1)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    inside = grid[_inside(grid, xy)]
    return inside if len(inside) else xy.mean(axis=0)[None]


def _normals(element: MapElement, places: np.ndarray) -> Float[np.ndarray, "k 2"]:
    """Unit direction across an open element at each of its places; zero for an area."""
    if element.closed:
        return np.zeros((len(places), 2))
    xy = element.points[:, :2]
    length_m = float(polyline.arc_length(xy)[-1])
    along = polyline.tangent(xy, (np.arange(len(places)) + 0.5) * length_m / len(places))
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def _inside(points: np.ndarray, ring: np.ndarray) -> np.ndarray:
    """Whether points lie inside a ring: an odd number of its edges is crossed on the way to the east."""
    start, end = ring, np.roll(ring, -1, axis=0)
    y = points[:, 1:2]
    spans = (start[:, 1] > y) != (end[:, 1] > y)
    rise = np.where(np.abs(end[:, 1] - start[:, 1]) > 1e-12, end[:, 1] - start[:, 1], 1.0)
    x = start[:, 0] + (y - start[:, 1]) / rise * (end[:, 0] - start[:, 0])
    return (spans & (points[:, 0:1] < x)).sum(axis=1) % 2 == 1
