"""How the error falls with the number of landmarks, and how far it is from the best possible (room: bench; host).

In: roads of different length with the same landmarks (`CompactWorld`). Out: Driven: for each frame the error of a
window of frames and of the frame alone, beside the bounds of Cramer and Rao.
Shapes are associated, started and solved as `semloc track --association explicit` does; only the shapes are simulated.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.explicit.association import associated
from semloc_jax.alignment.explicit.frame import ExplicitConfig, SeenShapes, explicit_frame
from semloc_jax.alignment.explicit.landmarks import Landmark
from semloc_jax.alignment.explicit.pairs import Match
from semloc_jax.alignment.explicit.pose import ExplicitPose
from semloc_jax.alignment.explicit.prediction import AssociationConfig, Prediction
from semloc_jax.alignment.explicit.start import explicit_starts
from semloc_jax.bench.compact_world import CompactWorld, WorldConfig
from semloc_jax.fusion.landmark_window import LastPose, WindowFrame, WindowSize, bound_of, last_pose
from semloc_jax.geometry import rigid
from semloc_jax.perception.primitives import Primitives
from semloc_jax.structs import STANDING_CLASSES, SolveStatus

_REACH_M = 100.0
"""Landmarks farther away are not handed to a frame."""
_EXACT = 1e-3
"""Standard deviation of a true pose where shapes are associated for the bound [m, rad]."""
_LEAST_STANDING = 4
_ONE_FRAME = WindowSize(2, 64, 12)
"""With one before it that saw nothing."""
_PLAN = np.ix_([0, 1], [0, 1])


@dataclass(frozen=True)
class LandmarkPlan:
    """What is driven."""

    roads_m: tuple[float, ...] = (4000.0, 2000.0, 1000.0, 500.0)
    seeds: tuple[int, ...] = (0, 1, 2, 3)
    """Roads of each length."""
    num_frames: int = 40
    """On each road."""
    start_m: float = 60.0
    """Where the drive begins: landmarks lie around it already."""
    world: WorldConfig = field(default_factory=WorldConfig)
    window: WindowSize = field(default_factory=lambda: WindowSize(36, 128))
    """What is older tells nothing more. A shorter one forgets where it was while nothing stands in view, and takes the
    next post for its neighbour."""
    bound_every: int = 3
    """Errors are told of every so many frames: neighbours err alike."""


class Bounds(NamedTuple):
    """Least covariances along and across [m^2]."""

    window: Float[np.ndarray, "2 2"]
    alone: Float[np.ndarray, "2 2"]


class DrivenFrame(NamedTuple):
    """One frame; errors in the axes of the vehicle [m], covariances of the same."""

    num_in_view: int
    """Signs and posts that are detected."""
    window_error_m: Float[np.ndarray, "2"]
    alone_error_m: Float[np.ndarray, "2"]
    window_covariance: Float[np.ndarray, "2 2"]
    """As it is stated."""
    bounds: Bounds | None
    """Where they were worked out."""


class Driven(NamedTuple):
    """One drive."""

    road_m: float
    seed: int
    frames: tuple[DrivenFrame, ...]
    num_before_start: int
    """Frames that passed before one sign or post gave a start."""


def drive_all(plan: LandmarkPlan, say: Callable[[str], None]) -> list[Driven]:
    """Drive on every road; `say` is called with a line after each."""
    found = []
    for road_m, seed in product(plan.roads_m, plan.seeds):
        world = CompactWorld(replace(plan.world, road_m=road_m), seed)
        found.append(_Drive(world, plan).run())
        say(f"road of {road_m:.0f} m, seed {seed}: {len(found[-1].frames)} frames")
    return found


class _Drive:
    """A vehicle on one road."""

    def __init__(self, world: CompactWorld, plan: LandmarkPlan) -> None:
        config = world.config
        self.world, self.plan, self.rng = world, plan, np.random.default_rng([world.seed, 3])
        reach = {"upright_radius_m": config.range_m, "lane_radius_m": config.lane_range_m}
        self.config = ExplicitConfig(association=AssociationConfig(**reach, map_sigma_m=config.map_sigma_m))
        self.sigma = np.array([*config.fix_sigma[:2], *config.road_sigma, config.fix_sigma[2]])
        along, across, angle = config.motion_sigma
        self.motion_sigma = np.sqrt(config.step_m) * np.array([along, across, across, angle, angle, angle])

    def run(self) -> Driven:
        """All frames from the first one that gives a start."""
        seen: list[WindowFrame] = []
        exact: list[WindowFrame] = []
        frames: list[DrivenFrame] = []
        last: LastPose | None = None
        T_before = self.world.pose(self.plan.start_m)
        for k in range(self.plan.num_frames):
            T = self.world.pose(self.plan.start_m + self.world.config.step_m * k)
            shown, T_fix = self.world.detections(T, self.rng), self._noisy(T, self.sigma)
            motion = self._noisy(rigid.inverse(T_before) @ T, self.motion_sigma)
            last = self._started(T_fix, shown) if last is None else self._predicted(last, motion)
            exact = [*exact, self._exact(T_before, T)][-self.plan.window.num_frames :]
            T_before = T
            if last is None:
                continue
            matches = self._associated(last, shown, self.world.mapped, self.config.association)
            seen.append(self._frame(matches, last.T_local_base, motion, T_fix))
            alone = self._alone(shown, last, T_fix)
            last = last_pose(seen, self.world.mapped, self.config.association, self.plan.window)
            bounds = self._bounds(exact) if k % self.plan.bound_every == 0 else None
            num = len(shown.signs) + len(shown.lamps)
            errors = [rigid.log(rigid.inverse(T) @ found)[:2] for found in (last.T_local_base, alone)]
            frames.append(DrivenFrame(num, *errors, last.covariance[_PLAN], bounds))
        return Driven(self.world.config.road_m, self.world.seed, tuple(frames), self.plan.num_frames - len(frames))

    def _noisy(self, T: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        return T @ rigid.exp(sigma * self.rng.normal(size=6))

    def _started(self, T_fix: np.ndarray, shown: Primitives) -> LastPose | None:
        """From one sign or post near a fix, where so many that stand agree: one of them may do so by chance."""
        marks = [mark for _, mark in _near(T_fix, self.world.mapped)]
        found = explicit_starts(SeenShapes.by(self.world.rig, [shown]), marks, T_fix, self.sigma, self.config)
        if not found or sum(m.sight.label in STANDING_CLASSES for m in found[0].matches) < _LEAST_STANDING:
            return None
        return LastPose(found[0].pose.T_local_base, found[0].pose.covariance, found[0].pose.status)

    def _predicted(self, last: LastPose, motion: np.ndarray) -> LastPose:
        back = rigid.adjoint(rigid.inverse(motion))
        covariance = back @ last.covariance @ back.T + np.diag(self.motion_sigma**2)
        return LastPose(last.T_local_base @ motion, covariance, last.status)

    def _associated(
        self, at: LastPose, shown: Primitives, landmarks: Sequence[Landmark], config: AssociationConfig
    ) -> tuple[Match, ...]:
        near = _near(at.T_local_base, landmarks)
        prediction = Prediction(at.T_local_base, at.covariance, [mark for _, mark in near], self.world.rig, config)
        found = associated(prediction, SeenShapes.by(self.world.rig, [shown]).sights)
        return tuple(match._replace(landmark=near[match.landmark][0]) for match in found)

    def _frame(self, matches: tuple[Match, ...], T: np.ndarray, motion: np.ndarray, T_fix: np.ndarray) -> WindowFrame:
        return WindowFrame(matches, T, motion, np.diag(1.0 / self.motion_sigma), T_fix, np.diag(1.0 / self.sigma))

    def _alone(self, shown: Primitives, at: LastPose, T_fix: np.ndarray) -> np.ndarray:
        """The pose by one frame and its fix; what came before helps to associate only."""
        near = _near(at.T_local_base, self.world.mapped)
        marks, start = [mark for _, mark in near], ExplicitPose(at.T_local_base, at.covariance, np.zeros(0), at.status)
        seen = SeenShapes.by(self.world.rig, [shown])
        once = replace(self.config, passes=1, doubt=1.0)
        return explicit_frame(seen, marks, np.ones(len(marks), bool), T_fix, self.sigma, once, start).pose.T_local_base

    def _exact(self, T_before: np.ndarray, T: np.ndarray) -> WindowFrame:
        """A frame without any noise, every shape associated."""
        certain = LastPose(T, _EXACT**2 * np.eye(6), SolveStatus.CONVERGED)
        all_of_them = replace(self.config.association, clearly=-np.inf)
        matches = self._associated(certain, self.world.detections(T, None), self.world.landmarks, all_of_them)
        return self._frame(matches, T, rigid.inverse(T_before) @ T, T)

    def _bounds(self, exact: Sequence[WindowFrame]) -> Bounds:
        """Least covariance of the last pose from all frames so far, and from the last one alone."""
        known = self.world.landmarks, self.config.association
        window = bound_of(exact, *known, self.plan.window)
        return Bounds(window[_PLAN], bound_of(exact[-1:], *known, _ONE_FRAME)[_PLAN])


def _near(T_local_base: np.ndarray, landmarks: Sequence[Landmark]) -> list[tuple[int, Landmark]]:
    """Landmarks around a place, with their numbers."""
    place = T_local_base[:3, 3]
    return [(k, mark) for k, mark in enumerate(landmarks) if np.linalg.norm(mark.middle - place) < _REACH_M]
