"""Projection of changing numbers of points (room: datasets; host).

In: a camera, points in its frame. Out: pixels.
"""

import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import Camera

_BATCH = 4096


def project(camera: Camera, p_cam: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Pixels of points in the camera frame; padded to few sizes, because JAX compiles anew for each size."""
    flat = p_cam.reshape(-1, 3)
    padded = np.tile([0.0, 0.0, 1.0], (-(-len(flat) // _BATCH) * _BATCH, 1))
    padded[: len(flat)] = flat
    uv = np.asarray(camera.project(padded)[0], dtype=np.float64)
    return uv[: len(flat)].reshape(*p_cam.shape[:-1], 2)
