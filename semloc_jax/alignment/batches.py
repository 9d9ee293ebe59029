"""Many solves at once: over the frames of a drive, over several devices (room: alignment; pure JAX).

In: starts, Evidence and Prior of each frame; or a mesh of devices. Out: PoseEstimate with a leading axis.
"""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Float

from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, align, align_many
from semloc_jax.errors import SemlocError
from semloc_jax.structs import PoseEstimate

HYPOTHESES = "hypotheses"
"""Name of the mesh axis over which starts are spread."""


@partial(jax.jit, static_argnames="config")
def align_frames(
    Ts_init: Float[Array, "frame n 4 4"], evidence: Evidence, prior: Prior, config: AlignConfig
) -> PoseEstimate:
    """`align` of n starts in each of several frames, in one program.

    Args:
        Ts_init: Starts of each frame.
        evidence: Evidence of the frames, from `stack_evidence`.
        prior: Prior of each frame; leaves have a leading frame axis.
        config: As `align`.

    Returns:
        PoseEstimate whose leaves have the axes frame and n.
    """
    # Frame after frame inside of the program: side by side they would only push each other out of the cache.
    frames = (Ts_init, evidence.views, evidence.textures, evidence.usable, prior)

    def one_frame(frame: tuple) -> PoseEstimate:
        Ts, views, textures, usable, own_prior = frame
        own = Evidence(views, textures, usable, evidence.always)
        return jax.vmap(lambda T: align(T, own, own_prior, config))(Ts)

    return jax.lax.map(one_frame, frames)


def stack_evidence(evidence: Sequence[Evidence]) -> Evidence:
    """The evidence of several frames with a leading frame axis.

    Raises:
        SemlocError: there is none, or the frames differ in cameras, capacities or sizes of cost maps.
    """
    if not evidence:
        raise SemlocError("stack_evidence: no frames given; expected at least one")
    shapes = [jax.tree.map(jnp.shape, one) for one in evidence]
    other = next((k for k, shape in enumerate(shapes) if shape != shapes[0]), None)
    if other is not None:
        raise SemlocError(
            f"stack_evidence: frame {other} has other cameras or sizes than frame 0; batch like with like"
        )
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *evidence)
    return eqx.tree_at(lambda e: e.always, stacked, evidence[0].always)


def align_on(
    mesh: Mesh, Ts_init: Float[Array, "n 4 4"], evidence: Evidence, prior: Prior, config: AlignConfig, chunk: int = 32
) -> PoseEstimate:
    """`align_many` with the starts spread over the devices of a mesh; evidence and prior go to each of them.

    Args:
        mesh: Devices along one axis, from `mesh_of`.
        Ts_init: Starts; their number is a multiple of the number of devices.
        evidence, prior, config, chunk: As `align_many`.
    """
    num = mesh.devices.size
    if len(Ts_init) % num:
        raise SemlocError(f"align_on: {len(Ts_init)} starts on {num} devices; give a multiple of {num}")
    return _align_on(Ts_init, evidence, prior, mesh, config, chunk)


@partial(jax.jit, static_argnames=("mesh", "config", "chunk"))
def _align_on(
    Ts_init: Array, evidence: Evidence, prior: Prior, mesh: Mesh, config: AlignConfig, chunk: int
) -> PoseEstimate:
    spread, everywhere = PartitionSpec(HYPOTHESES), PartitionSpec()
    own = partial(align_many, config=config, chunk=chunk)
    in_specs = (spread, everywhere, everywhere)
    return jax.shard_map(own, mesh=mesh, in_specs=in_specs, out_specs=spread, check_vma=False)(Ts_init, evidence, prior)


def mesh_of(devices: Sequence[jax.Device] | None = None) -> Mesh:
    """Devices in a row (None: all of them)."""
    return Mesh(np.asarray(jax.devices() if devices is None else devices), (HYPOTHESES,))
