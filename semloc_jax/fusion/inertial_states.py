"""The unknowns of a window of inertial states: their families, sizes and places (room: fusion; pure JAX).

In: a number of states. Out: where each unknown stands among all of them, and among those of one state.
"""

import numpy as np
from jaxtyping import Int

from semloc_jax.solvers.factors import POSE, vector
from semloc_jax.solvers.graph import Family

KINDS = {
    "pose": POSE,
    "height": vector(0.01),
    "bend": vector(5e-4),
    "velocity": vector(0.5, 0.5, 0.5),
    "bias": vector(0.005, 0.005, 0.005, 0.1, 0.1, 0.1),
    "scale": vector(0.02),
    "mount": vector(0.01, 0.01, 0.01),
    "delay": vector(0.005),
}
"""Pose in the map; height of the base over the road [m]; how the road there bends upwards [1/m]; velocity in the map
[m/s]; biases of gyroscope [rad/s] and accelerometer [m/s^2]; scale of the odometer; turn of the inertial sensor against
the base [rad]; its clock less that of the cameras [s]. Landmarks touch the first three only, which must stay the
first."""
SIZES = {name: kind.size for name, kind in KINDS.items()}
STATE = sum(SIZES.values())
"""Unknowns of one state."""
SEEN = SIZES["pose"] + SIZES["height"] + SIZES["bend"]
"""Of these, those that landmarks touch."""
_ENDS = np.cumsum([0, *SIZES.values()])
AT = {name: slice(int(start), int(end)) for name, start, end in zip(SIZES, _ENDS[:-1], _ENDS[1:], strict=True)}
"""Places of each family among the unknowns of one state."""


def families_of(num: int) -> tuple[Family, ...]:
    """The variables of so many states; their order is that of the unknowns."""
    return tuple(Family(name, kind, num) for name, kind in KINDS.items())


def unknowns_of(states: Int[np.ndarray, " k"], num: int) -> Int[np.ndarray, " d"]:
    """Places of all unknowns of the named states among those of a window of `num`."""
    found, start = [], 0
    for size in SIZES.values():
        found.append((start + states[:, None] * size + np.arange(size)).ravel())
        start += num * size
    return np.concatenate(found)
