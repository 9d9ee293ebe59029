"""The interface of a solver in the benchmark, and the list of solvers (room: bench; host).

In: the name of a peer. Out: an object that solves from start poses, or the reason why it is not here.
A peer lives in one file and imports its library when it is made, so that the benchmark runs without the peers whose
library is missing.
"""

import importlib
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from semloc_jax.bench.problem import Problem


class PeerMissing(Exception):
    """A peer cannot run here; the text says what is missing."""


class Solved(NamedTuple):
    """What a peer returns."""

    Ts_map_base: np.ndarray
    """Poses, float[n 4 4], one for each start."""
    evaluations: float
    """Mean number of evaluations of a start."""
    cpu_s: float | None = None
    """CPU time as the peer has measured it, where it runs outside of this process."""


@runtime_checkable
class Peer(Protocol):
    """A solver of the problem."""

    def load(self, problem: Problem) -> None:
        """Take the arrays over; not timed."""

    def solve(self, Ts_init: np.ndarray, levels: tuple[int, ...]) -> Solved:
        """Poses refined from every start over the levels of the cost maps; timed."""


@dataclass(frozen=True)
class Entry:
    """One line of the benchmark."""

    name: str
    module: str
    variant: str
    text: str
    largest: int = 64
    """Starts in one call beyond which a start costs no less, or memory ends."""
    searches: bool = False
    """Whether it has `search(Ts_init)`, a search that culls."""


PEERS = (
    Entry("semloc-analytic", "ours", "analytic", "semloc_jax, native kernels, Jacobian by hand", 65536, True),
    Entry("semloc-autodiff", "ours", "autodiff", "semloc_jax, native kernels, autodiff of the camera", 65536, True),
    Entry("semloc-xla", "ours", "xla", "semloc_jax, JAX alone, autodiff of the camera", 65536, True),
    Entry("ceres-tiny", "ceres_program", "tiny", "Ceres TinySolver, one analytic block"),
    Entry("ceres-block", "ceres_program", "block", "Ceres, one analytic block"),
    Entry("ceres-autodiff", "ceres_program", "autodiff", "Ceres, a residual a point, AutoDiff"),
    Entry("optimistix", "optimistix_lm", "", "optimistix LM as documented, vmap", 1024),
    Entry("jaxopt", "jaxopt_lm", "", "jaxopt LM, vmap", 1024),
    Entry("gtsam", "gtsam_factor", "", "gtsam CustomFactor, numpy Jacobian"),
    Entry("pixloc", "torch_pixloc", "", "PixLoc-style Gauss-Newton, torch"),
    Entry("scipy-jacobian", "scipy_trf", "jacobian", "scipy trf, our Jacobian"),
    Entry("scipy-2point", "scipy_trf", "2-point", "scipy trf, finite differences"),
)
OURS = ("semloc-analytic", "semloc-autodiff", "semloc-xla")
QUICK = ("semloc-analytic", "semloc-xla", "ceres-tiny", "ceres-autodiff", "optimistix", "scipy-jacobian")
"""Peers of a brief run; optimistix and scipy are wherever the package is."""


def entry(name: str) -> Entry:
    """The entry of a peer."""
    return next(entry for entry in PEERS if entry.name == name)


def create(name: str) -> Peer:
    """A peer that is ready to load a problem.

    Raises:
        PeerMissing: Its library, compiler or path is not here.
    """
    found = entry(name)
    module = importlib.import_module(f"semloc_jax.bench.{found.module}")
    try:
        return module.create(found.variant)
    except ImportError as error:
        raise PeerMissing(str(error)) from error
