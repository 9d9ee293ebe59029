"""Textures that repeat: noise with a spectrum, looked up at places (room: simulation; host).

In: coordinates in cells. Out: values of zero mean and a spread of one.
"""

from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float

_SIDE = 512
"""Cells after which a texture repeats."""
_EXPONENT = {"grain": 0.0, "rough": 0.8, "cloud": 1.6}
"""Amplitude falls with frequency to this power."""


@lru_cache(maxsize=len(_EXPONENT))
def texture(kind: str) -> Float[np.ndarray, "n n"]:
    """The texture `grain` (every cell by itself), `rough` (some structure) or `cloud` (large shapes), float32."""
    rng = np.random.default_rng(sorted(_EXPONENT).index(kind))
    frequency = np.hypot(np.fft.fftfreq(_SIDE)[:, None], np.fft.rfftfreq(_SIDE)) * _SIDE
    filtered = np.fft.rfft2(rng.normal(size=(_SIDE, _SIDE))) * np.maximum(frequency, 1.0) ** -_EXPONENT[kind]
    filtered[0, 0] = 0.0
    plane = np.fft.irfft2(filtered, (_SIDE, _SIDE))
    return (plane / plane.std()).astype(np.float32)


def noise(kind: str, u: np.ndarray, v: np.ndarray) -> Float[np.ndarray, "*s"]:
    """Values of a texture at places of any shape.

    Args:
        kind: as for `texture`.
        u: place along its rows [cells].
        v: place along its columns [cells].
    """
    u, v = np.broadcast_arrays(u, v)
    if u.size == 0:
        return np.zeros(u.shape, np.float32)
    # OpenCV takes no more than 32,767 places in a row.
    side = int(np.ceil(np.sqrt(u.size)))
    at = [np.resize(np.mod(x, _SIDE).astype(np.float32), (side, side)) for x in (u, v)]
    found = cv2.remap(texture(kind), at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return found.ravel()[: u.size].reshape(u.shape)
