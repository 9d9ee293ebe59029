"""semloc_jax itself as a line of the benchmark, one for each path of evaluation (room: bench).

In: a Problem. Out: poses from full solves, from a tracking solve and from a search that culls.
Only public entry points are used: `alignment.pose.refine` in chunks and `alignment.hypotheses.search_from`.
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax import native
from semloc_jax.alignment.hypotheses import SearchConfig, search_from
from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, in_chunks, refine
from semloc_jax.bench.peer import PeerMissing, Solved
from semloc_jax.bench.problem import NOISE, SIGMA, Problem
from semloc_jax.cameras import PinholeCamera, stack_cameras
from semloc_jax.residuals.alignment import CameraViews, Usable
from semloc_jax.residuals.texture import pack
from semloc_jax.structs import CostMaps

BUCKET = 128
"""Points are filled up with weight 0 to a multiple of this, as the package does with its views."""


def create(path: str) -> "SemlocPeer":
    """The package with one path of evaluation: `analytic`, `autodiff` or `xla`.

    Raises:
        PeerMissing: The kernels of the path are not here.
    """
    if path != "xla" and jax.default_backend() != "cpu":
        raise PeerMissing(f"the kernels are for CPUs, not {jax.default_backend()}")
    if path != "xla" and not native.is_available():
        raise PeerMissing(native.status().text)
    return SemlocPeer(config_of(path))


def paths() -> tuple[str, ...]:
    """The paths of evaluation that are here, the fastest last."""
    return ("xla", "autodiff", "analytic") if native.is_available() else ("xla",)


def config_of(path: str) -> AlignConfig:
    """The configuration that all lines share, by one path of evaluation."""
    return AlignConfig(max_steps=10, noise=NOISE, path=path)


def evidence_of(problem: Problem) -> tuple[Evidence, Prior]:
    """The problem in the package's containers, float32."""
    num_points = problem.p_map.shape[1]
    fill = -num_points % BUCKET
    camera = stack_cameras([PinholeCamera(*problem.focal, *problem.size)]).astype(jnp.float32)
    views = CameraViews(
        camera=camera,
        T_cam_base=jnp.asarray(problem.T_cam_base[None], jnp.float32),
        p_map=jnp.asarray(np.pad(problem.p_map, ((0, 0), (0, fill)), mode="edge")[None]),
        tangent_map=jnp.zeros((1, 3, num_points + fill), jnp.float32),
        channel=jnp.asarray(np.pad(problem.channel, (0, fill))[None]),
        weight=jnp.asarray(np.pad(problem.weight, (0, fill))[None]),
        edge=jnp.zeros((1, num_points + fill), jnp.int32),
        index=jnp.zeros(1, jnp.int32),
    )
    width, height = problem.size
    usable = jnp.ones((1, height // 2, width // 2), bool)
    maps = CostMaps(tuple(jnp.asarray(i[None]) for i in problem.images), problem.ramp_px, problem.stride, usable, 2)
    evidence = Evidence((views,), pack(maps), Usable(usable, 2))
    return evidence, Prior(jnp.asarray(problem.T_prior, jnp.float32), jnp.asarray(SIGMA, jnp.float32))


@cache
def levels_on_device(levels: tuple[int, ...]) -> jax.Array:
    """Levels as an array that is moved once: a solve of 0.1 ms feels every transfer."""
    return jnp.asarray(levels, jnp.int32)


@partial(jax.jit, static_argnames=("config", "chunk"))
def _refined(Ts, levels, evidence, prior, config, chunk):
    def one(T):
        Ts, num_steps, _ = refine(T, evidence, prior, config, levels)
        return Ts[-1], jnp.sum(num_steps)

    return in_chunks(one, Ts, chunk)


class SemlocPeer:
    """Full solves and searches of the package."""

    def __init__(self, config: AlignConfig, chunk: int | None = None) -> None:
        self.config, self.chunk = config, chunk
        self.on_accelerator = jax.default_backend() != "cpu"

    def load(self, problem: Problem) -> None:
        """Points, textures and prior in the package's containers."""
        self.evidence, self.prior = jax.block_until_ready(evidence_of(problem))

    def solve(self, Ts_init: np.ndarray, levels: tuple[int, ...]) -> Solved:
        """Full Levenberg-Marquardt from every start."""
        Ts, on_device = Ts_init.astype(np.float32), levels_on_device(levels)
        out = _refined(Ts, on_device, self.evidence, self.prior, self.config, self.chunk)
        Ts, num_steps = map(np.asarray, out)
        return Solved(Ts, num_steps.sum() / len(Ts))

    def search(self, Ts_init: np.ndarray) -> Solved:
        """The best pose of a search that scores, culls and refines."""
        Ts = jnp.asarray(Ts_init, jnp.float32)
        Ts, _ = search_from(Ts, self.evidence, self.prior, self.config, SearchConfig.fast())
        return Solved(np.asarray(Ts)[:1], float("nan"))
