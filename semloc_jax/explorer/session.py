"""One frame under the hands of a person: every pose they ask about, answered in milliseconds (room: explorer; host).

In: a drive, its map, masks, a first guess; then PoseQuery. Out: the scene once, numbers and arrays for every pose.
All shapes are fixed, so that nothing is compiled while the pose is dragged, other frames included.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig, sample_within
from semloc_jax.alignment.pose import Evidence, Prior
from semloc_jax.alignment.pose_prior import PosePrior, PriorSource
from semloc_jax.alignment.single_frame import FrameInput
from semloc_jax.analysis.landscape import costs_around
from semloc_jax.analysis.probe import descend, probe, seen_from
from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.explorer import scene
from semloc_jax.explorer.answers import SliceGrid, path_of, sample_arrays, slice_grid, summary
from semloc_jax.explorer.messages import PoseQuery
from semloc_jax.explorer.placement import Placement
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.maps import LocalMap

ANCHOR_REACH_M, ANCHOR_REACH_DEG = 8.0, 22.5
"""The map samples around the anchor serve poses this near; farther away they are taken around a cell of twice the
size. Ours: a search radius of 65 m less 8 m still holds all that a view of 60 m shows."""
MAP_RADIUS_M = 150.0
_MOST_CELLS = 12
_BATCH = 512


@dataclass(frozen=True)
class OpenFrame:
    """A frame with all that does not depend on the pose."""

    index: int
    masks: list[np.ndarray]
    inputs: FrameInput
    local_map: LocalMap
    T_map_anchor: np.ndarray
    """Where the map samples are taken around: the truth, else the first guess on the road."""
    T_map_truth: np.ndarray | None
    prior: PosePrior
    cells: dict[tuple, tuple[FrameInput, np.ndarray]]
    """Map samples and their local frame around other places, by cell."""


class ExplorerSession:
    """A drive opened at one frame."""

    def __init__(
        self,
        drive: Drive,
        localizer: FrameLocalizer,
        masks: MaskSource,
        prior: PriorSource,
        frame: int = 0,
        level: int = 1,
        around: str = "truth",
    ) -> None:
        """Open a frame.

        Args:
            drive: The drive.
            localizer: Map, class table and configuration.
            masks: Masks of the drive.
            prior: First guess of each frame.
            frame: Index of the frame; negative ones count from the end.
            level: Level of the cost maps at first.
            around: `truth` or `prior`: where the vehicle stands at first; the prior where there is no truth.

        Raises:
            SemlocError: no such frame or level, or the frame cannot be read.
        """
        self.drive, self.localizer, self.masks, self._prior = drive, localizer, masks, prior
        self._level, self._around = level, around
        if not 0 <= level < self.num_levels:
            raise SemlocError(f"level {level}; the cost maps have the levels 0 (coarse) to {self.num_levels - 1}")
        if not -len(drive) <= frame < len(drive):
            raise SemlocError(f"drive {drive.name}: no frame {frame}; it has {len(drive)} frames")
        self._lock = threading.RLock()
        self.frame = self._open(frame % len(drive))

    @property
    def config(self) -> LocalizeConfig:
        """The configuration of the localizer."""
        return self.localizer.config

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the mask channels that the map has elements for."""
        return tuple(channel.name for channel in self.localizer.shown.channels)

    @property
    def num_levels(self) -> int:
        """Number of levels of the cost maps."""
        return len(self.config.cost_maps.ramp_px)

    def open_frame(self, index: int) -> None:
        """Go to another frame of the drive."""
        with self._lock:
            if index != self.frame.index:
                self.frame = self._open(index)

    def warm_up(self, report: Callable[[str, int, int], None] = lambda *_: None) -> None:
        """Compile everything; `report` is called with the current step, its number and their count."""
        query = PoseQuery(self.start(), 0, self.channel_names)
        parts: tuple[tuple[str, Callable[[], object]], ...] = (
            ("view of the map", lambda: self._seen(query)),
            ("slices of the cost", lambda: self._costs(query, self._grid(query), *self._seen(query)[:2])),
            ("residuals and covariance", lambda: self._probe(query, *self._seen(query))),
            ("solver", lambda: self._descend(query)),
            ("first answer", lambda: self.answer(query)),
        )
        for number, (text, part) in enumerate(parts):
            report(text, number, len(parts))
            part()
        report("ready", len(parts), len(parts))

    def start(self) -> Placement:
        """Where the vehicle stands at first."""
        frame = self.frame
        is_truth = self._around == "truth" and frame.T_map_truth is not None
        T = frame.T_map_truth if is_truth else frame.prior.on_road(self.localizer.map)
        return Placement.of(T, self.localizer.map)

    def scene(self) -> dict[str, Any]:
        """All that does not depend on the pose, as plain data."""
        frame, semantic_map = self.frame, self.localizer.map
        shown = self.drive.frames[frame.index]
        prior = frame.prior.on_road(semantic_map)
        rig = frame.inputs.rig
        near = semantic_map.query(frame.T_map_anchor[:2, 3], MAP_RADIUS_M)
        places = {"start": self.start(), "prior": Placement.of(prior, semantic_map)}
        if frame.T_map_truth is not None:
            places["truth"] = Placement.of(frame.T_map_truth, semantic_map)
        return {
            "drive": self.drive.name,
            "map": semantic_map.name,
            "masks": self.masks.name,
            "frames": [f.id for f in self.drive.frames],
            "frame": frame.index,
            "variant": shown.variant,
            "cameras": [
                {
                    "name": name,
                    "width": mask.shape[1],
                    "height": mask.shape[0],
                    "pictures": scene.picture_kinds(name, shown, self.masks),
                }
                for name, mask in zip(rig.names, frame.masks, strict=True)
            ],
            "channels": scene.channels(self.localizer.shown),
            "levels": [{"ramp_px": ramp} for ramp in self.config.cost_maps.ramp_px],
            "level": self._level,
            "coarse_levels": self.config.frame.search_align.levels,
            "fine_levels": self.config.frame.polish_align.levels,
            "places": {name: vars(place) for name, place in places.items()},
            "prior_sigma": {
                "xy_m": frame.prior.sigma_xy_m,
                "yaw_deg": np.rad2deg(frame.prior.sigma_heading_rad),
                "height_m": self.config.road.height_m,
                "tilt_deg": self.config.road.roll_pitch_deg,
            },
            "vehicle": scene.vehicle_outline(),
            "shapes": scene.map_shapes(near.elements),
        }

    def picture(self, index: int, kind: str, camera: str) -> bytes:
        """JPEG file of a camera in a frame.

        Raises:
            SemlocError: no such picture.
        """
        frame, names = self.drive.frames[index], self.frame.inputs.rig.names
        if camera not in names or kind not in scene.picture_kinds(camera, frame, self.masks):
            raise SemlocError(f"picture {kind} of camera '{camera[:40]}': there is none; cameras: {', '.join(names)}")
        with self._lock:
            masks = self.frame.masks if index == self.frame.index else self.masks.masks(frame)
        return scene.camera_picture(kind, camera, frame, masks[names.index(camera)], self.masks)

    def answer(self, query: PoseQuery) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Numbers and arrays of one pose.

        Raises:
            SemlocError: the map has no road there.
        """
        with self._lock:
            clock = [time.perf_counter()]
            seen = self._seen(query)
            found = jax.device_get(self._probe(query, *seen))
            clock.append(time.perf_counter())
            grid = None if query.grid == "none" else self._grid(query)
            slices = {} if grid is None else grid.arrays(self._costs(query, grid, *seen[:2]))
            clock.append(time.perf_counter())
            head = {"frame": self.frame.index, "pose": vars(query.placement), "level": query.level}
            head |= summary(found, self.channel_names, self.frame.T_map_truth is not None)
            head |= {} if grid is None else grid.head()
            if query.with_path:
                T_map_end, head["path"] = path_of(self._descend(query), self._near(query)[1])
                head["path"]["end"] = vars(Placement.of(T_map_end, self.localizer.map))
            clock.append(time.perf_counter())
        head["ms"] = dict(zip(("residuals", "slices", "path"), 1e3 * np.diff(clock), strict=True))
        return head, sample_arrays(found) | slices

    def _open(self, index: int) -> OpenFrame:
        frame = self.drive.frames[index]
        truth = None if self.drive.truth is None else self.drive.truth_at(frame)
        prior = self._prior(frame)
        anchor = prior.on_road(self.localizer.map) if truth is None else truth
        masks = self.masks.masks(frame)
        rig = self.masks.seen_by(frame.rig.select(self.masks.cameras))
        inputs, local_map = self.localizer.prepare(masks, rig, anchor)
        return OpenFrame(index, masks, inputs, local_map, anchor, truth, prior, {})

    def _near(self, query: PoseQuery) -> tuple[FrameInput, LocalFrame]:
        """The input with map samples around the pose, and the frame that they are in."""
        frame, place = self.frame, query.placement
        x, y, yaw = (float(value) for value in (*frame.T_map_anchor[:2, 3], _heading_deg(frame.T_map_anchor)))
        turned = (place.yaw_deg - yaw + 180.0) % 360.0 - 180.0
        if np.hypot(place.x_m - x, place.y_m - y) <= ANCHOR_REACH_M and abs(turned) <= ANCHOR_REACH_DEG:
            return frame.inputs, frame.local_map.frame
        size, turn = 2 * ANCHOR_REACH_M, 2 * ANCHOR_REACH_DEG
        cell = round(place.x_m / size), round(place.y_m / size), round(place.yaw_deg / turn) % round(360 / turn)
        if cell not in frame.cells:
            heading = float(np.deg2rad(cell[2] * turn)) if len(frame.inputs.rig) == 1 else None
            local_map = self.localizer.map.query(
                np.array([cell[0] * size, cell[1] * size]), self.config.search_radius_m, heading
            )
            samples = sample_within(local_map, self.config.sample_spacing_m, self.config.sample_capacity)
            while len(frame.cells) >= _MOST_CELLS:
                frame.cells.pop(next(iter(frame.cells)))
            frame.cells[cell] = frame.inputs._replace(samples=samples), local_map.frame
        return frame.cells[cell]

    def _seen(self, query: PoseQuery) -> tuple:
        inputs, local = self._near(query)
        T = jnp.asarray(local.from_map(query.placement.pose(self.localizer.map)))
        views, samples = seen_from(T, inputs, self._shown(query), self.config.frame.search_view)
        return T, Evidence(views, inputs.textures, inputs.usable), samples

    def _shown(self, query: PoseQuery) -> np.ndarray:
        return np.array([name in query.channels for name in self.channel_names], np.float32)

    def _prior_of(self, query: PoseQuery) -> Prior:
        """The solver's prior: the drive's, or one as wide around the pose set on the road."""
        _, local = self._near(query)
        prior, semantic_map = self.frame.prior, self.localizer.map
        is_drive = query.prior == "drive"
        T = prior.on_road(semantic_map) if is_drive else query.placement.on_road().pose(semantic_map)
        return prior.to_solver(T, local, self.config.road, semantic_map.road_spread(T))

    def _probe(self, query: PoseQuery, T: jax.Array, evidence: Evidence, samples: Any) -> Any:
        truth, prior = self.frame.T_map_truth, self._prior_of(query)
        T_truth = T if truth is None else jnp.asarray(self._near(query)[1].from_map(truth))
        level, config = np.int32(query.level), self.config.frame.search_align
        return probe(T, level, evidence, samples, prior, T_truth, config)

    def _grid(self, query: PoseQuery) -> SliceGrid:
        ramp_px = self.config.cost_maps.ramp_px[query.level]
        return slice_grid(ramp_px, query.zoom, query.grid, len(self.frame.inputs.rig))

    def _costs(self, query: PoseQuery, grid: SliceGrid, T: jax.Array, evidence: Evidence) -> np.ndarray:
        """Costs of the grid; in batches of one size, so that one program serves every resolution."""
        level, config = np.int32(query.level), self.config.frame.search_align
        return np.stack(jax.device_get([costs_around(xi, T, evidence, level, config) for xi in grid.chunks(_BATCH)]))

    def _descend(self, query: PoseQuery) -> Any:
        inputs, local = self._near(query)
        T = jnp.asarray(local.from_map(query.placement.pose(self.localizer.map)))
        return descend(T, inputs, self._shown(query), self._prior_of(query), self.config.frame)


def _heading_deg(T: np.ndarray) -> float:
    return float(np.rad2deg(np.arctan2(T[1, 0], T[0, 0])))
