"""Brightness and white balance of all cameras of a vehicle, in one least squares (room: perception; host).

In: what several cameras see of the same places of the road. Out: ColourBalance, a gain and an offset for each camera
and channel.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

_GAIN_SIGMA, _OFFSET_SIGMA = 0.25, 12.0
"""How far cameras of one car differ; they hold what the overlaps leave open. Ours."""
_NOISE, _WORTH = 6.0, 200.0
"""Grey levels by which two cameras differ at the same place of the road, and how many independent places there are."""
_DARKEST, _BRIGHTEST = 4, 250
_NUM_ROUNDS = 4
_GAUGE = 1e6
"""Weight of what no overlap tells: the gains are one on average, the offsets zero."""


@dataclass(frozen=True)
class ColourBalance:
    """Grey values that all cameras agree on: gain x value + offset.

    Attributes:
        gain: float64[n 3], by camera and channel.
        offset: float64[n 3], in grey levels 0 ... 255.
    """

    gain: Float[np.ndarray, "n 3"]
    offset: Float[np.ndarray, "n 3"]

    @classmethod
    def none(cls, num_cameras: int) -> "ColourBalance":
        """Pictures as they are."""
        return cls(np.ones((num_cameras, 3)), np.zeros((num_cameras, 3)))

    def towards(self, other: "ColourBalance", share: float) -> "ColourBalance":
        """This one moved towards another by a share: what keeps a film from flickering."""
        return ColourBalance(
            self.gain + share * (other.gain - self.gain), self.offset + share * (other.offset - self.offset)
        )

    def applied(self, image: UInt8[np.ndarray, "h w 3"], camera: int) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a camera with its gains and offsets."""
        values = np.arange(256.0)[:, None] * self.gain[camera] + self.offset[camera]
        return cv2.LUT(image, np.clip(np.round(values), 0, 255).astype(np.uint8)[None])


def balance_of(values: Float[np.ndarray, "m n 3"], seen: Bool[np.ndarray, "m n"]) -> ColourBalance:
    """Gains and offsets under which cameras agree on what they see of the same places.

    Solves min sum over places and pairs of cameras of rho(g_i I_i + o_i - g_j I_j - o_j) + priors (g = 1, o = 0), where
    rho is Cauchy's loss: what stands up looks different from two sides and must not count.

    Args:
        values: grey value of each camera at each place.
        seen: whether the camera sees the place.
    """
    num = values.shape[1]
    usable = seen & ((values > _DARKEST) & (values < _BRIGHTEST)).all(axis=2)
    pairs = [(i, j) for i in range(num) for j in range(i + 1, num)]
    rows = [(i, j, np.flatnonzero(usable[:, i] & usable[:, j])) for i, j in pairs]
    rows = [(i, j, at) for i, j, at in rows if len(at) > 20]
    if not rows:
        return ColourBalance.none(num)
    solved = [_solve(values[:, :, channel], rows, num) for channel in range(3)]
    return ColourBalance(np.stack([s[:num] for s in solved], axis=1), np.stack([s[num:] for s in solved], axis=1))


def _solve(values: np.ndarray, rows: list[tuple[int, int, np.ndarray]], num: int) -> np.ndarray:
    """Gains, then offsets of one channel, float64[2 n]."""
    prior = np.diag(np.repeat([_GAIN_SIGMA**-2, _OFFSET_SIGMA**-2], num))
    prior += _GAUGE * np.kron(np.eye(2), np.full((num, num), 1.0 / num))
    start = np.repeat([1.0, 0.0], num)
    found = start
    for _ in range(_NUM_ROUNDS):
        H, b = prior.copy(), prior @ start
        for i, j, at in rows:
            J = np.zeros((len(at), 2 * num))
            J[:, i], J[:, num + i], J[:, j], J[:, num + j] = values[at, i], 1.0, -values[at, j], -1.0
            off = J @ found / _NOISE
            # Neighbouring pixels say the same: a pair of cameras counts as so many places, however many were read.
            weight = min(1.0, _WORTH / len(at)) / (_NOISE**2 * (1.0 + off**2))
            H += J.T @ (weight[:, None] * J)
        found = np.linalg.solve(H, b)
    return found
