"""The cost along the road, with everything else free (room: analysis; JAX).

In: one frame, a pose, distances along the road. Out: robust cost of the best pose at each distance.
What repeats along a road (dashes, lamps) shows as minima of nearly equal depth: the pose is one of several.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.pose import AlignConfig, Prior, align, in_chunks
from semloc_jax.alignment.proposals import displaced
from semloc_jax.alignment.single_frame import FrameInput, evidence_from
from semloc_jax.cameras import Rig
from semloc_jax.residuals.view import ViewConfig

_ALIGN = AlignConfig(levels=(0, 1, 2))
_VIEW = ViewConfig(margin_share=0.3)
_SIDEWAYS_M, _TURN_DEG = 2.0, 3.0
"""How far the pose may leave the straight line: roads bend."""


def cost_along_road(
    localizer: FrameLocalizer,
    masks: Sequence[np.ndarray],
    rig: Rig,
    T_map_base: np.ndarray,
    offset_m: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Cost in [0, 1] of the best pose at each distance along the road: 0 explains all of the map in view, 1 nothing.

    Args:
        localizer: Map, class table and configuration.
        masks: Class ids of every camera of the rig.
        rig: Cameras of the masks.
        T_map_base: Pose at distance 0, in the map frame.
        offset_m: Distances, positive ahead.
    """
    inputs, local_map = localizer.prepare(masks, rig, T_map_base)
    T_local = np.array(T_map_base, dtype=np.float64)
    T_local[:3, 3] -= local_map.origin_map
    road = localizer.config.road
    tilt = np.deg2rad(road.roll_pitch_deg)
    # A sigma of 0 locks the direction along the road.
    sigma = np.array([0.0, _SIDEWAYS_M, road.height_m, tilt, tilt, np.deg2rad(_TURN_DEG)], np.float32)
    ahead = np.zeros((len(offset_m), 3), np.float32)
    ahead[:, 0] = offset_m
    starts = displaced(jnp.asarray(T_local, jnp.float32), jnp.asarray(ahead))
    return np.asarray(_costs(starts, inputs, jnp.asarray(sigma)))


@jax.jit
def _costs(starts: Float[Array, "n 4 4"], inputs: FrameInput, sigma: Float[Array, "6"]) -> Float[Array, " n"]:
    def one(T_start: Array) -> Array:
        return align(T_start, evidence_from(T_start, inputs, _VIEW), Prior(T_start, sigma), _ALIGN).cost

    return in_chunks(one, starts, 32)
