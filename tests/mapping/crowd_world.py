"""A road, and drives that pass it: what each would pack, without rendering an image. For the tests of the crowd map."""

from dataclasses import dataclass, field, replace

import numpy as np

from semloc_jax.geometry import rigid
from semloc_jax.mapping.crowd.looks_chain import Looks
from semloc_jax.maps import Belief, BeliefMap, MapElement, SemanticMap
from semloc_jax.maps.io.packed_drive import PackedDrive, packed_bytes, unpacked

_REACH_M = 9.0


@dataclass(frozen=True)
class DriveNoise:
    """Errors of a drive, one standard deviation each; `curl_rad` is by how much its heading goes in ten metres."""

    gnss_m: float = 1.0
    turn_rad: float = 0.003
    scale: float = 0.003
    bend_rad: float = 0.0005
    curl_rad: float = 0.0
    across_m: float = 0.03
    along_m: float = 0.08
    detected: float = 0.9
    phantoms: float = 0.02
    mount_deg: float = 0.0


@dataclass(frozen=True)
class Road:
    """A winding road: dashes in the middle, a line on either side, poles and signs."""

    length_m: float = 300.0
    elements: tuple[MapElement, ...] = field(default=())

    @classmethod
    def of(cls, length_m: float = 300.0, seed: int = 0) -> "Road":
        """The road with everything on it."""
        random = np.random.default_rng(seed)
        found = []
        for k, s in enumerate(np.arange(6.0, length_m - 6.0, 9.0)):
            found.append(_on(f"dash_{k}", "lane_marking", [(s, 0.0), (s + 3.0, 0.0)], style="dashed", width_m=0.15))
        for k, s in enumerate(np.arange(5.0, length_m, 23.0)):
            side = -5.0 if k % 2 else 8.0
            s = float(s + random.uniform(-5.0, 5.0))
            top = _on("", "pole", [(s, side)]).points + [0.0, 0.0, 4.0]
            foot = _on(f"pole_{k}", "pole", [(s, side)])
            found.append(replace(foot, points=np.vstack([foot.points, top]), radius_m=0.06))
        for name, side in (("left", 3.5), ("right", -3.5)):
            run = [(s, side) for s in np.arange(0.0, length_m + 0.1, 2.0)]
            found.append(_on(name, "lane_marking", run, style="solid", width_m=0.15))
        return cls(length_m, tuple(found))

    @property
    def map(self) -> SemanticMap:
        """The road as a map."""
        return SemanticMap(self.elements, None, "road")

    def without(self, *names: str) -> "Road":
        """The road with elements gone."""
        return replace(self, elements=tuple(e for e in self.elements if e.id not in names))

    def shifted(self, name: str, along_m: float) -> "Road":
        """The road with one element elsewhere, by name + `_moved`."""
        kept = []
        for e in self.elements:
            if e.id == name:
                step = e.points[-1] - e.points[0]
                e = replace(e, id=f"{name}_moved", points=e.points + along_m * step / np.linalg.norm(step))
            kept.append(e)
        return replace(self, elements=tuple(kept))


def _at(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place and heading of the middle of the road."""
    s = np.asarray(s, dtype=np.float64)
    heading = 0.5 * np.sin(s / 60.0)
    fine = np.linspace(0.0, max(float(s.max(initial=0.0)), 1.0), 4000)
    course = 0.5 * np.sin(fine / 60.0)
    step = np.diff(fine, prepend=0.0)
    x, y = np.cumsum(np.cos(course) * step), np.cumsum(np.sin(course) * step)
    return np.stack([np.interp(s, fine, x), np.interp(s, fine, y)], axis=-1), heading


def middle_of(road: Road) -> np.ndarray:
    """The true places of the way of every drive `[n 2]`, as many as it packs [m]."""
    return _at(np.arange(0.0, road.length_m + 0.1, 10.0))[0]


def _on(name: str, label: str, places: list[tuple[float, float]], **more) -> MapElement:
    s, side = np.array(places, dtype=np.float64).T
    xy, heading = _at(s)
    left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
    points = np.column_stack([xy + side[:, None] * left, np.zeros(len(s))])
    return MapElement(name, label, points, **more)


def drive(road: Road, number: int, noise: DriveNoise | None = None, seed: int = 0, name: str = "") -> PackedDrive:
    """What a drive along the whole road packs."""
    noise = noise or DriveNoise()
    random = np.random.default_rng([seed, number])
    s = np.arange(0.0, road.length_m + 0.1, 10.0)
    xy, heading = _at(s)
    bias = random.normal(0.0, noise.gnss_m, 2)
    turn, scale = random.normal(0.0, noise.turn_rad), 1.0 + random.normal(0.0, noise.scale)
    bends = np.cumsum(random.normal(0.0, noise.bend_rad, len(s)) + noise.curl_rad) + turn
    steps = np.diff(xy, axis=0) * scale
    c, sn = np.cos(bends[:-1])[:, None], np.sin(bends[:-1])[:, None]
    walked = np.cumsum(np.hstack([c, sn]) * steps[:, :1] + np.hstack([-sn, c]) * steps[:, 1:], axis=0)
    way = np.vstack([[0.0, 0.0], walked])
    way = way - way.mean(axis=0) + xy.mean(axis=0) + bias  # satellite fixes hold the middle

    def seen_at(points: np.ndarray, wobble: np.ndarray) -> np.ndarray:
        """Where the drive places points of the world: as it saw them from the nearest place of its way."""
        k = np.argmin(np.linalg.norm(points[:, None, :2] - xy[None], axis=2), axis=1)
        angle = bends[k] + np.deg2rad(noise.mount_deg)
        offset = points[:, :2] - xy[k] + wobble
        cc, ss = np.cos(angle), np.sin(angle)
        turned = np.stack([cc * offset[:, 0] - ss * offset[:, 1], ss * offset[:, 0] + cc * offset[:, 1]], axis=1)
        return np.column_stack([way[k] + turned, points[:, 2]])

    known = []
    for e in road.elements:
        is_line = e.style == "solid"
        if not is_line and random.random() > noise.detected:
            continue
        along = e.points[-1, :2] - e.points[0, :2]
        along = along / max(np.linalg.norm(along), 1e-9)
        left = np.array([-along[1], along[0]])
        error = random.normal(0.0, noise.across_m) * left
        if not is_line:
            error = error + random.normal(0.0, noise.along_m) * along
        if e.label.name == "POLE":
            error = random.normal(0.0, noise.across_m, 2)
        wobble = np.tile(error, (len(e.points), 1))
        if is_line:
            wobble = wobble + random.normal(0.0, 0.01, (len(e.points), 2))
        points = _rigid(e, seen_at(e.points, wobble), seen_at) if not is_line else seen_at(e.points, wobble)
        known.append((replace(e, points=points), Belief(noise.across_m, noise.along_m, 4.0, 5, 0)))
    for k in range(random.poisson(noise.phantoms * len(road.elements))):
        place = float(random.uniform(5.0, road.length_m - 5.0))
        pole = _on(f"phantom_{k}", "pole", [(place, float(random.uniform(-7.0, 7.0)))])
        points = seen_at(np.vstack([pole.points, pole.points + [0.0, 0.0, 3.0]]), np.zeros((2, 2)))
        known.append((replace(pole, points=points, radius_m=0.06), Belief(0.03, 0.03, 3.0, 4, 1)))
    start = np.array([way[0, 0], way[0, 1], 0.0, heading[0] + bends[0]])
    T = rigid.inverse(rigid.planar_pose(start[0], start[1], start[3]))
    edge = np.vstack([way + _REACH_M * _left(heading + bends), (way - _REACH_M * _left(heading + bends))[::-1]])
    elements = [replace(e, points=_moved(T, e.points)) for e, _ in known]
    held = SemanticMap(tuple(elements), None, name or f"drive_{number}")
    packed = PackedDrive(
        held.name,
        BeliefMap(held, {e.id: b for e, b in known}),
        start,
        1.5,
        None,
        np.column_stack([_moved(T, np.column_stack([way, np.zeros(len(way))])), heading + bends - start[3]]),
        (_moved(T, np.column_stack([edge, np.zeros(len(edge))]))[:, :2],),
    )
    return unpacked(packed_bytes(packed), packed.name)


def _rigid(e: MapElement, points: np.ndarray, seen_at) -> np.ndarray:
    """A short thing keeps its shape: all of it is seen from one place."""
    middle = e.points.mean(axis=0)[None]
    ahead = middle + np.array([[1.0, 0.0, 0.0]])
    a, b = seen_at(middle, np.zeros((1, 2))), seen_at(ahead, np.zeros((1, 2)))
    if np.linalg.norm((b - a)[0, :2]) < 0.5 or np.linalg.norm((b - a)[0, :2]) > 1.5:  # seen from two places
        return points
    angle = np.arctan2((b - a)[0, 1], (b - a)[0, 0])
    c, s = np.cos(angle), np.sin(angle)
    offset = e.points - middle
    turned = np.column_stack([c * offset[:, 0] - s * offset[:, 1], s * offset[:, 0] + c * offset[:, 1], offset[:, 2]])
    centre = points.mean(axis=0)
    return np.column_stack([centre[:2] + turned[:, :2], e.points[:, 2]])


def _left(heading: np.ndarray) -> np.ndarray:
    return np.stack([-np.sin(heading), np.cos(heading)], axis=1)


def _moved(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ T[:3, :3].T + T[:3, 3]


def looks(seen, visible=None, **more) -> Looks:
    """Looks of drives a step apart at things of one class, all as likely to be shown."""
    seen = np.array(seen, dtype=bool)
    n, d = seen.shape
    held = {
        "visible": np.ones((n, d), bool) if visible is None else np.array(visible, bool),
        "seen": seen,
        "group": np.zeros((n, d), int),
        "kind": np.zeros(n, int),
        "is_based": np.zeros(n, bool),
        "steps": np.ones(d),
        "before": np.full(n, 0.3),
        "counted": np.zeros((n, 2), int),
        "hidden": np.zeros(n),
    }
    return Looks(**{**held, **more})
