"""Colour pictures of all cameras as one top view, fast (room: perception; host).

In: where each pixel of the top view lies in each picture, weights of the cameras. Out: the blended top view.
All pictures and their halved copies are laid into one atlas, so that one lookup serves all cameras without aliasing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.perception.colour_balance import ColourBalance, balance_of
from semloc_jax.perception.view_tables import strongest_two

_NUM_LEVELS = 4
_ROW = 1024
"""Pixels in overlaps are looked up in rows of this many: OpenCV wants pictures."""
_LEAST_SHARE = 1.0 / 255.0
_NUM_PLACES = 3000
_CONTRADICTION = (14.0, 34.0)
"""Mean grey levels by which two cameras differ: agreed below, something stands up above. Ours."""
_COARSE = 8
Maps = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class PictureStitch:
    """Lookups of one top view in the atlas of all pictures."""

    slots: tuple[tuple[int, int, int, int, int, int], ...]
    """Pieces of the atlas: camera, level, left, top, width, height [px]."""
    atlas_size: tuple[int, int]
    """Width and height of the atlas [px]."""
    first: Maps
    """Where the camera that counts most shows each pixel, in OpenCV's fixed point."""
    second: Maps
    """The same of the second camera for the pixels in overlaps, in rows."""
    at: np.ndarray
    """Numbers of these pixels in the top view, int[k]."""
    share: np.ndarray
    """Their share of the second camera, float32[k]."""
    unseen: np.ndarray
    """Numbers of the pixels that no camera sees, int[l]."""
    shape: tuple[int, int]
    places_uv: np.ndarray
    """Pixels of places in the overlaps in each picture halved twice, float32[n m 2]; for the colours."""
    places_seen: np.ndarray
    """Whether the camera sees the place, bool[m n]."""
    coarse: tuple[np.ndarray, np.ndarray]
    """Atlas pixels of both cameras on every eighth pixel of the top view, float32[h/8 w/8 2]; second -1e4: none."""

    @classmethod
    def of(
        cls, image_uv: Sequence[np.ndarray], weights: np.ndarray, resolutions: Sequence[tuple[int, int]]
    ) -> "PictureStitch":
        """The lookups.

        Args:
            image_uv: image pixel of each top-view pixel for each camera, float32[h w 2].
            weights: of each camera, float32[n h w].
            resolutions: width and height of each picture [px].
        """
        levels = [_level(uv) for uv in image_uv]
        seen = weights.sum(axis=0) > 0
        used = [int(level[seen].max(initial=0)) for level in levels]
        slots, size = _laid_out(resolutions, used)
        uv_atlas = np.stack(
            [
                _in_atlas(uv, level, camera, slots)
                for camera, (uv, level) in enumerate(zip(image_uv, levels, strict=True))
            ]
        )
        pair, share = strongest_two(weights)
        first, second = (np.take_along_axis(uv_atlas, row[None, ..., None], axis=0)[0] for row in pair)
        mixed = share > _LEAST_SHARE
        at = np.flatnonzero(mixed)
        rows = np.full(((len(at) // _ROW + 1) * _ROW, 2), -10.0, np.float32)
        rows[: len(at)] = second.reshape(-1, 2)[at]
        first[~seen] = -10.0
        second_coarse = np.where(mixed[..., None], second, -1e4)[::_COARSE, ::_COARSE]
        uv, visible = _places(image_uv, weights.shape[1:])
        return cls(
            slots,
            size,
            _fixed(first),
            _fixed(rows.reshape(-1, _ROW, 2)),
            at,
            share.ravel()[at],
            np.flatnonzero(~seen),
            weights.shape[1:],
            uv,
            visible,
            (first[::_COARSE, ::_COARSE].copy(), second_coarse.astype(np.float32)),
        )

    def balance(self, images: Sequence[np.ndarray]) -> ColourBalance:
        """Gains under which the pictures agree in the overlaps."""
        if not len(self.places_seen):
            return ColourBalance.none(len(images))
        values = np.zeros((*self.places_seen.shape, 3))
        for camera, image in enumerate(images):
            small = cv2.resize(image, (image.shape[1] // 4, image.shape[0] // 4), interpolation=cv2.INTER_AREA)
            uv = self.places_uv[camera][None]
            values[:, camera] = cv2.remap(small, uv, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
        return balance_of(values, self.places_seen)

    def stitch(self, images: Sequence[np.ndarray], balance: ColourBalance, height_aware: bool = False) -> np.ndarray:
        """The top view uint8[h w 3], black where no camera sees the road."""
        atlas = self._atlas(images, balance)
        top = cv2.remap(atlas, *self.first, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        flat = top.reshape(-1, 3)
        flat[self.unseen] = 0
        if len(self.at):
            other = cv2.remap(atlas, *self.second, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
            share = self.share if not height_aware else self.share * (1.0 - self._contradicted(atlas))
            mine, other = flat[self.at][None], other.reshape(-1, 3)[: len(self.at)][None]
            flat[self.at] = cv2.blendLinear(mine, other, (1.0 - share)[None], share[None])[0]
        return top

    def _atlas(self, images: Sequence[np.ndarray], balance: ColourBalance) -> np.ndarray:
        atlas = np.zeros((self.atlas_size[1], self.atlas_size[0], 3), np.uint8)
        halved: dict[int, np.ndarray] = {}
        for camera, level, left, top, width, height in self.slots:
            if level == 0:
                halved[camera] = balance.applied(images[camera], camera)
            else:
                halved[camera] = cv2.resize(halved[camera], (width, height), interpolation=cv2.INTER_AREA)
            atlas[top : top + height, left : left + width] = halved[camera]
        return atlas

    def _contradicted(self, atlas: np.ndarray) -> np.ndarray:
        """How surely two cameras show different things at the pixels in overlaps, float32[k] 0 ... 1."""
        one, other = (cv2.remap(atlas, uv, None, cv2.INTER_LINEAR).astype(np.float32) for uv in self.coarse)
        known = (self.coarse[1][..., 0] > -1e3).astype(np.float32)
        apart = np.abs(one - other).mean(axis=2) * known
        # A wrong mount by a few centimetres makes thin lines differ: only what differs over a patch stands up.
        apart = cv2.blur(apart, (3, 3)) / np.maximum(cv2.blur(known, (3, 3)), 1e-3)
        low, high = _CONTRADICTION
        surely = cv2.dilate(np.clip((apart - low) / (high - low), 0.0, 1.0), np.ones((3, 3)))
        return cv2.resize(surely, self.shape[::-1], interpolation=cv2.INTER_LINEAR).ravel()[self.at]


def _level(uv: np.ndarray) -> np.ndarray:
    """Halvings after which one image pixel is about one top-view pixel, by the shorter side of the footprint."""
    steps = [np.linalg.norm(np.gradient(uv, axis=axis), axis=-1) for axis in (0, 1)]
    shorter = np.where(uv[..., 0] > -1e3, np.minimum(*steps), 1.0)
    return np.clip(np.floor(np.log2(np.clip(shorter, 1e-3, 1e3)) + 0.5), 0, _NUM_LEVELS - 1).astype(int)


def _laid_out(
    resolutions: Sequence[tuple[int, int]], levels: Sequence[int]
) -> tuple[tuple[tuple[int, int, int, int, int, int], ...], tuple[int, int]]:
    """A strip for each camera: its picture, and its halved copies beside it."""
    slots, top, widest = [], 0, 0
    for camera, ((width, height), last) in enumerate(zip(resolutions, levels, strict=True)):
        left = 0
        for level in range(last + 1):
            own = max(width >> level, 1), max(height >> level, 1)
            slots.append((camera, level, left, top, *own))
            left += own[0]
        top, widest = top + height, max(widest, left)
    return tuple(slots), (widest, top)


def _in_atlas(uv: np.ndarray, level: np.ndarray, camera: int, slots: Sequence[tuple]) -> np.ndarray:
    """Atlas pixel of each top-view pixel, float32[h w 2]; a lookup never reaches into a neighbouring piece."""
    found = np.full(uv.shape, -10.0, np.float32)
    seen = uv[..., 0] > -1e3
    for own, depth, left, top, width, height in slots:
        if own != camera:
            continue
        here = seen & (level == depth)
        scaled = (uv[here] + 0.5) / 2**depth - 0.5
        found[here] = np.clip(scaled, 0.0, (width - 1.0, height - 1.0)) + (left, top)
    return found


def _fixed(uv: np.ndarray) -> Maps:
    return cv2.convertMaps(np.ascontiguousarray(uv), None, cv2.CV_16SC2)


def _places(image_uv: Sequence[np.ndarray], shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Places that two cameras see, on an even grid: their pixels in pictures halved twice, and who sees them."""
    seen = np.stack([uv[..., 0] > -1e3 for uv in image_uv])
    both = np.flatnonzero(seen.sum(axis=0) > 1)
    step = max(len(both) // _NUM_PLACES, 1)
    chosen = both[::step]
    uv = np.stack([(table.reshape(-1, 2)[chosen] + 0.5) / 4.0 - 0.5 for table in image_uv]).astype(np.float32)
    return uv, seen.reshape(len(seen), -1)[:, chosen].T
