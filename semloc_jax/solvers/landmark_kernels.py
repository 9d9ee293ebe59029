"""The hand-written kernels for landmarks of a window as JAX functions (room: solvers; pure JAX).

In: arrays of all landmarks in float64. Out: what `fusion.inertial_sights` and `solvers.schur` compute in JAX alone;
only views that are there cost time.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from semloc_jax.host import native_status


def are_used(dtype: DTypeLike) -> bool:
    """Whether the kernels can be called: they are for float64 on CPUs."""
    is_known = jnp.dtype(dtype) == jnp.float64 and jax.default_backend() == "cpu"
    return is_known and native_status("landmark_calls").available


def eliminated(
    across: Float[Array, "l p k"], inverse: Float[Array, "l k k"], gradient: Float[Array, "l k"]
) -> tuple[Float[Array, "p p"], Float[Array, " p"]]:
    """Sums over all landmarks of A C A' and A C g, for three unknowns of each."""
    num = across.shape[1]
    shapes = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in ((num, num), (num,))]
    return tuple(jax.ffi.ffi_call("semloc_eliminated", shapes)(across, inverse, gradient))


def seen(
    T_value: Float[Array, "f 4 4"],
    height_value: Float[Array, "f 1"],
    bend_value: Float[Array, "f 1"],
    landmark: Float[Array, "l 3"],
    T_at: Float[Array, "f 4 4"],
    height_at: Float[Array, "f 1"],
    bend_at: Float[Array, "f 1"],
    indices: tuple[Int[Array, " l"], Int[Array, " l"]],
    views: tuple[Float[Array, "..."], ...],
    threshold: float,
) -> tuple[Array, ...]:
    """Cost, gradient and information of poses, heights and bends; gradient, blocks and cross blocks of all landmarks.

    Args:
        T_value: Poses where residuals are taken.
        height_value: Heights over the road there.
        bend_value: Bends of the road there.
        landmark: Directions and inverse depths.
        T_at: Poses where derivatives are taken.
        height_at: Heights there.
        bend_at: Bends there.
        indices: Anchor and camera of every landmark.
        views: The other fields of `Views`, in their order.
        threshold: Whitened distance beyond which a pull grows no more.
    """
    num_l, num = len(landmark), 8 * len(T_value)
    shapes = ((), (num,), (num, num), (num_l, 3), (num_l, 3, 3), (num_l, num, 3))
    states = T_value, height_value, bend_value, landmark, T_at, height_at, bend_at
    numbers = [jnp.asarray(x, jnp.float64) for x in states]
    places = [jnp.asarray(x, jnp.int32) for x in indices]
    rest = [jnp.asarray(x, jnp.float64) for x in views]
    call = jax.ffi.ffi_call("semloc_seen", [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes])
    return tuple(call(*numbers, *places, *rest, threshold=np.float64(threshold)))
