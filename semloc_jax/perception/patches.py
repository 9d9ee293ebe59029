"""What a corner looked like when it was found, laid over later images (room: perception; host).

In: a grey image, corners uv. Out: Patches; the same corners in a later image, by what all of the patch shows.
Followed from image to image a corner slips by a third of a pixel each time, and slips add up. Here every image is
compared with the one in which the corner was found: inverse compositional alignment of an affine patch, free of gain
and offset of the light (Baker and Matthews, IJCV 2004; Evangelidis and Psarakis, PAMI 2008).
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

_HALF_PX = 8
"""A patch reaches so far to each side."""
_WEIGHTS_PX = 5.5, 2.0
"""Standard deviations of the weights of its pixels: of all of it, which tells how it is stretched, and of its middle,
which tells where the corner is. What is near the corner lies at its depth, and what of perspective no affine patch can
follow shifts all of it by the square of its size: of a patch on the road by 0.15 px in two images."""
_AFFINE_SIGMA = 0.15
"""How far one step may stretch or shear a patch; small patches tell it badly."""
_GREY_SIGMA = 0.1
"""Standard deviation of what a patch of unit contrast does not explain, for that."""
_NEAR_PX = 0.1
"""A corner that a second look moves by less is there; for the others a third one changes nothing beyond this."""
_LEAST_CONTRAST = 2.0
"""Grey levels (weighted standard deviation) that a patch needs."""
_LEAST_SQUARE = 1e-6
"""Of slopes: a patch that shows nothing goes nowhere."""


def _grid(half: int) -> Float[np.ndarray, "n 2"]:
    side = np.arange(-half, half + 1, dtype=np.float32)
    return np.stack(np.meshgrid(side, side, indexing="xy"), axis=-1).reshape(-1, 2)


_AT, _AROUND = _grid(_HALF_PX), _grid(_HALF_PX + 1)
_ROOT_WEIGHT, _MIDDLE = (np.exp(-0.25 * (_AT**2).sum(axis=1) / px**2).astype(np.float32) for px in _WEIGHTS_PX)
_MIDDLE_SHARE = _MIDDLE / _ROOT_WEIGHT
_ROOT_WEIGHT /= np.linalg.norm(_ROOT_WEIGHT)


class Patches(NamedTuple):
    """Patches of some corners, each as it was when it was cut out."""

    look: Float[np.ndarray, "s n"]
    """Weighted, without mean, of unit length."""
    gain: Float[np.ndarray, "s 6 n"]
    """Step of the affine part (row by row) and the shift by what a later image shows otherwise."""
    middle: Float[np.ndarray, "s 2 n"]
    """The same of the shift of its middle, when all of it has been stretched as `gain` tells."""
    affine: Float[np.ndarray, "s 2 2"]
    """From the patch to the image in which it was found last."""

    def at(self, rows: Int[np.ndarray, " k"]) -> "Patches":
        """Those of some slots."""
        return Patches(*(part[rows] for part in self))

    def put(self, rows: Int[np.ndarray, " k"], others: "Patches") -> None:
        """Other patches into some slots, in place: all of them are some megabytes."""
        for part, other in zip(self, others, strict=True):
            part[rows] = other


def no_patches(num: int) -> Patches:
    """Empty slots."""
    n = len(_AT)
    zeros = (np.zeros((num, *shape), np.float32) for shape in ((n,), (6, n), (2, n)))
    return Patches(*zeros, np.tile(np.eye(2, dtype=np.float32), (num, 1, 1)))


def cut_out(grey: UInt8[np.ndarray, "h w"], uv: Float[np.ndarray, "s 2"]) -> Patches:
    """The patches around corners [px]."""
    num, size, n = len(uv), 2 * _HALF_PX + 3, len(_AT)
    eye = np.tile(np.eye(2, dtype=np.float32), (num, 1, 1))
    around = _sampled(grey, uv, eye, _AROUND).reshape(num, size, size)
    look, length = _normalised(around[:, 1:-1, 1:-1].reshape(num, n))
    scale = 0.5 * _ROOT_WEIGHT / length[:, None]
    slopes = np.empty((num, 6, n), np.float32)
    slopes[:, 4] = (around[:, 1:-1, 2:] - around[:, 1:-1, :-2]).reshape(num, n) * scale
    slopes[:, 5] = (around[:, 2:, 1:-1] - around[:, :-2, 1:-1]).reshape(num, n) * scale
    for k in range(4):
        np.multiply(slopes[:, 4 + k // 2], _AT[:, k % 2], out=slopes[:, k])
    # What gain and offset of the light explain moves nothing.
    slopes -= (slopes @ _ROOT_WEIGHT)[..., None] * _ROOT_WEIGHT
    slopes -= (slopes @ look[..., None]) * look[:, None]
    prior = np.repeat([(_GREY_SIGMA / _AFFINE_SIGMA) ** 2, _LEAST_SQUARE], [4, 2])
    gain = _steps(slopes, prior)
    middle = _steps(slopes[:, 4:] * _MIDDLE_SHARE, np.full(2, _LEAST_SQUARE)) * _MIDDLE_SHARE
    middle -= (middle @ np.swapaxes(slopes[:, :4], 1, 2)) @ gain[:, :4]
    return Patches(look, gain, middle, eye)


def _steps(slopes: Float[np.ndarray, "s k n"], prior: Float[np.ndarray, " k"]) -> Float[np.ndarray, "s k n"]:
    """Least squares: the step that explains a difference best."""
    return np.linalg.inv(slopes @ np.swapaxes(slopes, 1, 2) + np.diag(prior).astype(np.float32)) @ slopes


class Found(NamedTuple):
    """Where patches are in a later image."""

    uv: Float[np.ndarray, "s 2"]
    """Of their middle."""
    affine: Float[np.ndarray, "s 2 2"]
    alike: Float[np.ndarray, " s"]
    """Correlation of the last look at it with the patch."""


def laid_over(patches: Patches, grey: UInt8[np.ndarray, "h w"], uv: Float[np.ndarray, "s 2"]) -> Found:
    """The corners in a later image, from places [px] a pixel or two off."""
    at = np.asarray(uv, np.float32)
    found, _ = _nearer(patches, grey, Found(at, patches.affine, np.zeros(len(at))), patches.gain[:, 4:])
    found, moved_px = _nearer(patches, grey, found, patches.middle)
    far = np.flatnonzero(moved_px > _NEAR_PX)
    again, _ = _nearer(patches.at(far), grey, Found(*(part[far] for part in found)), patches.middle[far])
    for part, other in zip(found, again, strict=True):
        part[far] = other
    return found


def _nearer(
    patches: Patches, grey: UInt8[np.ndarray, "h w"], found: Found, shifts: Float[np.ndarray, "s 2 n"]
) -> tuple[Found, Float[np.ndarray, " s"]]:
    """One look more: where the corners are by it, how alike it was, and how far they moved [px]."""
    seen = _normalised(_sampled(grey, found.uv, found.affine, _AT))[0]
    beyond = (seen - patches.look)[..., None]
    # The step moves the patch; its inverse moves the image.
    stretch = (patches.gain[:, :4] @ beyond).reshape(-1, 2, 2)
    affine = found.affine @ np.linalg.inv(np.eye(2, dtype=np.float32) + stretch)
    move = (affine @ (shifts @ beyond))[..., 0]
    alike = np.einsum("sn,sn->s", seen, patches.look)
    return Found(found.uv - move, affine, alike), np.linalg.norm(move, axis=1)


def _sampled(
    grey: UInt8[np.ndarray, "h w"],
    at: Float[np.ndarray, "s 2"],
    affine: Float[np.ndarray, "s 2 2"],
    grid: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "s n"]:
    """What an image shows where the points of a grid lie."""
    if not len(at):
        return np.zeros((0, len(grid)), np.float32)
    u, v = (np.asarray(at[:, k, None], np.float32) + affine[:, k] @ grid.T for k in range(2))
    return cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)


def _normalised(grey: Float[np.ndarray, "s n"]) -> tuple[Float[np.ndarray, "s n"], Float[np.ndarray, " s"]]:
    """Weighted, without mean, of unit length; and the length that it had [grey levels]."""
    weighted = grey * _ROOT_WEIGHT
    weighted = weighted - (weighted @ _ROOT_WEIGHT)[:, None] * _ROOT_WEIGHT
    length = np.maximum(np.linalg.norm(weighted, axis=1), _LEAST_CONTRAST)
    return weighted / length[:, None], length
