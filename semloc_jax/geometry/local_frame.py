"""A frame near the vehicle in which float32 is exact enough (room: geometry; numpy only).

In: poses and points of the `map` frame, float64. Out: the same in the `local` frame, float32, and back.
Maps may lie at UTM coordinates of millions of metres, where float32 has steps of half a metre.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from semloc_jax.errors import SemlocError


@dataclass(frozen=True, eq=False)
class LocalFrame:
    """The `local` frame: the axes of `map` with the origin moved to `origin_map`.

    Only positions differ between both frames. Rotations, tangents of the vehicle (right perturbation) and with them
    covariances and the sigmas of priors are the same in both and need no conversion.

    Attributes:
        origin_map: origin of the local frame in the map frame [m].
    """

    origin_map: Float[np.ndarray, "3"]

    def __post_init__(self) -> None:
        origin = np.array(self.origin_map, dtype=np.float64)
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise SemlocError(f"local frame at {self.origin_map}: expected three finite coordinates [m] in the map")
        origin.setflags(write=False)
        object.__setattr__(self, "origin_map", origin)

    def from_map(self, in_map: Any, dtype: Any = np.float32) -> np.ndarray:
        """Poses T_local_base `[* 4 4]` of T_map_base, or points p_local `[* 3]` (`[* 2]`: x and y) of p_map [m].

        The difference is taken in float64 and rounded to `dtype` once.
        """
        return self._moved(in_map, -self.origin_map).astype(dtype)

    def to_map(self, local: Any) -> np.ndarray:
        """Poses T_map_base `[* 4 4]` of T_local_base, or points p_map `[* 3]` (`[* 2]`: x and y) of p_local [m].

        The result is float64. The rotation is unchanged: one that was computed in float32 is a rotation to 1e-7 only.
        """
        return self._moved(local, self.origin_map)

    @staticmethod
    def _moved(given: Any, offset: np.ndarray) -> np.ndarray:
        moved = np.array(given, dtype=np.float64)
        if moved.shape[-2:] == (4, 4):
            moved[..., :3, 3] += offset
        elif moved.shape[-1:] in ((2,), (3,)):
            moved += offset[: moved.shape[-1]]
        else:
            raise SemlocError(f"local frame: array {moved.shape}; expected poses [* 4 4] or points [* 3], [* 2]")
        return moved
