"""Where to start: pose hypotheses around a prior (room: alignment; pure JAX).

In: prior pose, window or sigmas, number, key. Out: Ts_local_base [n 4 4] in the plane of the road of the prior pose.
"""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from semloc_jax.geometry import lie

ProposalKind = Literal["lattice", "gaussian", "along_lane"]


def propose(
    kind: ProposalKind,
    num: int,
    T_prior: Float[Array, "4 4"],
    sigma_xy_yaw: Float[Array, "3"],
    reach: float | Array,
    key: PRNGKeyArray,
) -> Float[Array, "num 4 4"]:
    """Hypotheses around a pose; the first one is the pose itself.

    Args:
        kind: `lattice` fills the window of +-reach sigmas evenly (a rank-1 lattice: no two share a coordinate);
            `gaussian` draws from the prior; `along_lane` is a lattice twice as long and half as wide.
        num: Number of hypotheses.
        T_prior: Centre; x forward, y left in the plane of the road.
        sigma_xy_yaw: Standard deviations along x [m], y [m] and of heading [rad].
        reach: Half width of the window in sigmas.
        key: Random key (gaussian only).
    """
    if kind == "gaussian":
        offsets = jnp.clip(jax.random.normal(key, (num, 3), sigma_xy_yaw.dtype), -reach, reach)
    else:
        offsets = reach * (2 * rank1_lattice(num, sigma_xy_yaw.dtype) - 1)
        if kind == "along_lane":
            offsets = offsets * jnp.asarray([2.0, 0.5, 1.0], offsets.dtype)
    return displaced(T_prior, offsets.at[0].set(0.0) * sigma_xy_yaw)


def displaced(T_local_base: Float[Array, "4 4"], xy_yaw: Float[Array, "n 3"]) -> Float[Array, "n 4 4"]:
    """The pose moved within its own ground plane by (x forward [m], y left [m], heading [rad])."""
    return T_local_base @ lie.se2_to_se3(xy_yaw[:, 0], xy_yaw[:, 1], xy_yaw[:, 2])


_G = 1.2207440846057596
LATTICE_STEPS = (1 / _G, 1 / _G**2, 1 / _G**3)
"""Powers of 1/g, g^4 = g + 1 (Roberts' R3 sequence)."""


def rank1_lattice(num: int, dtype: jnp.dtype) -> Float[Array, "num 3"]:
    """Low-discrepancy points in the unit cube: multiples of LATTICE_STEPS."""
    index = jnp.arange(num, dtype=dtype)[:, None]
    return jnp.mod(0.5 + index * jnp.asarray(LATTICE_STEPS, dtype), 1.0)
