"""Masks that are wrong for a whole drive (room: simulation; host).

In: Maker, the size of a fault. Out: FaultyDrive. What is drawn at random is seeded, for every frame anew.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from semloc_jax.datasets.base import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.simulation.faulty_drive import FaultyDrive, Maker, MaskChange, seen_through


def masks_through(maker: Maker, change: MaskChange) -> FaultyDrive:
    """The drive seen through one change of masks and images."""
    return maker.whole(drive=replace(maker.drive, frames=seen_through(maker.drive.frames, change, change)))


def masks_mirrored(maker: Maker, share: float) -> FaultyDrive:
    """Left and right exchanged in a share of the frames, drawn at random."""
    mirrored = seen_through(maker.drive.frames, lambda m: m[:, ::-1].copy(), lambda m: m[:, ::-1].copy())
    drawn = maker.rng.random(len(mirrored)) < share
    frames = [new if d else old for new, old, d in zip(mirrored, maker.drive.frames, drawn, strict=True)]
    return maker.whole(drive=replace(maker.drive, frames=tuple(frames)))


def masks_shifted(maker: Maker, size_px: float) -> FaultyDrive:
    """All masks lie to the right of what was seen."""
    return masks_through(maker, lambda mask: np.roll(mask, round(size_px), axis=1))


def masks_lost(maker: Maker, share: float) -> FaultyDrive:
    """Columns of the image, a share of its width, show what is seen most."""

    def lost(mask: np.ndarray) -> np.ndarray:
        out = mask.copy()
        width = round(share * mask.shape[1])
        out[:, (mask.shape[1] - width) // 2 :][:, :width] = np.bincount(mask.ravel()).argmax() if mask.ndim == 2 else 0
        return out

    return masks_through(maker, lost)


def own_lane_only(maker: Maker, share: float) -> FaultyDrive:
    """A traffic jam: beside the middle `share` of the image all is vehicles."""
    blocked = maker.drive.class_ids.get("vehicle", 255)

    def jam(mask: np.ndarray) -> np.ndarray:
        out = mask.copy()
        side = round(0.5 * (1.0 - share) * mask.shape[1])
        out[:, :side] = out[:, mask.shape[1] - side :] = blocked
        return out

    return masks_through(maker, jam)


def other_masks(maker: Maker, share: float) -> FaultyDrive:
    """Every frame has the masks and images of the one a share of the drive later, around the end to the begin."""
    frames, step = maker.drive.frames, max(round(share * len(maker.drive.frames)), 1)
    swapped = tuple(_OtherFrame.of(frame, frames[(k + step) % len(frames)]) for k, frame in enumerate(frames))
    return maker.whole(drive=replace(maker.drive, frames=swapped))


@dataclass(frozen=True)
class _OtherFrame(Frame):
    """A frame that shows what another one saw."""

    shown: Frame | None = None

    @classmethod
    def of(cls, frame: Frame, shown: Frame) -> "_OtherFrame":
        values = {name: getattr(frame, name) for name in Frame.__dataclass_fields__}
        return cls(**values, shown=shown)

    def image(self, camera: str) -> np.ndarray:
        """Image of the other frame."""
        return self.shown.image(camera)

    def mask(self, source: str, camera: str) -> np.ndarray:
        """Class ids of the other frame."""
        return self.shown.mask(source, camera)


def _each_frame(maker: Maker, make: Callable[[int], MaskChange | None]) -> FaultyDrive:
    """The drive with a change of its own for every frame, drawn from a seed; None leaves the frame as it is."""
    seeds = maker.rng.integers(0, 2**31, len(maker.drive.frames))
    frames = []
    for frame, seed in zip(maker.drive.frames, seeds, strict=True):
        change = make(int(seed))
        frames.append(frame if change is None else seen_through((frame,), change, change)[0])
    return maker.whole(drive=replace(maker.drive, frames=tuple(frames)))


def masks_shifted_down(maker: Maker, size_px: float) -> FaultyDrive:
    """All masks lie lower than what was seen."""
    return masks_through(maker, lambda mask: np.roll(mask, round(size_px), axis=0))


def _warped(mask: np.ndarray, A: np.ndarray) -> np.ndarray:
    size = mask.shape[1], mask.shape[0]
    return cv2.warpAffine(mask, A, size, flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)


def _about_middle(mask: np.ndarray, angle_deg: float, scale: float) -> np.ndarray:
    centre = 0.5 * (mask.shape[1] - 1), 0.5 * (mask.shape[0] - 1)
    return _warped(mask, cv2.getRotationMatrix2D(centre, angle_deg, scale))


def masks_scaled(maker: Maker, share: float) -> FaultyDrive:
    """A network that was fed a crop: its masks are larger than the image."""
    return masks_through(maker, lambda mask: _about_middle(mask, 0.0, 1.0 + share))


def masks_rotated(maker: Maker, size_deg: float) -> FaultyDrive:
    """The masks are turned about the middle of the image."""
    return masks_through(maker, lambda mask: _about_middle(mask, size_deg, 1.0))


def masks_trembling(maker: Maker, size_px: float) -> FaultyDrive:
    """A lens that is loose: every frame is shifted by an amount of its own."""

    def make(seed: int) -> MaskChange:
        du, dv = np.random.default_rng(seed).normal(0.0, size_px, 2)
        return lambda mask: _warped(mask, np.array([[1.0, 0.0, round(du)], [0.0, 1.0, round(dv)]]))

    return _each_frame(maker, make)


def masks_thin(maker: Maker, size_px: float) -> FaultyDrive:
    """Every class loses its border to its surroundings."""

    def thin(mask: np.ndarray) -> np.ndarray:
        ground = np.bincount(mask.ravel()).argmax()
        inside = cv2.erode((mask != ground).astype(np.uint8), _disc(size_px)) > 0
        return np.where(inside, mask, ground).astype(mask.dtype)

    return _masks_alone(maker, thin)


def masks_fat(maker: Maker, size_px: float) -> FaultyDrive:
    """Every class grows over its surroundings."""

    def fat(mask: np.ndarray) -> np.ndarray:
        ground = np.bincount(mask.ravel()).argmax()
        grown = cv2.dilate(np.where(mask == ground, 0, mask), _disc(size_px))
        return np.where((mask == ground) & (grown > 0), grown, mask).astype(mask.dtype)

    return _masks_alone(maker, fat)


def _disc(size_px: float) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(size_px) + 1,) * 2)


def _masks_alone(maker: Maker, change: MaskChange) -> FaultyDrive:
    """The drive with other masks of the same images."""
    return maker.whole(drive=replace(maker.drive, frames=seen_through(maker.drive.frames, change)))


def masks_spotted(maker: Maker, share: float) -> FaultyDrive:
    """Blobs of a class that the image holds cover a share of it, at other places in every frame."""

    def make(seed: int) -> MaskChange:
        def spotted(mask: np.ndarray) -> np.ndarray:
            rng, out = np.random.default_rng(seed), mask.copy()
            radius = max(round(0.02 * mask.shape[1]), 1)
            classes = np.unique(mask) if mask.ndim == 2 else np.array([0, 255])
            for _ in range(round(share * mask.shape[0] * mask.shape[1] / (np.pi * radius**2))):
                centre = int(rng.integers(mask.shape[1])), int(rng.integers(mask.shape[0]))
                value = int(rng.choice(classes))
                cv2.circle(out, centre, radius, value if mask.ndim == 2 else (value,) * 3, -1)
            return out

        return spotted

    return _each_frame(maker, make)


def masks_blinking(maker: Maker, share: float) -> FaultyDrive:
    """A share of the frames, drawn at random, shows nothing."""

    def make(seed: int) -> MaskChange | None:
        if np.random.default_rng(seed).random() >= share:
            return None
        return lambda mask: np.full_like(mask, np.bincount(mask.ravel()).argmax())

    return _each_frame(maker, make)


def paint_lost(maker: Maker, share: float) -> FaultyDrive:
    """Pieces of the paint are not seen: a share of it, at other places in every frame."""
    paint = [value for name, value in maker.drive.class_ids.items() if name in _PAINT]
    ground = maker.drive.class_ids.get("road")
    if ground is None or not paint:
        raise SemlocError(f"fault '{maker.name}': drive {maker.drive.name} does not name road and paint in its masks")

    def make(seed: int) -> MaskChange:
        def worn(mask: np.ndarray) -> np.ndarray:
            if mask.ndim != 2:
                return mask
            coarse = np.random.default_rng(seed).random((mask.shape[0] // 16 + 1, mask.shape[1] // 16 + 1)) < share
            is_lost = np.kron(coarse, np.ones((16, 16), bool))[: mask.shape[0], : mask.shape[1]]
            return np.where(is_lost & np.isin(mask, paint), ground, mask).astype(mask.dtype)

        return worn

    return _each_frame(maker, make)


def false_lines(maker: Maker, size_px: float) -> FaultyDrive:
    """Every line is seen a second time beside itself, as skid marks and old paint are."""
    paint = [value for name, value in maker.drive.class_ids.items() if name in _PAINT]

    def doubled(mask: np.ndarray) -> np.ndarray:
        beside = np.roll(mask, round(size_px), axis=1)
        return np.where(np.isin(beside, paint), beside, mask).astype(mask.dtype)

    return _masks_alone(maker, doubled)


_PAINT = {"lane_solid", "lane_dashed", "stop_line", "crosswalk", "arrow", "slot_line"}
"""Names of paint in masks."""
