"""Points brought onto the nearest points of their class, in the plane (room: alignment; host).

In: two sets of points with a class each, a start. Out: IcpResult: motion, covariance, how well they agree.
AVP-SLAM (Qin et al. 2020, arXiv 2007.01813): argmin over R, t of sum ||R p_k + t - m_k||^2, where m_k is the nearest
point of the same class. Road-SLAM (Jeong et al., IV 2017) ends its matches in the same way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.geometry.umeyama import umeyama

_NEIGHBOURS = 6
"""Points that tell the direction of the line that a point lies on."""
_LEAST_PAIRS = 3
_LEAST_SIGMA_M = 0.02
"""Points of masks are no better than this, however well they fit."""


class ClassPoints(NamedTuple):
    """Points in a plane, each of a class."""

    xy: Float[np.ndarray, "n 2"]
    """Places [m]."""
    label: Int[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    """How much each counts, > 0."""

    @classmethod
    def of(cls, xy: Float[np.ndarray, "n 2"], label: Int[np.ndarray, " n"]) -> "ClassPoints":
        """Points that count alike."""
        return cls(np.asarray(xy, np.float64), np.asarray(label, np.int64), np.ones(len(xy)))

    @classmethod
    def joined(cls, parts: Sequence["ClassPoints"]) -> "ClassPoints":
        """All points of several sets."""
        if not parts:
            return cls.of(np.zeros((0, 2)), np.zeros(0, np.int64))
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def moved(self, T_a_b: Float[np.ndarray, "4 4"]) -> "ClassPoints":
        """The points of frame b in frame a; T_a_b counts as a motion in the plane."""
        return self._replace(xy=self.xy @ T_a_b[:2, :2].T + T_a_b[:2, 3])

    def thinned(self, cell_m: float) -> "ClassPoints":
        """One point for each class and cell of a grid: the first, with the weights of all."""
        cell = np.floor(self.xy / cell_m).astype(np.int64)
        keys = np.column_stack([self.label, cell])
        _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(first)
        weight = np.bincount(group.ravel(), self.weight, len(first))
        return ClassPoints(self.xy[first[order]], self.label[first[order]], weight[order])


@dataclass(frozen=True)
class IcpConfig:
    """How points are brought onto each other."""

    gates_m: tuple[float, ...] = (1.0, 0.3)
    """Pairs farther apart do not count, gate after gate; those of AVP-SLAM."""
    max_steps: int = 100
    """Steps for each gate; ours."""
    tolerance_m: float = 1e-3
    """A step that moves no point of the source by more is the last one of its gate; ours."""
    together: float = 10.0
    """So many neighbouring points err alike: one border of a mask; ours."""


class IcpResult(NamedTuple):
    """A motion between two sets of points."""

    T_target_source: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "3 3"]
    """Of its right tangent along x, y [m] and heading [rad]. A point says nothing along the line that it lies on."""
    inlier_ratio: float
    """Share of the points of the source, by weight, with a partner within the last gate."""
    rms_m: float
    """Root mean square of the distances of these pairs."""
    labels: tuple[int, ...]
    """Classes of which at least three points have a partner."""
    converged: bool
    """False where a gate ended by its number of steps, or too few pairs were left."""


@dataclass(frozen=True)
class ClassTrees:
    """The target of many alignments: nearest points and directions of lines, by class."""

    points: ClassPoints
    trees: dict[int, cKDTree]
    rows: dict[int, np.ndarray]

    @classmethod
    def of(cls, points: ClassPoints) -> "ClassTrees":
        """The trees of some points."""
        rows = {int(label): np.flatnonzero(points.label == label) for label in np.unique(points.label)}
        return cls(points, {label: cKDTree(points.xy[own]) for label, own in rows.items()}, rows)

    def nearest(self, points: ClassPoints, gate_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of rows (here, in the target) of one class that are nearest and no farther apart than the gate."""
        here, there = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for label, tree in self.trees.items():
            own = np.flatnonzero(points.label == label)
            _, found = tree.query(points.xy[own], distance_upper_bound=gate_m)
            near = found < len(self.rows[label])
            here.append(own[near])
            there.append(self.rows[label][found[near]])
        return np.concatenate(here), np.concatenate(there)

    def across(self, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2 2"]:
        """What a point of the target tells of a place: all across its line, and along it as far as it is no line."""
        weight = np.tile(np.eye(2), (len(rows), 1, 1))
        for label, tree in self.trees.items():
            own = np.flatnonzero(self.points.label[rows] == label)
            if not len(own) or tree.n < _LEAST_PAIRS:
                continue
            xy = self.points.xy[rows[own]]
            _, near = tree.query(xy, k=min(_NEIGHBOURS, tree.n))
            offset = tree.data[near] - tree.data[near].mean(axis=1, keepdims=True)
            spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offset, offset))
            share = spread[:, 0] / np.maximum(spread[:, 1], 1e-12)
            normal, along = axes[:, :, 0], axes[:, :, 1]
            weight[own] = (
                normal[:, :, None] * normal[:, None] + share[:, None, None] * along[:, :, None] * along[:, None]
            )
        return weight


def align_points(
    source: ClassPoints,
    target: ClassPoints | ClassTrees,
    T_target_source: Float[np.ndarray, "4 4"],
    config: IcpConfig | None = None,
) -> IcpResult:
    """The motion in the plane that lays points on the nearest points of their class.

    Two local maps are aligned the same way: one is the source, the other the target.

    Args:
        source: Points to be moved.
        target: Points that stay; `ClassTrees` where many sources are laid on them.
        T_target_source: Where to start; its part in the plane counts.
        config: None for the defaults.

    Returns:
        IcpResult. Too few pairs leave the start, with `converged` False and an infinite covariance.

    Raises:
        SemlocError: a set has no points, or something is not finite.
    """
    config = config or IcpConfig()
    trees = target if isinstance(target, ClassTrees) else ClassTrees.of(target)
    _check(source, trees.points, T_target_source)
    heading = float(np.arctan2(T_target_source[1, 0], T_target_source[0, 0]))
    T = rigid.planar_pose(float(T_target_source[0, 3]), float(T_target_source[1, 3]), heading)
    converged = True
    for gate_m in config.gates_m:
        for _ in range(config.max_steps):
            moved = source.moved(T)
            here, there = trees.nearest(moved, gate_m)
            if len(here) < _LEAST_PAIRS:
                return IcpResult(T, np.full((3, 3), np.inf), 0.0, float("inf"), (), False)
            step = umeyama(trees.points.xy[there], moved.xy[here], source.weight[here])
            T_step = rigid.planar_pose(*step.t_a_b, float(np.arctan2(step.R_a_b[1, 0], step.R_a_b[0, 0])))
            T = T_step @ T
            shift_m = np.abs(moved.moved(T_step).xy - moved.xy).max()
            if shift_m < config.tolerance_m:
                break
        else:
            converged = False
    return _result(source, trees, T, config, converged)


def _result(source: ClassPoints, trees: ClassTrees, T: np.ndarray, config: IcpConfig, converged: bool) -> IcpResult:
    moved = source.moved(T)
    here, there = trees.nearest(moved, config.gates_m[-1])
    if len(here) < _LEAST_PAIRS:
        return IcpResult(T, np.full((3, 3), np.inf), 0.0, float("inf"), (), False)
    off, weight = trees.points.xy[there] - moved.xy[here], source.weight[here]
    rms_m = float(np.sqrt(weight @ (off * off).sum(axis=1) / weight.sum()))
    x, y = source.xy[here].T
    # p_target = R (p + v + omega (-y, x)): the derivative by the right tangent.
    J = np.zeros((len(here), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -y, x
    J = T[:2, :2] @ J
    counts = weight / weight.mean() / (config.together * max(rms_m, _LEAST_SIGMA_M) ** 2)
    information = np.einsum("n,nri,nrs,nsj->ij", counts, J, trees.across(there), J)
    singular = np.linalg.cond(information) > 1e12
    covariance = np.full((3, 3), np.inf) if singular else np.linalg.inv(information)
    labels = [int(label) for label in np.unique(source.label) if (source.label[here] == label).sum() >= _LEAST_PAIRS]
    return IcpResult(T, covariance, float(weight.sum() / source.weight.sum()), rms_m, tuple(labels), converged)


def _check(source: ClassPoints, target: ClassPoints, T: np.ndarray) -> None:
    if not len(source.xy) or not len(target.xy):
        raise SemlocError(f"ICP: {len(source.xy)} points on {len(target.xy)}; expected at least one in each set")
    if not all(np.isfinite(part).all() for part in (source.xy, target.xy, T)):
        raise SemlocError("ICP: points or start with NaN or infinity; expected finite numbers")
