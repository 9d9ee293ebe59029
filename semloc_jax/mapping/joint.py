"""The poses of a drive and the elements of its map, solved together (room: mapping; host around JAX).

In: the graph of the way, what frames say of elements. Out: JointSolution: poses and motions of the elements.
Each element is a variable of its own, tied to the poses that see it: what two passes disagree on, they share out as
sure as each of them is. Elements are eliminated first; what is left is as sparse as the way and its crossings.
How far pulls scatter about the solution says how sure they are (variance factor of an adjustment, Helmert 1907).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from semloc_jax.geometry import rigid
from semloc_jax.mapping.element_pulls import Pulls
from semloc_jax.maps import MapElement
from semloc_jax.residuals.motion import (
    between_linearised,
    between_residual,
    cauchy,
    metre_residual,
    pose_linearised,
    pose_residual,
    pulled_linearised,
    pulled_residual,
)
from semloc_jax.solvers.factors import POSE, Factors, costs_of, vector
from semloc_jax.solvers.front import solve
from semloc_jax.solvers.graph import FactorGraph, Family, Values
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.solvers.problem import Solution
from semloc_jax.solvers.sparse import SparseProblem

ELEMENT, METRE = "element", "metre"
_METRE = vector(0.01)
"""Share by which the images show everything farther away than it is."""
_ELEMENTS, _PULLS = 64, 1024
"""They are solved in multiples of so many."""


@dataclass(frozen=True)
class JointConfig:
    """How poses and elements are solved together. All values are ours.

    An element is known from the frames that drew it, so it is tied to the nearest of them and not to the map: a
    thousand elements that may each be 0.5 m from their place in the map would together hold the scale of a way with a
    draft of it that is 0.2 % too small.

    Args:
        sigma_xy_m: how far an element may be from where it was drawn, seen from the nearest frame that looked.
        sigma_z_m: how far from the road.
        sigma_roll_deg: how far from lying in it, about the way: roads are crowned.
        sigma_pitch_deg: the same across the way, where a road is as flat as it is smooth (0.07 to 0.15 deg over the
            length of an element, ISO 8608 classes A and B). Elements that pitch as they like take the metre of the
            images with them: with 0.5 deg the way of two drives came out 0.15 % too small from the true one.
        sigma_turn_deg: how far it may be turned.
        sigma_metre: share by which the metre of the images may be off, with one camera: it was 0.2 to 0.5 % on drives
            with one camera and 0.06 to 0.2 % with four. Frames that are all wrong alike do not scatter.
        held_threshold: norm of the whitened way of an element from its place in a map that is there already beyond
            which that place holds it no more: it was moved.
        threshold: norm of a whitened pull (6 numbers, 2.4 together) beyond which it grows no more.
        least_share: directions held this much less than the firmest one are left open.
        believed_rows: what the stated noise of pulls is worth, in rows of them, against how far they scatter.
        least_noise: no pull is taken to have less than this share of its stated variance: what all frames see alike, a
            lens or a mount that is not quite as calibrated or a shape not quite as drawn, scatters in none of them.
            With 1/16 pulls bent the way of a garage of 110 m by 3.5 cm against its odometer and loops, with 1/4 by 1.8.
    """

    sigma_xy_m: float = 0.5
    sigma_z_m: float = 0.03
    sigma_roll_deg: float = 0.5
    sigma_pitch_deg: float = 0.15
    sigma_turn_deg: float = 10.0
    sigma_metre: float = 0.004
    held_threshold: float = 3.0
    threshold: float = 12.0
    least_share: float = 1e-7
    believed_rows: float = 60.0
    least_noise: float = 0.25
    solve: SolveConfig = field(default_factory=lambda: SolveConfig(tolerance=1e-4, max_steps=30))

    @property
    def sigma(self) -> Float[np.ndarray, " 6"]:
        """Of the motion of an element, along and about the axes of the vehicle that is nearest."""
        angles = np.deg2rad([self.sigma_roll_deg, self.sigma_pitch_deg, self.sigma_turn_deg])
        return np.array([self.sigma_xy_m, self.sigma_xy_m, self.sigma_z_m, *angles])


@dataclass(frozen=True)
class RefineConfig:
    """How the way is made to agree with the map that it makes. All values are ours.

    Args:
        rounds: how often frames and elements are compared; 0 leaves the way as odometry and loops have it.
        every_m: way between the frames that are compared.
        draft_every_m: way between the frames that look for the draft.
        draft_spacing_m: distance of the places on the road that they look at.
        reach_px: borders of masks farther from an element do not pull it, in the first round; half as far in each
            round after.
        last_reach_px: but no less than this. What does not belong to an element lies within 8 px of it often enough
            to bend a way: with two rounds of 8 and two of 4 px a road ended 7.7 cm off and a garage 6.1, now 3.3 and
            4.8.
    """

    rounds: int = 4
    every_m: float = 2.0
    draft_every_m: float = 1.0
    draft_spacing_m: float = 0.04
    reach_px: float = 8.0
    last_reach_px: float = 3.0

    def reach_of(self, round_: int) -> float:
        """Reach of a round [px], counted from 0."""
        return max(self.reach_px * 0.5**round_, self.last_reach_px)

    def joint(self, num_cameras: int) -> JointConfig:
        """How poses and elements are solved: each camera is calibrated on its own."""
        return JointConfig(sigma_metre=JointConfig.sigma_metre / num_cameras**0.5)


class JointSolution(NamedTuple):
    """Poses and elements that agree best."""

    Ts_map_base: Float[np.ndarray, "n 4 4"]
    motions: dict[str, np.ndarray]
    """T_new_old of every element that was seen, in the map."""
    covariance: Float[np.ndarray, "c c"]
    """Joint one of the right tangents of the poses that were asked for, six rows each [m, rad]."""
    noise: float
    """Variance of the pulls as a share of the stated one, told by how far they scatter."""


def solve_together(
    graph: FactorGraph,
    values: Values,
    frames: Sequence[int],
    pulls: Sequence[Pulls],
    elements: Sequence[MapElement],
    config: JointConfig | None = None,
    sure_of: Sequence[int] = (),
    held: Float[np.ndarray, "e 2 2"] | None = None,
) -> JointSolution:
    """The most likely poses and elements.

    Args:
        graph: of the way, without anything doubtful.
        values: where the masks were compared: poses at which the pulls were measured.
        frames: rows of the poses that looked.
        pulls: what each of them says.
        elements: of the map they were held against.
        config: noise; None for the defaults.
        sure_of: rows of the poses whose covariance is asked for.
        held: of elements of a map that is there already, square root of the information [1/m] of how far each may be
            from its place along x and y of the map; None where the drive drew them itself.
    """
    config = config or JointConfig()
    row = {element.id: k for k, element in enumerate(elements)}
    pose = np.repeat(np.asarray(frames, int), [len(each.ids) for each in pulls])
    more = -len(elements) % _ELEMENTS
    Ts_map_element = np.concatenate([[place_of(e) for e in elements], np.tile(np.eye(4), (more, 1, 1))])
    element = np.array([row[name] for each in pulls for name in each.ids], int)
    seen, drawn = pull_factors(values["pose"], Ts_map_element, pose, element, pulls, np.asarray(frames, int), config)
    families = (*graph.families, Family(ELEMENT, POSE, len(Ts_map_element)), Family(METRE, _METRE, 1))
    metre = Factors(metre_residual, (METRE,), (np.zeros(1, int),), (), np.full((1, 1), 1.0 / config.sigma_metre))
    stand = (drawn, metre) if held is None else (drawn, metre, held_factors(Ts_map_element, held, config))

    def solved(seen: Factors, start: Values) -> tuple[SparseProblem, Solution]:
        problem = SparseProblem(FactorGraph(families, (*graph.factors, seen, *stand), graph.free), (ELEMENT,))
        return problem, solve(problem, start, config.solve)

    with jax.enable_x64(True):
        _, solution = solved(seen, {**values, ELEMENT: Ts_map_element, METRE: np.zeros((1, 1))})
        num_unknowns = POSE.size * (len(np.unique(element)) + len(frames))
        noise = told_noise(seen, solution.value, num_unknowns, config)
        problem, solution = solved(of_noise(seen, noise), solution.value)
        coordinates = (6 * np.asarray(sure_of, int)[:, None] + np.arange(6)).ravel()
        covariance = problem.covariance(solution.equations, coordinates)
    found = solution.value
    motions = np.array(found[ELEMENT]) @ rigid.inverse(Ts_map_element)
    return JointSolution(np.array(found["pose"]), {name: motions[k] for name, k in row.items()}, covariance, noise)


def told_noise(seen: Factors, value: Values, num_unknowns: int, config: JointConfig) -> float:
    """Variance of the pulls as a share of the stated one.

    Args:
        seen: the pulls as they state themselves.
        value: the solution with them.
        num_unknowns: what the pulls alone have to determine; odometry does some of it, so that noise is rather told
            too large.
        config: what the stated noise is worth.
    """
    num_rows = np.count_nonzero(np.abs(np.asarray(seen.sqrt_info)).max(axis=2) > 0.0)
    spare = max(num_rows - num_unknowns, 0)
    square = 2.0 * float(np.sum(costs_of(seen, value)))
    told = (square + config.believed_rows) / (spare + config.believed_rows)
    return max(told, config.least_noise)


def of_noise(seen: Factors, noise: float) -> Factors:
    """The pulls with a variance that is this share of the stated one."""
    by = noise**-0.5
    T_element_base, offset = seen.data
    return eqx.tree_at(lambda f: (f.data, f.sqrt_info), seen, ((T_element_base, by * offset), by * seen.sqrt_info))


def pull_factors(
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    Ts_map_element: Float[np.ndarray, "m 4 4"],
    pose: Int[np.ndarray, " f"],
    element: Int[np.ndarray, " f"],
    pulls: Sequence[Pulls],
    looking: Int[np.ndarray, " k"],
    config: JointConfig,
) -> tuple[Factors, Factors]:
    """What was seen of every element from every pose, and how far each may be from where it was drawn.

    Args:
        Ts_map_base: where the masks were compared.
        Ts_map_element: where elements were drawn.
        pose, element: of every pull.
        pulls: of every frame that looked, in the order of `pose`.
        looking: poses that looked.
        config: noise.
    """
    force = np.concatenate([each.force for each in pulls])
    root, offset = square_roots(np.concatenate([each.information for each in pulls]), force, config.least_share)
    # Factors that are switched off, so that one program serves all rounds.
    more = _PULLS - len(pose) % _PULLS
    pose, element = np.pad(pose, (0, more)), np.pad(element, (0, more))
    root, offset = np.pad(root, ((0, more), (0, 0), (0, 0))), np.pad(offset, ((0, more), (0, 0)))
    Ts_map_base = np.asarray(Ts_map_base)
    T_element_base = rigid.inverse(Ts_map_element[element]) @ Ts_map_base[pose]
    seen = Factors(
        pulled_residual,
        (ELEMENT, "pose", METRE),
        (element, pose, np.zeros_like(pose)),
        (T_element_base, offset),
        root,
        robust=cauchy(config.threshold),
        linearised=pulled_linearised,
    )
    nearest = looking[cKDTree(Ts_map_base[looking, :2, 3]).query(Ts_map_element[:, :2, 3])[1]]
    R_base_map = Ts_map_base[nearest, :3, :3].swapaxes(1, 2)
    info = np.zeros((len(Ts_map_element), 6, 6))
    info[:, :3, :3], info[:, 3:, 3:] = (R_base_map / part[:, None] for part in np.split(config.sigma, 2))
    keys = (nearest, np.arange(len(Ts_map_element)))
    T_base_element = rigid.inverse(Ts_map_base[nearest]) @ Ts_map_element
    drawn = Factors(between_residual, ("pose", ELEMENT), keys, (T_base_element,), info, linearised=between_linearised)
    return seen, drawn


def held_factors(
    Ts_map_element: Float[np.ndarray, "m 4 4"], held: Float[np.ndarray, "e 2 2"], config: JointConfig
) -> Factors:
    """How far elements of a map that is there already may be from their places in it: aside, not up or tilted.

    Args:
        Ts_map_element: their places, without a turn, and those of elements that fill up.
        held: square root of their information [1/m] along x and y of the map.
        config: when a place holds an element no more.
    """
    info = np.zeros((len(Ts_map_element), 2, 6))
    info[: len(held), :, :2] = held
    keys, robust = (np.arange(len(Ts_map_element)),), cauchy(config.held_threshold)
    data = (np.asarray(Ts_map_element),)
    return Factors(pose_residual, (ELEMENT,), keys, data, info, robust=robust, linearised=pose_linearised)


def square_roots(
    information: Float[np.ndarray, "f 6 6"], force: Float[np.ndarray, "f 6"], least_share: float
) -> tuple[Float[np.ndarray, "f 6 6"], Float[np.ndarray, "f 6"]]:
    """R with R^T R = information, and b with R^T b = force, in the directions that are held at all."""
    values, vectors = np.linalg.eigh(information)
    is_held = values > least_share * np.maximum(values[:, -1:], 1e-12)
    root = np.sqrt(np.where(is_held, values, 0.0))
    rows = root[:, :, None] * vectors.swapaxes(1, 2)
    along = np.einsum("fij,fi->fj", vectors, force)
    return rows, np.divide(along, root, out=np.zeros_like(along), where=is_held)


def place_of(element: MapElement) -> Float[np.ndarray, "4 4"]:
    """T_map_element: the middle of an element, without a turn."""
    T = np.eye(4)
    T[:3, 3] = element.points.mean(axis=0)
    return T


def moved(element: MapElement, T_new_old: Float[np.ndarray, "4 4"]) -> MapElement:
    """An element after a motion in the map."""
    return element.with_points(element.points @ T_new_old[:3, :3].T + T_new_old[:3, 3])
