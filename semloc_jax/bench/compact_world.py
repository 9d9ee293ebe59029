"""A road with few landmarks, in the setting of MLVHM (2020): simulated detections without images (room: bench; host).

In: how long the road is, a seed. Out: CompactWorld: true landmarks, those of the map, what each frame detects.
768 x 480 px, focal length 425 px, 2 px of noise on every detected point, 5 cm on every landmark of the map, 54 signs,
136 lamp posts, lanes: those are its values. All others are ours and stand here.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.explicit.landmarks import Landmark
from semloc_jax.alignment.explicit.prediction import AssociationConfig, Prediction
from semloc_jax.alignment.explicit.sights import projected
from semloc_jax.cameras import Rig
from semloc_jax.cameras.pinhole import PinholeCamera
from semloc_jax.cameras.rig import mounted
from semloc_jax.geometry import rigid
from semloc_jax.perception.primitives import LampLine, Primitives
from semloc_jax.perception.row_curves import RowCurve
from semloc_jax.perception.sign_outlines import SignOutline
from semloc_jax.structs import ElementClass


@dataclass(frozen=True)
class WorldConfig:
    """The road, the camera and the noise."""

    road_m: float = 2000.0
    num_signs: int = 54
    num_lamps: int = 136
    noise_px: float = 2.0
    map_sigma_m: float = 0.05
    step_m: float = 3.0
    """Way between frames: 15 m/s at 5 Hz."""
    range_m: float = 60.0
    """Signs and posts farther away are not detected."""
    lane_range_m: float = 35.0
    row_step_px: float = 12.0
    """Lanes are detected in every row of this distance."""
    motion_sigma: tuple[float, float, float] = (0.01, 0.002, 0.0003)
    """Of the odometry along and across [m] and in each angle [rad], after a metre; they grow with its root."""
    road_sigma: tuple[float, float, float] = (0.03, 0.009, 0.009)
    """Height [m], roll and pitch [rad] of a vehicle on the road of the map."""
    fix_sigma: tuple[float, float, float] = (3.0, 3.0, 0.1)
    """What is known anyhow: place [m] and heading [rad]."""


@dataclass(frozen=True)
class CompactWorld:
    """A road, its landmarks, and the camera that drives on it."""

    config: WorldConfig
    seed: int

    @cached_property
    def rig(self) -> Rig:
        """The camera of MLVHM at the height of a car's mirror."""
        camera = PinholeCamera(425.0, 425.0, 383.5, 239.5, 768, 480)
        return Rig([camera], [mounted((1.6, 0.0, 1.4))], ["front"])

    def pose(self, s_m: float) -> Float[np.ndarray, "4 4"]:
        """T_local_base at a place of the road: gentle bends, level."""
        at = np.linspace(0.0, s_m, max(int(s_m / 0.5), 1) + 1)
        heading = 0.2 * np.sin(2 * np.pi * at / 450.0)
        step = s_m / (len(at) - 1) if s_m > 0 else 0.0
        middle = 0.5 * (heading[1:] + heading[:-1])
        return rigid.planar_pose(
            float(np.cos(middle).sum() * step), float(np.sin(middle).sum() * step), float(heading[-1])
        )

    @cached_property
    def landmarks(self) -> tuple[Landmark, ...]:
        """As they are."""
        rng = np.random.default_rng([self.seed, 1])
        found = [self._sign(rng) for _ in range(self.config.num_signs)]
        found += [self._lamp(rng) for _ in range(self.config.num_lamps)]
        for start_m in np.arange(0.0, self.config.road_m + 40.0, 50.0):
            places = [self.pose(s) for s in np.arange(start_m, start_m + 51.0, 2.5)]
            for aside_m in (-1.75, 1.75, 5.25):
                points = np.array([T[:3, 3] + T[:3, 1] * aside_m for T in places])
                found.append(Landmark(ElementClass.LANE_MARKING, points, width_m=0.15))
        return tuple(found)

    def _sign(self, rng: np.random.Generator) -> Landmark:
        T = self.pose(rng.uniform(10.0, self.config.road_m + 40.0))
        aside_m = rng.choice([-1.0, 1.0]) * rng.uniform(3.5, 6.0)
        kind, half_m = rng.choice(["triangle", "rectangle", "circle"]), rng.uniform(0.32, 0.45)
        centre = T[:3, 3] + aside_m * T[:3, 1] + rng.uniform(1.8, 2.8) * T[:3, 2]
        num = {"triangle": 3, "rectangle": 4, "circle": 24}[kind]
        turn = {"triangle": np.pi / 2, "rectangle": np.pi / 4, "circle": 0.0}[kind] + 2 * np.pi * np.arange(num) / num
        reach_m = half_m / {"triangle": np.sqrt(0.75 * np.sqrt(3.0)), "rectangle": np.sqrt(2.0), "circle": 1.0}[kind]
        reach_m *= 1.0 if kind == "circle" else 2.0
        points = centre + reach_m * (np.cos(turn)[:, None] * T[:3, 1] + np.sin(turn)[:, None] * T[:3, 2])
        return Landmark(ElementClass.SIGN, points, str(kind), half_m, normal=-T[:3, 0])

    def _lamp(self, rng: np.random.Generator) -> Landmark:
        T = self.pose(rng.uniform(5.0, self.config.road_m + 50.0))
        foot = T[:3, 3] + rng.choice([-1.0, 1.0]) * rng.uniform(6.0, 8.0) * T[:3, 1]
        return Landmark(ElementClass.POLE, np.stack([foot, foot + rng.uniform(6.0, 9.0) * T[:3, 2]]))

    @cached_property
    def mapped(self) -> tuple[Landmark, ...]:
        """As the map has them: each shifted as a whole."""
        rng = np.random.default_rng([self.seed, 2])
        sigma_m = self.config.map_sigma_m
        return tuple(mark._replace(points=mark.points + sigma_m * rng.normal(size=3)) for mark in self.landmarks)

    def detections(self, T_local_base: Float[np.ndarray, "4 4"], rng: np.random.Generator | None) -> Primitives:
        """What a frame shows, every point with its noise; without a generator exact."""
        config = self.config
        reach = AssociationConfig(upright_radius_m=config.range_m, lane_radius_m=config.lane_range_m)
        seen = Prediction(T_local_base, np.eye(6), self.landmarks, self.rig, reach)
        draw = _Draw(config.noise_px, rng)
        camera, T_local_cam = self.rig.cameras[0], T_local_base @ self.rig.T_base_cam[0]
        lanes, signs, lamps = [], [], []
        for label in (ElementClass.SIGN, ElementClass.POLE, ElementClass.LANE_MARKING):
            for k in seen.candidates(label, 0):
                mark = self.landmarks[k]
                if seen.distance_m(k, 0) > reach.reach_m(label):
                    continue
                view = projected(camera, T_local_cam, _dense(mark))
                near = view.in_view & (view.distance_m < reach.reach_m(label))
                if label == ElementClass.LANE_MARKING:
                    width_px = mark.width_m * float(camera.fx) / view.distance_m[near]
                    lanes.append(draw.lane(view.uv[near], width_px, config.row_step_px))
                elif near.all():
                    signs += [draw.sign(mark, view.uv)] if label == ElementClass.SIGN else []
                    lamps += [draw.lamp(view.uv)] if label == ElementClass.POLE else []
        return Primitives(tuple(lane for lane in lanes if lane is not None), tuple(signs), tuple(lamps))


def _dense(mark: Landmark) -> np.ndarray:
    """Places of a landmark by which it is drawn."""
    if mark.label == ElementClass.LANE_MARKING:
        s = np.linspace(0.0, len(mark.points) - 1.0, 8 * len(mark.points))
        return np.stack([np.interp(s, np.arange(len(mark.points)), mark.points[:, i]) for i in range(3)], axis=1)
    return mark.points


@dataclass(frozen=True)
class _Draw:
    """Shapes from exact pixels."""

    sigma_px: float
    rng: np.random.Generator | None

    def _noise(self, *shape: int) -> np.ndarray:
        return np.zeros(shape) if self.rng is None else self.sigma_px * self.rng.normal(size=shape)

    def sign(self, mark: Landmark, uv: np.ndarray) -> SignOutline:
        variance = self.sigma_px**2
        if mark.shape == "circle":
            centre, radius = uv.mean(axis=0), float(np.linalg.norm(uv - uv.mean(axis=0), axis=1).max())
            off = self._noise(3)
            radius = max(radius + float(off[2]), 0.5)
            none = np.zeros((0, 2)), np.zeros((0, 2, 2))
            return SignOutline("circle", *none, centre + off[:2], self.sigma_px, radius, np.pi * radius**2)
        corners = uv + self._noise(*uv.shape)
        area = abs(float(_area(uv)))
        centre_sigma = self.sigma_px / float(np.sqrt(len(uv)))
        covariance = np.tile(variance * np.eye(2), (len(uv), 1, 1))
        return SignOutline(mark.shape, corners, covariance, corners.mean(axis=0), centre_sigma, 0.5 * area**0.5, area)

    def lamp(self, uv: np.ndarray) -> LampLine:
        low, high = uv[np.argsort(-uv[:, 1])] + self._noise(2, 2)
        middle, scale = 0.5 * (low[1] + high[1]), 0.5 * (low[1] - high[1])
        half = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[0] - high[0])])
        covariance = 0.5 * self.sigma_px**2 * np.eye(2)
        first, last = round(high[1] + 0.5), round(low[1] - 0.5)
        axis = RowCurve(half, covariance, middle, scale, first, last, np.full(2, 2.0))
        return LampLine(axis, (True, True), self.sigma_px)

    def lane(self, uv: np.ndarray, width_px: np.ndarray, step_px: float) -> RowCurve | None:
        order = np.argsort(uv[:, 1])
        v, u, width_px = uv[order, 1], uv[order, 0], width_px[order]
        rows = np.arange(np.ceil(v[0]), v[-1], step_px) if len(v) > 1 else np.zeros(0)
        if len(rows) < 3:
            return None
        exact = np.interp(rows, v, u)
        slope = np.gradient(exact, rows)
        if np.abs(slope).max() > 12.0:
            return None
        across = np.hypot(1.0, slope)
        degree = int(min(3, len(rows) - 2))
        middle, scale = 0.5 * (rows[0] + rows[-1]), 0.5 * (rows[-1] - rows[0])
        A = np.vander((rows - middle) / scale, degree + 1, increasing=True) / across[:, None]
        coefficients, *_ = np.linalg.lstsq(A, exact / across + self._noise(len(rows)), rcond=None)
        covariance = self.sigma_px**2 * np.linalg.inv(A.T @ A)
        return RowCurve(coefficients, covariance, middle, scale, int(rows[0]), int(rows[-1]), width_px[[0, -1]])


def _area(uv: np.ndarray) -> float:
    x, y = (uv - uv.mean(axis=0)).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
