"""The way of a drive with all that ties it down: start, satellite fixes, loops (room: mapping; host).

In: Chain, Loops, GnssTrack, Start. Out: ChainSolution: poses in the map, calibration, loops kept, covariances.
One sparse graph: motions between frames with odometer scale, gyro scale and direction of travel as unknowns of the
whole drive, a gyro bias that wanders, one GNSS-to-map offset, the vertical, and loops of which some may be wrong
(graduated non-convexity).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import chdtri

from semloc_jax.datasets.sensors import GnssTrack
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.pose_factors import (
    calibration_of,
    fixes,
    measured_poses,
    motions,
    pose_graph,
    prior,
    values_of,
    verticals,
)
from semloc_jax.fusion.window_state import sqrt_information
from semloc_jax.geometry import rigid
from semloc_jax.geometry.umeyama import umeyama
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.turn_errors import turning_odometry, wandering, wanders
from semloc_jax.solvers.factors import Factors, costs_of
from semloc_jax.solvers.front import Sparse
from semloc_jax.solvers.gnc import GncConfig, solve_robustly
from semloc_jax.solvers.graph import FactorGraph, Values
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.solvers.problem import Solution
from semloc_jax.solvers.sparse import SparseProblem


@dataclass(frozen=True)
class ChainGraphConfig:
    """How the way of a drive is tied down. All values are ours."""

    gnss_bias_m: float = 2.0
    """Error that all fixes of a drive share, one standard deviation; an unknown of the solve."""
    gnss_memory_s: float = 10.0
    """The other errors of fixes stay the same for so long: fixes nearer to each other count less."""
    fix_threshold: float = 2.0
    """Norm of a whitened fix (2 numbers) beyond which its pull grows no more."""
    tilt_memory_s: float = 30.0
    """The errors of the vertical stay the same for so long."""
    loop_probability: float = 0.99
    """A loop beyond this quantile of the chi-square distribution is let go of."""
    place_threshold: float = 4.0
    """Norm of a whitened place (6 numbers) beyond which its pull grows no more."""
    solve: SolveConfig = field(default_factory=lambda: SolveConfig(tolerance=1e-4, max_steps=50))


class Start(NamedTuple):
    """The first pose in the map."""

    T_map_base: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    """Of its right tangent [m, rad]."""


class Loops(NamedTuple):
    """Measured motions between frames that are not neighbours."""

    a: Int[np.ndarray, " l"]
    b: Int[np.ndarray, " l"]
    """Frames of the chain."""
    Ts_a_b: Float[np.ndarray, "l 4 4"]
    covariance: Float[np.ndarray, "l 6 6"]
    """Of the right tangent [m, rad]."""


class MapPlaces(NamedTuple):
    """Measured poses of frames in the map."""

    Ts_map_base: Float[np.ndarray, "n 4 4"]
    sqrt_info: Float[np.ndarray, "n 6 6"]
    """Square root of the information of each frame's right tangent [1/m, 1/rad]; 0 where nothing was measured."""


NO_LOOPS = Loops(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 4, 4)), np.zeros((0, 6, 6)))


@dataclass(frozen=True)
class ChainSolution:
    """The most likely way of a drive.

    Attributes:
        Ts_map_base: poses of the frames.
        calibration: odometer scale, scale of the turn, direction of travel [rad].
        gnss_offset_m: how far the fixes lie off the map, east and north.
        is_kept: of every loop, False where it was let go of.
        loop_nats: cost of every loop at the solution, whether kept or not.
        solution: values and normal equations.
        problem: the graph.
    """

    Ts_map_base: Float[np.ndarray, "n 4 4"]
    calibration: Float[np.ndarray, "3"]
    gnss_offset_m: Float[np.ndarray, "2"]
    is_kept: Bool[np.ndarray, " l"]
    loop_nats: Float[np.ndarray, " l"]
    solution: Solution
    problem: SparseProblem

    def covariance(self, frames: Int[np.ndarray, " k"]) -> Float[np.ndarray, "m m"]:
        """Joint covariance of the right tangents of some poses, six rows each [m, rad]."""
        return self.problem.covariance(self.solution.equations, (6 * frames[:, None] + np.arange(6)).ravel())

    @property
    def calibration_covariance(self) -> Float[np.ndarray, "3 3"]:
        """Of odometer scale, scale of the turn, direction of travel [rad]."""
        return self.problem.covariance(self.solution.equations, 6 * len(self.Ts_map_base) + np.arange(3))

    def relative_covariance(
        self, a: Int[np.ndarray, " k"] | list[int], b: Int[np.ndarray, " k"] | list[int]
    ) -> Float[np.ndarray, "k 6 6"]:
        """Covariance of the right tangent of T_a_b of pairs of poses."""
        frames, places = np.unique(np.concatenate([a, b]).astype(int), return_inverse=True)
        joint = self.covariance(frames).reshape(len(frames), 6, len(frames), 6)
        first, second = places[: len(a)], places[len(a) :]
        T_b_a = rigid.inverse(self.Ts_map_base[frames[second]]) @ self.Ts_map_base[frames[first]]
        # T_a_b exp(d): d = xi_b - Ad(T_b_a) xi_a.
        Ad = rigid.adjoint(T_b_a)
        aa, bb, ab = (joint[i, :, j, :] for i, j in ((first, first), (second, second), (first, second)))
        cross = Ad @ ab
        return bb + Ad @ aa @ Ad.swapaxes(1, 2) - cross - cross.swapaxes(1, 2)


_VAGUE_M = 100.0
"""Standard deviation of a first place that nobody told."""
_ROUNDS = 10
_SLOTS = 16
"""Loops are solved in multiples of so many."""


def solve_chain(
    chain: Chain,
    loops: Loops = NO_LOOPS,
    gnss: GnssTrack | None = None,
    start: Start | None = None,
    config: ChainGraphConfig | None = None,
    places: MapPlaces | None = None,
) -> ChainSolution:
    """The most likely poses of a drive.

    The map is where `start` says, else where the fixes say up to their bias, else at the first pose of the chain.

    Args:
        chain: From wheels and inertial sensor.
        loops: Some may be wrong.
        gnss: Fixes in the map frame.
        start: The first pose, where it is known.
        config: None for the defaults.
        places: Poses that were found in a map; None for none.

    Raises:
        SemlocError: a loop names a frame that is not there or one frame twice, or no fix lies in the time of the drive.
    """
    config = config or ChainGraphConfig()
    graph, values = way_graph(chain, loops, gnss, start, config, places)
    place, has_loops = len(graph.factors) - 1, len(loops.a) > 0
    gnc = GncConfig(0.5 * float(chdtri(6, 1.0 - config.loop_probability)), solve=config.solve)
    with jax.enable_x64(True):
        found = solve_robustly(graph, values, (place,) if has_loops else (), gnc, Sparse())
        value = found.solution.value
        nats = np.asarray(costs_of(graph.factors[place], value))[: len(loops.a)] if has_loops else np.zeros(0)
        problem = SparseProblem(graph)
    return ChainSolution(
        Ts_map_base=np.array(value["pose"]),
        calibration=np.array(calibration_of(value)[:3]),
        gnss_offset_m=np.array(value["gnss"][0]),
        is_kept=found.weights[place][: len(loops.a)] > 0.5 if has_loops else np.zeros(0, bool),
        loop_nats=nats,
        solution=found.solution,
        problem=problem,
    )


def way_graph(
    chain: Chain,
    loops: Loops,
    gnss: GnssTrack | None,
    start: Start | None,
    config: ChainGraphConfig,
    places: MapPlaces | None,
) -> tuple[FactorGraph, Values]:
    """The graph of a drive and where it starts, loops last where there are any; arguments as `solve_chain`."""
    _check(loops, len(chain.times_s))
    T_map_odom, tied = np.eye(4), None
    if gnss is not None:
        tied, T_map_odom = _fixes(chain, gnss, config)
    if start is not None:
        T_map_odom = start.T_map_base @ rigid.inverse(chain.Ts_odom_base[0])
    first = start or _free_start(chain, T_map_odom, gnss is not None, places is not None)
    return chain_graph(chain, T_map_odom @ chain.Ts_odom_base, first, loops, tied, config, places)


def chain_graph(
    chain: Chain,
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    start: Start,
    loops: Loops,
    fix_factors: Factors | None,
    config: ChainGraphConfig,
    places: MapPlaces | None = None,
) -> tuple[FactorGraph, Values]:
    """The factors, loops last where there are any, and start values.

    Args:
        chain: From wheels and inertial sensor.
        Ts_map_base: Start values of the poses.
        start: What is known of the first pose.
        loops: Plain factors without any robust function.
        fix_factors: Satellite fixes; None for none.
        config: Noise.
        places: Poses that were found in a map; None for none.
    """
    num = len(chain.times_s)
    frames = np.arange(num)
    calibration = np.concatenate([chain.calibration, np.zeros(2)])
    known = np.zeros((11, 11))
    known[:6, :6] = start.covariance
    known[6:, 6:] = np.diag(np.concatenate([chain.calibration_sigma, np.full(2, config.gnss_bias_m)]) ** 2)
    jacobian = np.concatenate([chain.steps_jacobian, chain.steps_by_wander[:, :, None]], axis=2)
    info = _sqrt_informations(chain.steps_covariance)
    factors = [
        turning_odometry(chain.steps, jacobian, chain.calibration, info),
        *wandering(chain.times_s, chain.wander_memory_s),
        verticals(frames, chain.Ts_odom_base[:, 2, :3].copy(), _vertical_info(chain, config)),
        prior(start.T_map_base, calibration, sqrt_information(known)),
    ]
    if fix_factors is not None:
        factors.append(fix_factors)
    if places is not None:
        factors.append(measured_poses(places.Ts_map_base, places.sqrt_info, config.place_threshold))
    if len(loops.a):
        factors.append(_loop_factors(loops))
    graph = pose_graph(np.ones(num, bool), tuple(factors))
    values = {**values_of(Ts_map_base, calibration), "wander": np.zeros((num, 1))}
    return FactorGraph((*graph.families, wanders(num)), graph.factors, graph.free), values


def _loop_factors(loops: Loops) -> Factors:
    """The loops, and factors that are switched off, so that one program serves any number."""
    more = -len(loops.a) % _SLOTS
    a, b = np.pad(loops.a, (0, more)), np.pad(loops.b, (0, more), constant_values=1)
    Ts = np.concatenate([loops.Ts_a_b, np.tile(np.eye(4), (more, 1, 1))])
    info = np.concatenate([_sqrt_informations(loops.covariance), np.zeros((more, 6, 6))])
    return motions(a, b, Ts, info)


def _free_start(chain: Chain, T_map_odom: np.ndarray, has_fixes: bool, has_places: bool) -> Start:
    """What is known of the first pose without being told: it defines the map, or the fixes do and places its height."""
    T_first = T_map_odom @ chain.Ts_odom_base[0]
    height_m = _VAGUE_M if has_places else 1e-3
    sigma = np.array([_VAGUE_M, _VAGUE_M, height_m, 0.1, 0.1, 1.0]) if has_fixes else np.repeat([1e-3, 1e-4], 3)
    return Start(T_first, np.diag(sigma**2))


def _vertical_info(chain: Chain, config: ChainGraphConfig) -> np.ndarray:
    """1 / standard deviation of each vertical; those within the memory of their errors share one."""
    span_s = chain.times_s[-1] - chain.times_s[0]
    together = max(len(chain.times_s) * config.tilt_memory_s / max(span_s, config.tilt_memory_s), 1.0)
    return np.tile(1.0 / (chain.tilt_sigma_rad * np.sqrt(together))[:, None], (1, 2))


def _sqrt_informations(covariance: np.ndarray) -> np.ndarray:
    return np.array([sqrt_information(each) for each in covariance])


def _fixes(chain: Chain, gnss: GnssTrack, config: ChainGraphConfig) -> tuple[Factors, np.ndarray]:
    """The fixes as factors, and T_map_odom that lays the chain on them."""
    inside = (gnss.time_s >= chain.times_s[0]) & (gnss.time_s <= chain.times_s[-1])
    if np.sum(inside) < 2:
        raise SemlocError(
            f"satellite fixes: {int(np.sum(inside))} in the time of the frames, {chain.times_s[0]:.3f} s to "
            f"{chain.times_s[-1]:.3f} s; expected at least 2; check the clocks, or map without them (--no-gnss)"
        )
    time_s, p_fix = gnss.time_s[inside], gnss.p_enu[inside]
    frame = np.clip(np.searchsorted(chain.times_s, time_s, side="right") - 1, 0, len(chain.times_s) - 2)
    share = (time_s - chain.times_s[frame]) / np.diff(chain.times_s)[frame]
    T_since = rigid.exp(share[:, None] * rigid.log(chain.steps[frame]))
    p_base = (T_since @ np.append(gnss.antenna_base, 1.0))[:, :3]
    every_s = np.median(np.diff(time_s))
    together = max(config.gnss_memory_s / max(float(every_s), 1e-3), 1.0)
    info = 1.0 / (gnss.sigma_m[inside, :2] * np.sqrt(together))
    found = fixes(p_fix[:, :2].copy(), p_base, info, config.fix_threshold, frame)
    p_odom = (chain.Ts_odom_base[frame] @ np.column_stack([p_base, np.ones(len(p_base))])[..., None])[:, :3, 0]
    return found, _laid_on(p_fix, p_odom)


def _laid_on(p_map: np.ndarray, p_odom: np.ndarray) -> np.ndarray:
    """T_map_odom, a level motion, that brings the way onto the fixes; outliers lose their weight."""
    weight = np.ones(len(p_map))
    for _ in range(_ROUNDS):
        plane = umeyama(p_map[:, :2], p_odom[:, :2], weight)
        off_m = np.linalg.norm(p_map[:, :2] - plane.apply(p_odom[:, :2]), axis=1)
        weight = 1.0 / (1.0 + (off_m / max(float(np.median(off_m)), 1e-3)) ** 2)
    T = np.eye(4)
    T[:2, :2], T[:2, 3] = plane.R_a_b, plane.t_a_b
    T[2, 3] = np.median(p_map[:, 2] - p_odom[:, 2])
    return T


def _check(loops: Loops, num: int) -> None:
    ends = np.concatenate([loops.a, loops.b])
    if np.any((ends < 0) | (ends >= num)) or np.any(loops.a == loops.b):
        raise SemlocError(
            f"loops: frames {sorted(set(ends.tolist()))[:6]} of a chain of {num}; expected two different frames, "
            f"0 to {num - 1}, for each loop"
        )
