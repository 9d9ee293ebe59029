"""Tracks of images as landmarks of a window: which times saw them, directions and depths (room: fusion; host).

In: Tracks of one time after another. Out: Views and values of the landmarks of a solve.
Rows are fixed: a row holds one track. What a prior has used is not used again: the track goes on as a new landmark.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from semloc_jax.fusion.inertial_graph import Views
from semloc_jax.perception.sight_lines import tangents
from semloc_jax.perception.tracks import Tracks

_LEAST_INVERSE_DEPTH, _MOST_INVERSE_DEPTH = 1e-3, 2.0
_FIRST_INVERSE_DEPTH = 0.05
_ROUNDS = 3


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
    refused: set[int] = field(default_factory=set)
    """Tracks that do not fit; they are never taken again."""

    def __post_init__(self) -> None:
        p, f = self.num_rows, self.num_states
        self.id, self.camera = np.full(p, -1), np.zeros(p, int)
        self.ray_cam, self.pixels = np.tile([0.0, 0.0, 1.0], (p, f, 1)), np.zeros((p, f, 2, 3))
        self.seen, self.value, self.is_solved = np.zeros((p, f), bool), np.zeros((p, 3)), np.zeros(p, bool)

    def add(self, tracks: Tracks, state: int) -> None:
        """What is seen at the time of one state."""
        slots = [s for s in np.flatnonzero(tracks.id >= 0).tolist() if int(tracks.id[s]) not in self.refused]
        row_of = {track: row for row, track in enumerate(self.id.tolist()) if track >= 0}
        # A track that the prior has just used up holds its row, though nothing is seen there yet.
        alive = {row_of[track] for track in tracks.id[slots].tolist() if track in row_of}
        free = iter([row for row in self._free_rows() if row not in alive])
        for slot in slots:
            track = int(tracks.id[slot])
            row = row_of.get(track)
            if row is None:
                row = next(free, None)
                if row is None:
                    break
                self.id[row], self.camera[row] = track, tracks.camera[slot]
                self.seen[row], self.is_solved[row] = False, False
            self.ray_cam[row, state] = tracks.sight.ray_cam[slot]
            self.pixels[row, state] = tracks.sight.pixels[slot]
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
        for name in ("id", "camera", "value", "is_solved", "refused"):
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
        self, rows: Int[np.ndarray, " k"], num: int, sigma_px: float, T_base_cam: Float[np.ndarray, "f c 4 4"]
    ) -> tuple[Views, Float[np.ndarray, "l 3"]]:
        """The landmarks of the rows and their values, padded to `num`."""
        pad = num - len(rows)
        at = np.concatenate([rows, np.zeros(pad, int)])
        is_real = np.arange(num) < len(rows)
        anchor = self.anchors()[at]
        z = self.ray_cam[at, anchor]
        first, second = np.swapaxes(tangents(z), 0, 1)
        return Views(
            anchor=anchor,
            camera=self.camera[at],
            axes=np.stack([first, second, z], axis=-1),
            ray_cam=self.ray_cam[at],
            pixels=self.pixels[at],
            sqrt_info=np.where(is_real[:, None] & self.seen[at], 1.0 / sigma_px, 0.0),
            T_base_cam=T_base_cam,
        ), np.where(is_real[:, None], self.value[at], [0.0, 0.0, _FIRST_INVERSE_DEPTH])

    def keep(
        self, rows: Int[np.ndarray, " k"], values: Float[np.ndarray, "k 3"], is_good: Bool[np.ndarray, " k"]
    ) -> None:
        """What a solve found; tracks that do not fit are let go for good."""
        self.value[rows], self.is_solved[rows] = values, True
        bad = rows[~is_good]
        self.refused |= set(self.id[bad].tolist())
        self.id[bad], self.seen[bad], self.is_solved[bad] = -1, False, False

    def _free_rows(self) -> list[int]:
        """Rows without a track, then those whose track was seen least and is not seen any more."""
        count = self.seen.sum(axis=1)
        gone = (self.id < 0) | (count == 0)
        stale = ~gone & ~self.seen[:, max(self.num_states - 2, 0) :].any(axis=1)
        order = np.flatnonzero(stale)
        return [*np.flatnonzero(gone).tolist(), *order[np.argsort(count[order], kind="stable")].tolist()]
