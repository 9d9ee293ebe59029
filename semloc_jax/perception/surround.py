"""Masks of all cameras as one top view of the road plane: inverse perspective mapping (room: perception; host).

In: class ids of every camera, the rig. Out: class ids of the top view, 255 where no camera shows the road.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from semloc_jax.cameras import BevCamera, Rig
from semloc_jax.cameras.bev import T_base_bev
from semloc_jax.errors import SemlocError
from semloc_jax.perception.class_table import UNLABELED_ID, ClassTable
from semloc_jax.structs import ElementClass

PAINT = frozenset(label for label in ElementClass if label <= ElementClass.SPEED_BUMP)
"""What lies flat on the road; everything else is drawn out by inverse perspective mapping."""
UPRIGHT_WORDS = ("building", "wall", "fence", "vegetation", "sky", "mountain", "tunnel", "barrier", "bridge")
"""Names of background that stands upright and so hides the road behind it."""


@dataclass(frozen=True)
class SurroundView:
    """Which pixel of which camera shows each pixel of the top view; made once for a rig."""

    image_uv: tuple[np.ndarray, ...]
    """Image pixel of each top-view pixel for each camera, float32[h w 2]; far outside where not visible."""
    order: np.ndarray
    """Cameras of each top-view pixel, the one with the finest view of the road first, int[n h w]."""

    @classmethod
    def of(cls, rig: Rig, bev: BevCamera, T_base_bev: np.ndarray, max_pixel_m: float = 0.4) -> "SurroundView":
        """The tables of a rig.

        Args:
            rig: The cameras of the masks.
            bev: The top view.
            T_base_bev: Its pose in the base frame; its plane z = 0 is the road.
            max_pixel_m: Where one pixel of a camera covers more road than this in any direction, it is not used [m].
        """
        width, height = bev.resolution
        grid = np.stack(np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)), axis=-1)
        p_bev = np.asarray(bev.unproject(grid)[0], dtype=np.float64)
        p_base = p_bev @ T_base_bev[:3, :3].T + T_base_bev[:3, 3]
        tables, fineness = [], []
        for camera, T_base_cam in zip(rig.cameras, np.asarray(rig.T_base_cam, dtype=np.float64), strict=True):
            uv, valid = (np.array(part) for part in camera.project((p_base - T_base_cam[:3, 3]) @ T_base_cam[:3, :3]))
            px_per_m = _finest_detail(uv) * float(bev.fx)
            seen = valid & np.asarray(camera.in_image(uv[..., 0], uv[..., 1])) & (px_per_m * max_pixel_m > 1.0)
            uv[~seen] = -1e4
            tables.append(uv.astype(np.float32))
            fineness.append(np.where(seen, px_per_m, 0.0))
        return cls(tuple(tables), np.argsort(-np.stack(fineness), axis=0, kind="stable"))

    def stitch(self, masks: Sequence[np.ndarray], hidden_ids: Sequence[int] = ()) -> np.ndarray:
        """Class ids of the top view, uint8[h w].

        Where an object hides the road from the finest camera, the next one is used.

        Args:
            masks: Class ids uint8[h w] of every camera, in the order of the rig.
            hidden_ids: Ids of what hides the road: the own car, other road users, everything upright.

        Raises:
            SemlocError: the number of masks is not that of the cameras.
        """
        if len(masks) != len(self.image_uv):
            raise SemlocError(
                f"top view: given {len(masks)} masks; expected one for each of {len(self.image_uv)} cameras"
            )
        shown = np.arange(256, dtype=np.uint8)
        shown[list(hidden_ids)] = UNLABELED_ID
        top = np.stack([_looked_up(cv2.LUT(m, shown), uv) for m, uv in zip(masks, self.image_uv, strict=True)])
        ranked = np.take_along_axis(top, self.order, axis=0)
        stitched = ranked[0]
        for next_best in ranked[1:]:
            stitched = np.where(stitched == UNLABELED_ID, next_best, stitched)
        return stitched


def stitch_masks(
    masks: Sequence[np.ndarray],
    rig: Rig,
    bev: BevCamera,
    T_base_bev: np.ndarray,
    hidden_ids: Sequence[int] = (),
    height_m: float = 0.0,
) -> np.ndarray:
    """Class ids of one top view, uint8[h w]; for many frames keep a `SurroundView`.

    Args:
        masks: Class ids uint8[h w] of every camera, in the order of the rig.
        rig: Their cameras.
        bev: The top view.
        T_base_bev: Its pose in the base frame.
        hidden_ids: Ids of what hides the road; they become 255.
        height_m: Height of the road above the plane of the top view [m].
    """
    road = np.array(T_base_bev, dtype=np.float64)
    road[:3, 3] -= height_m * road[:3, 2]  # z of `bev` points down
    return SurroundView.of(rig, bev, road).stitch(masks, hidden_ids)


def top_view(rig: Rig, range_m: float = 9.0, metres_per_px: float = 0.025) -> tuple[BevCamera, np.ndarray]:
    """A square top view around the middle of the cameras, and its pose T_base_bev [4 4] on the plane of the road.

    Args:
        rig: The cameras.
        range_m: Half of its side [m].
        metres_per_px: Size of its pixels [m].
    """
    T = T_base_bev()
    T[:2, 3] = np.asarray(rig.T_base_cam)[:, :2, 3].mean(axis=0)
    return BevCamera.covering(range_m, range_m, range_m, range_m, metres_per_px), T


def ground_table(table: ClassTable) -> ClassTable:
    """The class table of top views: only paint has channels; what stands upright is ignored.

    Raises:
        SemlocError: the table has no paint.
    """
    flat = tuple(channel for channel in table.channels if PAINT.issuperset(channel.classes))
    if not flat:
        raise SemlocError(
            f"top view: class table {table.name} has no paint on the road (channels: "
            f"{', '.join(channel.name for channel in table.channels)}); use the masks without 'ipm:'"
        )
    upright = {number for channel in table.channels if channel not in flat for number in channel.mask_ids}
    named = {number for number, name in table.id_names.items() if any(word in name for word in UPRIGHT_WORDS)}
    flat_ids = {number for channel in flat for number in channel.mask_ids}
    hidden = (upright | named) - flat_ids - {*table.dynamic_ids, *table.ego_ids}
    return replace(table, channels=flat, ignore_ids=tuple(sorted({*table.ignore_ids, *hidden})))


def _finest_detail(uv: np.ndarray) -> np.ndarray:
    """Smaller singular value of the map from top-view pixels to image pixels: image pixels in the worst direction."""
    du, dv = np.gradient(uv, axis=1), np.gradient(uv, axis=0)
    square = np.sum(du * du + dv * dv, axis=-1)
    area = np.abs(du[..., 0] * dv[..., 1] - du[..., 1] * dv[..., 0])
    return np.sqrt(np.maximum(square - np.sqrt(np.maximum(square**2 - 4.0 * area**2, 0.0)), 0.0) / 2.0)


def _looked_up(mask: np.ndarray, uv: np.ndarray) -> np.ndarray:
    return cv2.remap(mask, uv, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=UNLABELED_ID)
