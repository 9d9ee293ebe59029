"""What drives along a simulated road would pack of its exact map, without an image. For the tests of the crowd map."""

from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d

from semloc_jax.evaluation.map_shapes import POSTS, is_line, kind_of, thing_of
from semloc_jax.geometry import polyline, rigid
from semloc_jax.maps import Belief, BeliefMap, MapElement, SemanticMap
from semloc_jax.maps.io.packed_drive import PackedDrive, packed_bytes, unpacked

_REACH_M, _UPRIGHT_M, _STEP_M = 9.0, 14.0, 10.0
_PARTED = ("dash", "crosswalk")


@dataclass(frozen=True)
class SightNoise:
    """Errors of a drive, one standard deviation each, as those of the maps of crowd_seed3 are.

    Args:
        gnss_m: of the place of the whole.
        turn_rad: of its direction.
        scale: of its size.
        bend_rad: by which the heading walks within 10 m.
        across_m, along_m: of a thing; lines share the first over a drive.
        post_m: of a post, each way.
        detected: share of the things beside the way that it shows.
        parted: share of dashes and bars of which it shows a part.
    """

    gnss_m: float = 1.0
    turn_rad: float = 0.003
    scale: float = 0.0035
    bend_rad: float = 0.0004
    across_m: float = 0.03
    along_m: float = 0.09
    post_m: float = 0.05
    detected: float = 0.7
    parted: float = 0.12


def sights_of_world(
    world: SemanticMap, Ts_map_base: np.ndarray, name: str, seed: list[int], noise: SightNoise | None = None
) -> PackedDrive:
    """The packed drive of a way `[n 4 4]` through an exact world."""
    noise, random = noise or SightNoise(), np.random.default_rng(seed)
    flown = _Flown.of(Ts_map_base[:, :3, 3], noise, random)
    known = []
    for e in world.elements:
        if not e.is_logical and e.style != "virtual":
            known += _lines(e, flown, noise, random) if is_line(e) else _things(e, flown, noise, random)
    start = np.array([*flown.way[0], 0.0, flown.heading_rad[0]])
    T = rigid.inverse(rigid.planar_pose(start[0], start[1], start[3]))
    left = np.stack([-np.sin(flown.heading_rad), np.cos(flown.heading_rad)], axis=1)
    edge = np.vstack([flown.way + _REACH_M * left, (flown.way - _REACH_M * left)[::-1]])
    held = SemanticMap(tuple(replace(e, points=_moved(T, e.points)) for e, _ in known), None, name)
    way = np.column_stack([_moved(T, np.column_stack([flown.way, flown.z_m])), flown.heading_rad - start[3]])
    beliefs = BeliefMap(held, {e.id: b for e, b in known})
    ring = _moved(T, np.column_stack([edge, np.zeros(len(edge))]))[:, :2]
    packed = PackedDrive(name, beliefs, start, 1.5, world.origin, way, (ring,))
    return unpacked(packed_bytes(packed), name)


@dataclass(frozen=True)
class _Flown:
    """The way as it was, and as the drive has it."""

    true: np.ndarray
    true_s_m: np.ndarray
    z_m: np.ndarray
    way: np.ndarray
    turn_rad: np.ndarray
    heading_rad: np.ndarray

    @classmethod
    def of(cls, xyz: np.ndarray, noise: SightNoise, random: np.random.Generator) -> "_Flown":
        s_m = polyline.arc_length(xyz[:, :2])
        at = np.linspace(0.0, s_m[-1], max(round(s_m[-1] / _STEP_M), 1) + 1)
        xy = np.column_stack([np.interp(at, s_m, axis) for axis in xyz[:, :2].T])
        turn = random.normal(0.0, noise.turn_rad) + np.cumsum(random.normal(0.0, noise.bend_rad, len(xy)))
        step = np.diff(xy, axis=0) * (1.0 + random.normal(0.0, noise.scale))
        c, s = np.cos(turn[:-1, None]), np.sin(turn[:-1, None])
        turned = c * step + s * np.stack([-step[:, 1], step[:, 0]], axis=1)
        way = np.vstack([np.zeros(2), np.cumsum(turned, axis=0)])
        way += xy.mean(axis=0) - way.mean(axis=0) + random.normal(0.0, noise.gnss_m, 2)  # fixes hold the middle
        ahead = np.gradient(way, axis=0)
        z_m = np.interp(at, s_m, xyz[:, 2])
        return cls(xy, polyline.arc_length(xy), z_m, way, turn, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])))

    def distance_m(self, xy: np.ndarray) -> np.ndarray:
        return shapely.distance(shapely.points(xy), shapely.LineString(self.true))

    def seen(self, points: np.ndarray, rigidly: bool) -> np.ndarray:
        """Where the drive has places of the world: from the nearest place of its way, a thing all from one."""
        foot_m = polyline.nearest(self.true, points[:, :2].mean(axis=0)[None] if rigidly else points[:, :2]).s_m
        at, to = (
            np.column_stack([np.interp(foot_m, self.true_s_m, a) for a in way.T]) for way in (self.true, self.way)
        )
        turn = np.interp(foot_m, self.true_s_m, self.turn_rad)
        c, s = np.cos(turn), np.sin(turn)
        off = points[:, :2] - at
        xy = to + np.stack([c * off[:, 0] - s * off[:, 1], s * off[:, 0] + c * off[:, 1]], axis=1)
        return np.column_stack([xy, points[:, 2]])


def _things(e: MapElement, flown: _Flown, noise: SightNoise, random: np.random.Generator) -> list:
    is_post = e.label in POSTS
    is_near = flown.distance_m(e.points[:, :2]).max() < (_UPRIGHT_M if is_post else _REACH_M)
    chance, part, side = random.random(), random.uniform(0.3, 0.65), random.random() < 0.5
    error = random.normal(size=2)
    if not is_near or chance > noise.detected or not _ahead(flown, e):
        return []
    thing, points = thing_of(e), e.points.copy()
    if kind_of(e) in _PARTED and random.random() < noise.parted:
        ahead = points[:, :2] @ thing.along
        fixed = ahead.min() if side else ahead.max()
        points[:, :2] += ((part - 1.0) * (ahead - fixed))[:, None] * thing.along
    across = np.array([-thing.along[1], thing.along[0]])
    sigma = (noise.post_m, noise.post_m) if is_post else (noise.along_m, noise.across_m)
    points[:, :2] += sigma[0] * error[0] * thing.along + sigma[1] * error[1] * across
    return [(replace(e, points=flown.seen(points, True)), Belief(sigma[1], sigma[0], 4.0, 8, 0))]


def _ahead(flown: _Flown, e: MapElement) -> bool:
    """Whether it lies beside the way, not before its start or past its end."""
    foot = polyline.nearest(flown.true, e.points[:, :2]).s_m
    return bool(foot.min() > 0.0 and foot.max() < flown.true_s_m[-1])


def _lines(e: MapElement, flown: _Flown, noise: SightNoise, random: np.random.Generator) -> list:
    xyz, error = polyline.interpolate(e.points, _every(e)), random.normal(0.0, noise.across_m)
    wobble = gaussian_filter1d(random.normal(0.0, 0.03, len(xyz)), 5.0, mode="nearest")
    step = np.gradient(xyz[:, :2], axis=0)
    left = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
    foot = polyline.nearest(flown.true, xyz[:, :2]).s_m
    near = (flown.distance_m(xyz[:, :2]) < _REACH_M) & (foot > 0.0) & (foot < flown.true_s_m[-1])
    xyz[:, :2] += (error + wobble)[:, None] * left
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]]))).reshape(-1, 2)
    runs = [(a, b) for a, b in edges.tolist() if b - a > 4]
    return [
        (replace(e, id=f"{e.id}_{k}", points=flown.seen(xyz[a:b], False)), Belief(noise.across_m, 0.3, 4.0, 8, 0))
        for k, (a, b) in enumerate(runs)
    ]


def _every(e: MapElement) -> np.ndarray:
    length_m = float(polyline.arc_length(e.points[:, :2])[-1])
    return np.linspace(0.0, length_m, max(round(length_m), 2) + 1)


def _moved(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ T[:3, :3].T + T[:3, 3]
