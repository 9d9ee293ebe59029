"""Where in a map several frames of a stretch lie together (room: mapping; host).

In: a map, frames with masks, the motion between them, a prior. Out: Places, best first: pose of the middle frame, its
evidence summed over the frames, how well the frames agree.
Every frame is localized alone, with all its modes; each mode says where the whole stretch would lie, and every frame
says what its masks hold for that.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.alignment.complete_modes import ModeFinder
from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.result import Mode
from semloc_jax.alignment.same_pose import ONE_PLACE, units_apart
from semloc_jax.cameras import Rig
from semloc_jax.geometry import rigid
from semloc_jax.mapping.chain_graph import ChainSolution

Look = Callable[[int], tuple[Sequence[np.ndarray], Rig]]
"""Frame -> masks and their cameras."""

PLANE = [0, 1, 5]
_ALONG_AND_ASIDE = [0, 2]
"""Scale of the odometer and direction of travel in the calibration of a way."""
_OTHER_PLACE = 2.0
"""Poses more than 1 m or 2 deg apart are different places (`alignment.same_pose`); ours."""


_EXACT = np.zeros((6, 6))
"""Covariance of a motion that is taken as it is."""


class View(NamedTuple):
    """One frame of the stretch."""

    masks: Sequence[np.ndarray]
    rig: Rig
    T_middle_base: Float[np.ndarray, "4 4"]
    """Its pose seen from the middle frame, by odometry."""
    covariance: Float[np.ndarray, "6 6"] = _EXACT
    """Of the right tangent of that [m, rad]: with an odometer whose scale nobody knows yet, frames 8 m away lie 13 cm
    off."""


class Place(NamedTuple):
    """A place of the stretch in the map."""

    T_map_middle: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    """Of its right tangent [m, rad], by the modes of the frames that end here; NaN where there is none."""
    nats: float
    """Evidence of all frames against seeing the map elsewhere."""
    is_seen: Bool[np.ndarray, " k"]
    """Frames with a mode here."""
    explained: float
    """Mean share of the map in view that lies on borders of the masks, of those frames."""
    chi_square: float
    """Squared normalised differences of their modes from the place; 3 numbers each, 3 of them used up."""


def views_of(look: Look, frames: Sequence[int], middle: int, way: ChainSolution) -> list[View]:
    """The frames of a stretch as the way has them around its middle one.

    How sure that is, scale of the odometer and direction of travel say: the difference of two poses that may both be a
    hundred metres off would be lost in rounding.
    """
    known = way.calibration_covariance[np.ix_(_ALONG_AND_ASIDE, _ALONG_AND_ASIDE)]
    views = []
    for k in frames:
        T = rigid.inverse(way.Ts_map_base[middle]) @ way.Ts_map_base[k]
        x, y, z = T[:3, 3]
        by_calibration = T[:3, :3].T @ np.array([[x, -y], [y, x], [z, 0.0]])
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = by_calibration @ known @ by_calibration.T
        views.append(View(*look(k), T, covariance))
    return views


class _Seen(NamedTuple):
    finder: ModeFinder
    modes: tuple[Mode, ...]


def search_places(
    localizer: FrameLocalizer,
    views: Sequence[View],
    T_map_middle: Float[np.ndarray, "4 4"],
    sigma_xy_m: float,
    sigma_heading_rad: float,
) -> list[Place]:
    """The places that explain the frames together, best first; empty where none is explained by any.

    Args:
        localizer: Of the map.
        views: The frames.
        T_map_middle: Where the middle frame should be.
        sigma_xy_m: Standard deviation of that.
        sigma_heading_rad: Of its heading.
    """
    seen = [_look(localizer, view, T_map_middle, sigma_xy_m, sigma_heading_rad) for view in views]
    starts = [
        (mode.evidence.nats if mode.evidence else 0.0, mode.T_map_base @ rigid.inverse(view.T_middle_base))
        for view, frame in zip(views, seen, strict=True)
        for mode in frame.modes
    ]
    proposed: list[np.ndarray] = []
    for _, T in sorted(starts, key=lambda pair: -pair[0]):
        if all(units_apart(T, other) >= ONE_PLACE for other in proposed):
            proposed.append(T)
    if not proposed:
        return []
    nats = sum(_nats(view, frame, np.array(proposed)) for view, frame in zip(views, seen, strict=True))
    modes = [frame.modes for frame in seen]
    places = [place_of_stretch(views, modes, T, float(total)) for T, total in zip(proposed, nats, strict=True)]
    return sorted(places, key=lambda place: -place.nats)


def lead_nats(places: Sequence[Place]) -> float:
    """By how much the best place beats the next one that is another place; by its own evidence where there is none."""
    others = [p.nats for p in places[1:] if units_apart(p.T_map_middle, places[0].T_map_middle) >= _OTHER_PLACE]
    return places[0].nats - max([0.0, *others])


def _look(
    localizer: FrameLocalizer, view: View, T_map_middle: np.ndarray, sigma_xy_m: float, sigma_heading_rad: float
) -> _Seen:
    """The modes of one frame, and what finds evidence of others."""
    T = T_map_middle @ view.T_middle_base
    heading = float(np.arctan2(T[1, 0], T[0, 0]))
    prior = PosePrior(float(T[0, 3]), float(T[1, 3]), heading, sigma_xy_m, sigma_heading_rad)
    T_prior = prior.on_road(localizer.map)
    inputs, local_map = localizer.prepare(view.masks, view.rig, T_prior, 2.0 * sigma_xy_m)
    finder = localizer.mode_finder(view.masks, inputs, prior, T_prior, local_map.frame)
    return _Seen(finder, finder.find().modes)


def _nats(view: View, seen: _Seen, Ts_map_middle: np.ndarray) -> np.ndarray:
    """What the masks of a frame hold for each place: at the pose by odometry, or at its own mode there."""
    Ts = Ts_map_middle @ view.T_middle_base
    modes = np.array([mode.T_map_base for mode in seen.modes]).reshape(-1, 4, 4)
    local = seen.finder.local
    poses = np.concatenate([seen.finder.road.place(local.from_map(Ts, np.float64)), local.from_map(modes, np.float64)])
    nats = seen.finder.evidence(poses)[0].nats
    best = nats[: len(Ts)].copy()
    for mode, found in zip(modes, nats[len(Ts) :], strict=True):
        near = units_apart(Ts, mode) < ONE_PLACE
        best[near] = np.maximum(best[near], found)
    return best


def place_of_stretch(
    views: Sequence[View], modes: Sequence[Sequence[Mode]], T_map_middle: Float[np.ndarray, "4 4"], nats: float
) -> Place:
    """The mean of the modes of all frames that lie at a place, each as sure as it is and its way from the middle is.

    Args:
        views: The frames.
        modes: What each of them found.
        T_map_middle: The place.
        nats: Evidence of all frames for it.
    """
    steps, covariances, explained, is_seen = [], [], [], np.zeros(len(views), bool)
    for k, (view, own) in enumerate(zip(views, modes, strict=True)):
        T_middle = T_map_middle @ view.T_middle_base
        near = [mode for mode in own if units_apart(mode.T_map_base, T_middle) < ONE_PLACE]
        if not near:
            continue
        mode = max(near, key=lambda mode: mode.evidence.nats if mode.evidence else -np.inf)
        steps.append(rigid.log(rigid.inverse(T_map_middle) @ mode.T_map_base @ rigid.inverse(view.T_middle_base)))
        Ad = rigid.adjoint(view.T_middle_base)
        covariances.append(Ad @ (mode.covariance + view.covariance) @ Ad.T)
        explained.append(mode.evidence.explained if mode.evidence else 0.0)
        is_seen[k] = True
    if not steps:
        return Place(T_map_middle, np.full((6, 6), np.nan), nats, is_seen, 0.0, 0.0)
    information = np.linalg.inv(np.array(covariances))
    covariance = np.linalg.inv(information.sum(axis=0))
    mean = covariance @ np.einsum("kij,kj->i", information, np.array(steps))
    off = (np.array(steps) - mean)[:, PLANE]
    flat = np.linalg.inv(np.array(covariances)[:, PLANE][:, :, PLANE])
    chi_square = float(np.einsum("ki,kij,kj->", off, flat, off))
    T = rigid.normalised(T_map_middle @ rigid.exp(mean))
    return Place(T, covariance, nats, is_seen, float(np.mean(explained)), chi_square)
