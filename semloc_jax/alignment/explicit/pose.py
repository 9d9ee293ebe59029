"""The pose that explains matched landmarks: class-wise residuals in one solve (room: alignment; host around JAX).

In: Match list, landmarks, a prior. Out: ExplicitPose: pose, covariance with the prior, cost of every match.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.explicit.factors import KINDS, On, row_of
from semloc_jax.alignment.explicit.landmarks import Landmark
from semloc_jax.alignment.explicit.pairs import Match
from semloc_jax.alignment.explicit.prediction import AssociationConfig
from semloc_jax.residuals.motion import pose_residual
from semloc_jax.solvers.factors import POSE, Factors
from semloc_jax.solvers.front import solve
from semloc_jax.solvers.graph import FactorGraph, Family
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.structs import SolveStatus

_SOLVE = SolveConfig(tolerance=1e-4, max_steps=20)


class ExplicitPose(NamedTuple):
    """The answer of one solve."""

    T_local_base: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    """Of its right tangent, the prior included."""
    costs: Float[np.ndarray, " match"]
    """Robust cost of each match [nats]."""
    status: SolveStatus


def solved(
    matches: Sequence[Match],
    landmarks: Sequence[Landmark],
    T_prior: Float[np.ndarray, "4 4"],
    sigma: Float[np.ndarray, "6"],
    T_start: Float[np.ndarray, "4 4"],
    config: AssociationConfig,
) -> ExplicitPose:
    """The most likely pose, from matches and a prior.

    Args:
        matches: Shapes and their points of the map; the first ones where there are too many.
        landmarks: What the matches name.
        T_prior: Mean of the prior, in the local frame.
        sigma: Its standard deviations (right tangent).
        T_start: Where the solve begins.
        config: How sure the map is.
    """
    rows: dict[str, list[On]] = {name: [] for name in KINDS}
    owners: dict[str, list[int]] = {name: [] for name in KINDS}
    for index, match in enumerate(matches):
        name, row = row_of(match, landmarks[match.landmark], T_start, config)
        if len(rows[name]) < KINDS[name].capacity:
            rows[name].append(On(row))
            owners[name].append(index)
    factors = [kind.factors(rows[name], kind.capacity) for name, kind in KINDS.items()]
    held = Factors(pose_residual, ("pose",), (np.zeros(1, int),), (T_prior[None],), np.diag(1.0 / sigma)[None])
    graph = FactorGraph((Family("pose", POSE, 1),), (*factors, held))
    with jax.enable_x64(True):
        T, covariance, found, status = jax.tree.map(np.asarray, _solved(graph, T_start))
    costs = np.zeros(len(matches))
    for owner, own in zip(owners.values(), found, strict=True):
        costs[owner] = own[: len(owner)]
    return ExplicitPose(T, covariance, costs, SolveStatus(int(status)))


@eqx.filter_jit
def _solved(graph: FactorGraph, T_start):
    found = solve(graph, {"pose": T_start[None]}, _SOLVE)
    costs = [factors.costs(found.value) for factors in graph.factors[:-1]]
    return found.value["pose"][0], found.equations.covariance(), costs, found.status
