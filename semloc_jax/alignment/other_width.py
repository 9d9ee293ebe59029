"""The map of a road that is wider than the map has it (room: alignment; pure JAX).

In: samples of the map, where a vehicle stands on the road. Out: the samples with both sides moved apart.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.structs import MapSamples

_MIDDLE_M = 1.0
"""What lies as near to the way of the vehicle is moved by less: it would be torn apart. Ours."""


def with_other_width(samples: MapSamples, T_local_base: Float[Array, "4 4"], wider_m: Float[Array, ""]) -> MapSamples:
    """The samples with all that lies to the left of the vehicle half of `wider_m` farther to the left, and all to its
    right as far to the right, whether it lies on the road or stands.

    Args:
        samples: In the map frame relative to the local origin [m].
        T_local_base: Where the vehicle stands, in that frame.
        wider_m: By how much the road is wider; negative: narrower.
    """
    left = T_local_base[:3, 1]
    left_m = (samples.p_map - T_local_base[:3, 3]) @ left
    shift = 0.5 * wider_m * jnp.clip(left_m / _MIDDLE_M, -1.0, 1.0)[:, None] * left
    moved = samples.p_map + shift, samples.center_map + shift
    return eqx.tree_at(lambda s: (s.p_map, s.center_map), samples, moved)
