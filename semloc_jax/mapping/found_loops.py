"""Revisits that were searched: what came of each, and their file (room: mapping; host).

In: FoundLoop list. Out: the accepted ones for the graph, loops.csv.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from semloc_jax.mapping.chain_graph import Loops
from semloc_jax.storage import write_text


class FoundLoop(NamedTuple):
    """A revisit that was searched, and what came of it."""

    a: int
    b: int
    """Frames of the chain."""
    T_a_b: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    """Of its right tangent [m, rad]."""
    nats_over_second: float
    reasons: tuple[str, ...]
    """Why it is no loop; empty where it is accepted."""

    @property
    def is_accepted(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.reasons


def loops_of(found: Sequence[FoundLoop]) -> Loops:
    """The accepted ones, for the graph."""
    accepted = [loop for loop in found if loop.is_accepted]
    return Loops(
        np.array([loop.a for loop in accepted], int),
        np.array([loop.b for loop in accepted], int),
        np.array([loop.T_a_b for loop in accepted]).reshape(-1, 4, 4),
        np.array([loop.covariance for loop in accepted]).reshape(-1, 6, 6),
    )


def without_outvoted(found: Sequence[FoundLoop], is_kept: Bool[np.ndarray, " l"]) -> list[FoundLoop]:
    """The loops, those not accepted that the graph has let go of: the others and the odometry speak against them."""
    kept = iter(is_kept)
    return [
        loop if not loop.is_accepted or next(kept) else loop._replace(reasons=("the other loops speak against it",))
        for loop in found
    ]


COLUMNS = "t_a,t_b,x,y,z,qx,qy,qz,qw,sigma_lateral_m,sigma_longitudinal_m,nats_over_second,accepted,reasons"
"""Times [s], T_a_b [m], its standard deviations, evidence over the second-best place, 1 where it is accepted else 0 and
what speaks against it."""


def write_loops(path: str | Path, found: Sequence[FoundLoop], times_s: Float[np.ndarray, " n"]) -> None:
    """Write `loops.csv`: every revisit that was searched.

    Args:
        path: File.
        found: The revisits.
        times_s: Of the frames of the chain.
    """
    lines = [COLUMNS, *(f"{times_s[loop.a]:.9f},{times_s[loop.b]:.9f},{row_of(loop)}" for loop in found)]
    write_text(path, "\n".join(lines) + "\n")


def row_of(loop: FoundLoop) -> str:
    """The columns behind the times."""
    pose = [*loop.T_a_b[:3, 3], *Rotation.from_matrix(loop.T_a_b[:3, :3]).as_quat()]
    numbers = ",".join(f"{value:.6f}" for value in pose)
    sigmas = ",".join(f"{np.sqrt(loop.covariance[axis, axis]):.4f}" for axis in (1, 0))
    return f"{numbers},{sigmas},{loop.nats_over_second:.2f},{int(loop.is_accepted)},{'; '.join(loop.reasons)}"
