"""Tracks of images as landmarks of a window: which times saw them, directions and depths (room: fusion; host).

In: Tracks of one time after another. Out: Views and values of the landmarks of a solve.
Rows are fixed: a row holds one track. What a prior has used is not used again: the track goes on as a new landmark.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from semloc_jax.fusion.inertial_sights import Views
from semloc_jax.perception.sight_lines import tangents
from semloc_jax.perception.tracks import Tracks

_LEAST_INVERSE_DEPTH, _MOST_INVERSE_DEPTH = 1e-3, 2.0
_FIRST_INVERSE_DEPTH = 0.05
_ROUNDS = 3
_LEAST_LIFT_M = 0.3
"""A camera nearer to the origin of the base is given against an inertial sensor: nothing says where the road is."""
_FLATTEST = 0.02
"""Sine of the angle below the horizon of the flattest line of sight that meets the road somewhere known."""


@dataclass(frozen=True)
class RoadBeliefs:
    """How flat a road is, and how still a vehicle sits over it. All values are ours."""

    sigma_m: float = 0.03
    """Of the height of one point of the road; 0: nothing is known of the road."""
    bend_per_m: float = 6e-4
    """Of how a road bends up or down, one over its radius: dips and crests, which all points share."""
    bend_length_m: float = 20.0
    """Way over which the bend becomes another one."""
    rough_per_m: float = 1e-4
    """Of the height so far away besides, as a share of the squared distance: crowns, kerbs, slopes that begin."""
    crown: float = 0.05
    """Of how the slope across the road changes at its crown, which a vehicle drives beside: twice a common slope."""
    lane_m: float = 1.5
    """To the side of the vehicle up to which the road is as under it."""
    heave_m: float = 0.013
    """Of the height of the vehicle on its springs, which all points of one time share."""
    tilt_deg: float = 0.2
    """Of pitch and roll of the vehicle on its springs, which all points of one time share."""
    reach_m: float = 15.0
    """Points farther away say nothing."""


@dataclass
class LandmarkPool:
    """Observations of so many tracks at so many times."""

    num_rows: int
    num_states: int
    id: Int[np.ndarray, " p"] = field(init=False)
    camera: Int[np.ndarray, " p"] = field(init=False)
    ray_cam: Float[np.ndarray, "p f 3"] = field(init=False)
    pixels: Float[np.ndarray, "p f 2 3"] = field(init=False)
    seen: Bool[np.ndarray, "p f"] = field(init=False)
    value: Float[np.ndarray, "p 3"] = field(init=False)
    is_solved: Bool[np.ndarray, " p"] = field(init=False)
    on_road: Bool[np.ndarray, " p"] = field(init=False)
    refused: set[int] = field(default_factory=set)
    """Tracks that do not fit; they are never taken again."""

    def __post_init__(self) -> None:
        p, f = self.num_rows, self.num_states
        self.id, self.camera = np.full(p, -1), np.zeros(p, int)
        self.ray_cam, self.pixels = np.tile([0.0, 0.0, 1.0], (p, f, 1)), np.zeros((p, f, 2, 3))
        self.seen, self.value = np.zeros((p, f), bool), np.zeros((p, 3))
        self.is_solved, self.on_road = np.zeros(p, bool), np.zeros(p, bool)

    def add(self, tracks: Tracks, state: int) -> None:
        """What is seen at the time of one state."""
        slots = np.array([s for s in np.flatnonzero(tracks.id >= 0) if int(tracks.id[s]) not in self.refused], int)
        # A track that the prior has just used up holds its row, though nothing is seen there yet.
        order = np.argsort(self.id, kind="stable")
        row = order[np.minimum(np.searchsorted(self.id, tracks.id[slots], sorter=order), self.num_rows - 1)]
        is_new = self.id[row] != tracks.id[slots]
        free = self._free_rows()
        free = free[~np.isin(free, row[~is_new])]
        new, fits = np.flatnonzero(is_new), np.ones(len(slots), bool)
        row[new[: len(free)]], fits[new[len(free) :]] = free[: len(new)], False
        slots, row, is_new = slots[fits], row[fits], is_new[fits]
        begun, by = row[is_new], slots[is_new]
        self.id[begun], self.camera[begun], self.on_road[begun] = tracks.id[by], tracks.camera[by], tracks.on_road[by]
        self.seen[begun], self.is_solved[begun] = False, False
        self.ray_cam[row, state], self.pixels[row, state] = tracks.sight.ray_cam[slots], tracks.sight.pixels[slots]
        self.seen[row, state] = True

    def slide(self, used: Bool[np.ndarray, " p"], num_gone: int) -> None:
        """Some times later: the oldest leave.

        Args:
            used: Landmarks that the prior has taken in, with all that was seen of them.
            num_gone: How many times leave.
        """
        oldest = self.seen[:, :num_gone].any(axis=1)
        self.seen[used] = False
        for name in ("ray_cam", "pixels", "seen"):
            array = getattr(self, name)
            array[:, :-num_gone] = array[:, num_gone:].copy()
        self.seen[:, -num_gone:] = False
        # The first to see a landmark has left: it begins anew at the next that saw it.
        self.is_solved[oldest | used] = False

    def anchors(self) -> Int[np.ndarray, " p"]:
        """The first state that sees each landmark."""
        return np.argmax(self.seen, axis=1)

    def first(self, num_states: int) -> "LandmarkPool":
        """The pool of the first states alone."""
        pool = LandmarkPool(self.num_rows, num_states)
        for name in ("id", "camera", "value", "is_solved", "on_road", "refused"):
            setattr(pool, name, getattr(self, name))
        for name in ("ray_cam", "pixels", "seen"):
            setattr(pool, name, getattr(self, name)[:, :num_states].copy())
        return pool

    def chosen(self, num: int, min_views: int) -> Int[np.ndarray, " k"]:
        """Rows of at most `num` landmarks with so many views; those with most views."""
        views = self.seen.sum(axis=1)
        order = np.argsort(-views, kind="stable")
        return order[views[order] >= min_views][:num]

    def prepare(
        self,
        rows: Int[np.ndarray, " k"],
        Ts_map_base: Float[np.ndarray, "f 4 4"],
        T_base_cam: Float[np.ndarray, "f c 4 4"],
    ) -> None:
        """Directions and depths of landmarks that no solve has found yet, from their views at the given poses."""
        rows = rows[~self.is_solved[rows]]
        if not len(rows):
            return
        T_map_cam = Ts_map_base[:, None] @ T_base_cam
        anchor, camera, every = self.anchors()[rows], self.camera[rows], np.arange(len(rows))
        Ts = T_map_cam[:, camera].swapaxes(0, 1)
        T_anchor = Ts[every, anchor]
        ray = self.ray_cam[rows, anchor]
        R_cam_map = np.swapaxes(Ts[..., :3, :3], -1, -2)
        far = (R_cam_map @ (T_anchor[:, :3, :3] @ ray[..., None])[:, None])[..., 0]
        near = (R_cam_map @ (T_anchor[:, None, :3, 3] - Ts[..., :3, 3])[..., None])[..., 0]
        far_px, near_px = ((self.pixels[rows] @ q[..., None])[..., 0] for q in (far, near))
        rho = np.full(len(rows), _FIRST_INVERSE_DEPTH)
        for _ in range(_ROUNDS):
            along = np.sum(self.ray_cam[rows] * (far + rho[:, None, None] * near), axis=2)
            weight = self.seen[rows] / np.maximum(along, 0.1) ** 2
            bend = np.sum(weight * np.sum(near_px**2, axis=2), axis=1)
            pull = np.sum(weight * np.sum(near_px * far_px, axis=2), axis=1)
            # A prior of 1 per metre around the first guess holds points without parallax.
            rho = (_FIRST_INVERSE_DEPTH - pull) / (bend + 1.0)
            rho = np.clip(rho, _LEAST_INVERSE_DEPTH, _MOST_INVERSE_DEPTH)
        self.value[rows] = np.column_stack([np.zeros((len(rows), 2)), rho])

    def views(
        self,
        rows: Int[np.ndarray, " k"],
        num: int,
        sigma_px: tuple[float, float],
        T_base_cam: Float[np.ndarray, "f c 4 4"],
        road: RoadBeliefs,
    ) -> tuple[Views, Float[np.ndarray, "l 3"]]:
        """The landmarks of the rows and their values, padded to `num`.

        Args:
            rows: Of the pool.
            num: Landmarks of the views.
            sigma_px: Standard deviations of a corner where it is found, and of what it slips to the next image.
            T_base_cam: Of every time and camera.
            road: What is known of the height of landmarks on the road.
        """
        pad = num - len(rows)
        at = np.concatenate([rows, np.zeros(pad, int)])
        is_real = np.arange(num) < len(rows)
        anchor = self.anchors()[at]
        z = self.ray_cam[at, anchor]
        first, second = np.swapaxes(tangents(z), 0, 1)
        is_first = np.arange(self.num_states) == anchor[:, None]
        sigma = np.where(is_first, *sigma_px)
        axes, T_anchor = np.stack([first, second, z], axis=-1), T_base_cam[anchor, self.camera[at]]
        up, lift_m = np.einsum("li,lij->lj", T_anchor[:, 2, :3], axes), T_anchor[:, 2, 3]
        away_m = _away(up[:, 2], lift_m)
        aside_m = T_anchor[:, 1, 3] + _depth(up[:, 2], lift_m) * np.einsum("li,li->l", T_anchor[:, 1, :3], z)
        return Views(
            anchor=anchor,
            camera=self.camera[at],
            axes=axes,
            ray_cam=self.ray_cam[at],
            pixels=self.pixels[at],
            sqrt_info=np.where(is_real[:, None] & _without_gap(self.seen[at]), 1.0 / sigma, 0.0),
            T_base_cam=T_base_cam,
            up=up,
            lift_m=lift_m,
            away_m=away_m,
            on_road=_road_weights(up[:, 2], lift_m, (away_m, aside_m), anchor, is_real & self.on_road[at], road),
        ), self.values_of(rows, np.arange(len(rows)), num)[0]

    def values_of(
        self, rows: Int[np.ndarray, " k"], places: Int[np.ndarray, " k"], num: int
    ) -> tuple[Float[np.ndarray, "l 3"], Bool[np.ndarray, " l"]]:
        """Values of rows at their places among `num` landmarks, and which places those are; the others hold what
        makes no sight infinite."""
        values, is_there = np.tile([0.0, 0.0, _FIRST_INVERSE_DEPTH], (num, 1)), np.zeros(num, bool)
        values[places], is_there[places] = self.value[rows], True
        return values, is_there

    def keep(
        self, rows: Int[np.ndarray, " k"], values: Float[np.ndarray, "k 3"], is_good: Bool[np.ndarray, " k"]
    ) -> None:
        """What a solve found; tracks that do not fit are let go for good."""
        self.value[rows], self.is_solved[rows] = values, True
        bad = rows[~is_good]
        self.refused |= set(self.id[bad].tolist())
        self.id[bad], self.seen[bad], self.is_solved[bad] = -1, False, False

    def _free_rows(self) -> Int[np.ndarray, " k"]:
        """Rows without a track, then those whose track was seen least and is not seen any more."""
        count = self.seen.sum(axis=1)
        gone = (self.id < 0) | (count == 0)
        order = np.flatnonzero(~gone & ~self.seen[:, max(self.num_states - 2, 0) :].any(axis=1))
        return np.concatenate([np.flatnonzero(gone), order[np.argsort(count[order], kind="stable")]])


def _without_gap(seen: Bool[np.ndarray, "l f"]) -> Bool[np.ndarray, "l f"]:
    """The first views that follow each other."""
    is_later_run = np.cumsum(np.diff(seen.astype(int), axis=1, prepend=0) > 0, axis=1) > 1
    return seen & ~is_later_run


def _depth(up: Float[np.ndarray, " l"], lift_m: Float[np.ndarray, " l"]) -> Float[np.ndarray, " l"]:
    """Way along lines of sight with vertical parts `up` to a flat road."""
    return lift_m / np.maximum(-up, _FLATTEST)


def _away(up: Float[np.ndarray, " l"], lift_m: Float[np.ndarray, " l"]) -> Float[np.ndarray, " l"]:
    """Distance over ground at which lines of sight with vertical parts `up` meet a flat road."""
    down = np.maximum(-up, _FLATTEST)
    return _depth(up, lift_m) * np.sqrt(np.maximum(1.0 - down**2, 0.0))


def _road_weights(
    up: Float[np.ndarray, " l"],
    lift_m: Float[np.ndarray, " l"],
    where_m: tuple[Float[np.ndarray, " l"], Float[np.ndarray, " l"]],
    anchor: Int[np.ndarray, " l"],
    on_road: Bool[np.ndarray, " l"],
    road: RoadBeliefs,
) -> Float[np.ndarray, " l"]:
    """Depth to the road over the standard deviation of its height, of lines of sight with vertical parts `up` that meet
    it so far away and so far to the left of the vehicle.

    What the points of one anchor share is given to each of them so often as there are points: together they then
    weigh what the mean of them does.
    """
    away_m, aside_m = where_m
    used = on_road & (up < -_FLATTEST) & (lift_m > _LEAST_LIFT_M) & (away_m < road.reach_m) & (road.sigma_m > 0.0)
    together = np.bincount(anchor[used], minlength=int(anchor.max(initial=0)) + 1)[anchor]
    own = road.sigma_m**2 + (road.rough_per_m * away_m**2) ** 2
    own += (road.crown * np.maximum(np.abs(aside_m) - road.lane_m, 0.0)) ** 2
    shared = road.heave_m**2 + (np.deg2rad(road.tilt_deg) * away_m) ** 2
    return np.where(used, _depth(up, lift_m) / np.sqrt(np.maximum(own + together * shared, 1e-12)), 0.0)
