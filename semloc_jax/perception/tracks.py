"""Corners followed from image to image: the front end of visual odometry (room: perception; host).

In: grey images of the cameras, rotations between, where nothing may be taken. Out: Tracks: ids, pixels, lines of sight.
Pyramidal Lucas-Kanade with small windows finds them in the next image (large windows are bent by foreshortening and
turn the yaw), a check backwards in time and the epipolar plane keep what is the same; where it is exactly, what it
looked like when it was found says (`patches`). Slots are fixed: a slot holds one track of one camera, or none.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from semloc_jax.cameras import Camera, Rig
from semloc_jax.geometry import rigid
from semloc_jax.perception.corners import new_corners
from semloc_jax.perception.epipolar_gate import moves_with_the_world
from semloc_jax.perception.flow import FlowConfig, followed, is_inside
from semloc_jax.perception.patches import Patches, cut_out, laid_over, no_patches
from semloc_jax.perception.road_flow import RoadAhead, moved_over_road, road_ahead, road_as_seen_now
from semloc_jax.perception.sight_lines import SightGrid, SightLines, no_sight_lines, sight_grid, sight_lines

_LEAST_SIZE = 0.5
"""A patch that is smaller than this share of what it was shows nothing of it any more."""
_FIELD_PX = 10
"""What goes on smoothly over an image is reckoned so far apart."""
_ROAD_LEVELS, _ROAD_MARGIN_PX = 3, 40
"""Levels of the pyramid where corners are foretold, and what they show of the image above."""


@dataclass(frozen=True)
class CornerConfig:
    """How corners are followed. All values are ours; the window is measured (notebooks/figures/inertial.md)."""

    num_tracks: int = 200
    """Slots, shared evenly by the cameras."""
    window_px: int = 9
    """Side of the window that is compared."""
    num_levels: int = 4
    """Levels of the pyramid."""
    back_check_px: float = 0.7
    """A corner that is followed there and back returns within this."""
    bucket_px: int = 60
    """Side of the squares of which each gives one new corner; at most, as there are to be as many squares as slots."""
    gate_px: float = 2.0
    """Largest distance from the epipolar plane of the motion."""
    border_px: int = 8
    road_gate_px: float = 12.0
    """Corners of the road are found within this of where they are foretold: far more than speed and springs move them,
    and as far ahead as back, so that nothing is said of the speed."""
    by_first_look: bool = True
    """Whether corners are laid over what they looked like when they were found. Motions between two images alone take
    what the last one says: their errors are new each time."""
    largest_slip_px: float = 1.5
    """Between where the last image and where the first one leads to."""
    least_alike: float = 0.8
    """Correlation with what the corner looked like when it was found."""
    grown: float = 1.6
    """A patch that has grown by so much is cut out anew."""


class Scenery(NamedTuple):
    """What masks say of one image, in its size."""

    usable: Bool[np.ndarray, "h w"]
    """False on traffic, sky and the vehicle; no new corner is taken there."""
    road: Bool[np.ndarray, "h w"]
    """True on the road and the paint on it."""


class Tracks(NamedTuple):
    """What is seen of every slot at one time."""

    id: Int[np.ndarray, " s"]
    """Number of the track, never used again; -1 for an empty slot."""
    camera: Int[np.ndarray, " s"]
    """Index of the camera of a slot in the rig."""
    uv: Float[np.ndarray, "s 2"]
    sight: SightLines
    num_followed: int
    """Tracks that were there at the time before."""
    flow_px: float
    """Upper quartile of their motion since then, the rotation taken out; NaN where there are none."""
    on_road: Bool[np.ndarray, " s"]
    """Whether a track was found on the road."""


class _View(NamedTuple):
    """The tracks of one camera."""

    grey: UInt8[np.ndarray, "h w"]
    id: Int[np.ndarray, " s"]
    uv: Float[np.ndarray, "s 2"]
    sight: SightLines
    on_road: Bool[np.ndarray, " s"]
    patches: Patches
    is_cut: Bool[np.ndarray, " s"]
    """Whether a patch is there already: most new corners are not found again, and need none."""


class _Road(NamedTuple):
    """What is foretold of the road."""

    ahead: RoadAhead
    here: Int[np.ndarray, " k"]
    """Slots of corners of the road that will be in view."""
    top_px: int
    before_as_now: UInt8[np.ndarray, "n w"]
    """The image before, as the road in it would be seen now, from that row on."""


class FeatureTracker:
    """Follows corners in the images of a rig."""

    def __init__(self, num_cameras: int, config: CornerConfig | None = None) -> None:
        """Slots for so many cameras, all empty."""
        self.config = config or CornerConfig()
        self.num_slots = max(self.config.num_tracks // num_cameras, 1)
        self._views: list[_View | None] = [None] * num_cameras
        self._grids: list[SightGrid | None] = [None] * num_cameras
        self._moved_m: list[Float[np.ndarray, "3"] | None] = [None] * num_cameras
        """Of each camera between the last two images, in its axes now, as the road shows it."""
        self._next_id = 0

    def step(
        self,
        greys: Sequence[UInt8[np.ndarray, "h w"]],
        rig: Rig,
        R_now_before: Float[np.ndarray, "3 3"],
        scenery: Sequence[Scenery | None] | None = None,
        moved_base_m: Float[np.ndarray, "3"] | None = None,
    ) -> Tracks:
        """Follow the corners into the next images, and take new ones where slots are empty.

        Args:
            greys: One image of every camera.
            rig: The cameras.
            R_now_before: Rotation of the base since the last images, of a gyroscope.
            scenery: Of each camera: where new corners may be, and which of them lie on the road.
            moved_base_m: How the base moved since the last images, in its axes then; None: corners of the road take it
                to go on as they have seen it last.
        """
        views, followed, flows = [], 0, []
        for index, grey in enumerate(greys):
            R_base_cam, at_m = np.split(np.asarray(rig.T_base_cam[index])[:3], [3], axis=1)
            R_cam = R_base_cam.T @ R_now_before @ R_base_cam
            before, moved_m = self._views[index], self._moved_m[index]
            if moved_base_m is not None:
                moved_m = R_base_cam.T @ (R_now_before @ (moved_base_m - at_m[:, 0]) + at_m[:, 0])
            view, flow_px, direction = self._followed(before, grey, rig, index, R_cam, moved_m)
            seen_m = None if direction is None else self._seen_motion(before, view, rig, index, R_cam, direction)
            self._moved_m[index] = seen_m
            followed += int(np.sum(view.id >= 0))
            flows.append(flow_px)
            views.append(self._filled(view, rig, index, None if scenery is None else scenery[index], direction))
        self._views = list(views)
        flow = np.concatenate(flows)
        stacked = SightLines(*(np.concatenate([v.sight[part] for v in views]) for part in range(3)))
        return Tracks(
            np.concatenate([v.id for v in views]),
            np.repeat(np.arange(len(views)), self.num_slots),
            np.concatenate([v.uv for v in views]),
            stacked,
            followed,
            float(np.percentile(flow, 75)) if len(flow) else float("nan"),
            np.concatenate([v.on_road for v in views]),
        )

    def _followed(
        self,
        before: _View | None,
        grey: np.ndarray,
        rig: Rig,
        index: int,
        R_cam: np.ndarray,
        moved_m: Float[np.ndarray, "3"] | None,
    ) -> tuple[_View, Float[np.ndarray, " k"], Float[np.ndarray, "3"] | None]:
        """The tracks that are found again, how far each moved besides rotation [px], which way the camera went."""
        empty = np.full(self.num_slots, -1)
        if before is None or before.grey.shape != grey.shape or not (before.id >= 0).any():
            uv = np.zeros((self.num_slots, 2))
            nowhere = np.zeros(self.num_slots, bool)
            none = no_patches(self.num_slots)
            return _View(grey, empty, uv, no_sight_lines(self.num_slots), nowhere, none, nowhere), np.zeros(0), None
        road = self._road(before, rig, index, R_cam, moved_m)
        uv, found = self._flow(before, grey, road)
        is_cut = before.is_cut
        if self.config.by_first_look:
            uv, found, is_cut = self._laid_over(before, grey, uv, found, road)
        rows = np.flatnonzero(found)
        sight = before.sight.put(rows, sight_lines(rig.cameras[index], uv[rows]))
        kept = np.flatnonzero(found & sight.valid)
        scale = px_per_rad(sight)[kept]
        rays = before.sight.ray_cam[kept], sight.ray_cam[kept]
        good, direction = moves_with_the_world(*rays, scale, R_cam, self.config.gate_px, self._next_id)
        ids = empty.copy()
        ids[kept[good]] = before.id[kept[good]]
        moved_px = np.linalg.norm(rigid.cross(rays[0] @ R_cam.T, rays[1]), axis=1) * scale
        return _View(grey, ids, uv, sight, before.on_road, before.patches, is_cut), moved_px[good], direction

    def _flow(
        self, before: _View, grey: np.ndarray, road: _Road | None
    ) -> tuple[Float[np.ndarray, "s 2"], Bool[np.ndarray, " s"]]:
        """Where the corners are now, and which of them came back when followed backwards."""
        config = self.config
        rules = FlowConfig(config.window_px, config.num_levels, config.back_check_px, config.border_px)
        uv, found, is_searched = before.uv.copy(), np.zeros(self.num_slots, bool), before.id >= 0
        if road is not None:
            is_searched &= ~(before.on_road & road.ahead.known)
        slots = np.flatnonzero(is_searched)
        new = followed(before.grey, grey, uv[slots], rules)
        uv[slots[new.found]], found[slots[new.found]] = new.uv[new.found], True
        if road is not None:
            below, foretold_uv = [0, road.top_px], road.ahead.uv[road.here]
            rules = rules._replace(num_levels=_ROAD_LEVELS)
            new = followed(road.before_as_now, grey[road.top_px :], foretold_uv - below, rules)
            good = new.found & (np.linalg.norm(new.uv + below - foretold_uv, axis=1) < config.road_gate_px)
            uv[road.here[good]], found[road.here[good]] = (new.uv + below)[good], True
        return uv, found

    def _laid_over(
        self,
        before: _View,
        grey: np.ndarray,
        uv: Float[np.ndarray, "s 2"],
        found: Bool[np.ndarray, " s"],
        road: _Road | None,
    ) -> tuple[Float[np.ndarray, "s 2"], Bool[np.ndarray, " s"], Bool[np.ndarray, " s"]]:
        """Where the corners are as they were when they were found; what looks otherwise has slipped."""
        config, rows = self.config, np.flatnonzero(found)
        first = rows[~before.is_cut[rows]]
        before.patches.put(first, cut_out(before.grey, before.uv[first]))
        if road is not None:
            on = rows[before.on_road[rows] & road.ahead.in_view[rows]]
            before.patches.affine[on] = road.ahead.affine[on] @ before.patches.affine[on]
        laid = laid_over(before.patches.at(rows), grey, uv[rows])
        off = np.linalg.norm(laid.uv - uv[rows], axis=1)
        inside = is_inside(laid.uv, grey.shape, config.border_px)
        size = np.sqrt(np.abs(np.linalg.det(laid.affine)))
        good = inside & (off < config.largest_slip_px) & (laid.alike > config.least_alike) & (size > _LEAST_SIZE)
        uv, found, patches = uv.copy(), np.zeros_like(found), before.patches
        kept = rows[good]
        uv[kept], found[kept], patches.affine[kept] = laid.uv[good], True, laid.affine[good]
        # A patch that has grown shows what the old one could not; it is cut out anew.
        is_cut = found.copy()
        is_cut[kept[size[good] > config.grown]] = False
        return uv, found, is_cut

    def _road(
        self, before: _View, rig: Rig, index: int, R_cam: np.ndarray, moved_m: Float[np.ndarray, "3"] | None
    ) -> _Road | None:
        """What is foretold of the corners of the road; None where nothing is."""
        if moved_m is None or not (before.on_road & (before.id >= 0)).any():
            return None
        camera, motion = rig.cameras[index], (np.asarray(rig.T_base_cam[index]), R_cam, moved_m)
        grid, ahead = self._grid(camera, index), road_ahead(camera, before.uv, before.sight, *motion)
        here = before.on_road & (before.id >= 0) & ahead.in_view
        here &= is_inside(ahead.uv, before.grey.shape, self.config.border_px)
        top_px = ahead.uv[here, 1].min(initial=before.grey.shape[0]) - _ROAD_MARGIN_PX
        first_row = max(int(top_px) // grid.field_px, 0)
        shown = road_as_seen_now(before.grey, grid, *motion, first_row)
        return _Road(ahead, np.flatnonzero(here), first_row * grid.field_px, shown)

    def _seen_motion(
        self, before: _View, view: _View, rig: Rig, index: int, R_cam: np.ndarray, direction: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "3"] | None:
        """How a camera moved by the corners of the road that it has followed."""
        on = np.flatnonzero((view.id >= 0) & view.on_road)
        now = SightLines(*(part[on] for part in view.sight))
        return moved_over_road(before.sight.ray_cam[on], now, np.asarray(rig.T_base_cam[index]), R_cam, direction)

    def _grid(self, camera: Camera, index: int) -> SightGrid:
        grid = self._grids[index]
        if grid is None or grid.camera is not camera:
            grid = self._grids[index] = sight_grid(camera, _FIELD_PX)
        return grid

    def _filled(
        self,
        view: _View,
        rig: Rig,
        index: int,
        scenery: Scenery | None,
        direction: Float[np.ndarray, "3"] | None,
    ) -> _View:
        """The view with new corners in its empty slots, such as tell their way as the camera goes in a direction."""
        free = np.flatnonzero(view.id < 0)
        config, taken = self.config, view.uv[view.id >= 0]
        usable = None if scenery is None else scenery.usable
        # An image of 640 x 400 px has 70 squares of 60 px: more than half of the slots would stay empty.
        bucket_px = min(config.bucket_px, int(np.sqrt(view.grey.size / self.num_slots)))
        flow = None
        if direction is not None:
            grid = self._grid(rig.cameras[index], index)
            flow = (grid.sight.pixels @ direction).reshape(grid.rows, grid.columns, 2)
        corners = new_corners(view.grey, usable, taken, len(free), bucket_px, config.border_px, flow)
        slots = free[: len(corners)]
        ids, uv, on_road = view.id.copy(), view.uv.copy(), view.on_road.copy()
        ids[slots], uv[slots] = self._next_id + np.arange(len(slots)), corners
        if scenery is not None:
            column, row = np.round(corners).astype(int).T
            on_road[slots] = scenery.road[row, column]
        self._next_id += len(slots)
        sight = view.sight.put(slots, sight_lines(rig.cameras[index], corners))
        ids[~sight.valid] = -1
        is_cut = view.is_cut.copy()
        is_cut[slots] = False
        return _View(view.grey, ids, uv, sight, on_road, view.patches, is_cut)


def px_per_rad(sight: SightLines) -> Float[np.ndarray, " n"]:
    """Pixels a radian beside each ray: the root of the area of a square of directions."""
    gram = sight.pixels @ np.swapaxes(sight.pixels, 1, 2)
    return np.sqrt(np.sqrt(np.maximum(np.linalg.det(gram), 0.0)))
