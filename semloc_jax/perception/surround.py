"""All cameras as one top view of the road plane: inverse perspective mapping (room: perception; host).

In: pictures or class ids of every camera, the rig. Out: the top view; class ids are 255 where no camera shows the road.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np

from semloc_jax.cameras import BevCamera, Rig
from semloc_jax.cameras.bev import T_base_bev
from semloc_jax.errors import SemlocError
from semloc_jax.perception.class_table import UNLABELED_ID, ClassTable
from semloc_jax.perception.colour_balance import ColourBalance
from semloc_jax.perception.picture_stitch import PictureStitch
from semloc_jax.perception.view_tables import SEAM_SIGMA_M, Blend, Car, camera_table, own_car, seam_weights
from semloc_jax.structs import ElementClass

PAINT = frozenset(label for label in ElementClass if label <= ElementClass.SPEED_BUMP)
"""What lies flat on the road; everything else is drawn out by inverse perspective mapping."""
UPRIGHT_WORDS = ("building", "wall", "fence", "vegetation", "sky", "mountain", "tunnel", "barrier", "bridge")
"""Names of background that stands upright and so hides the road behind it."""


@dataclass(frozen=True)
class SurroundView:
    """Which pixel of which camera shows each pixel of the top view; made once for a rig.

    >>> view = sj.SurroundView.around(rig, size_m=10.0, metres_per_px=0.02)
    >>> view.stitch(images).shape, view.stitch(masks, hidden_ids=(7, 8)).shape
    ((500, 500, 3), (500, 500))
    """

    image_uv: tuple[np.ndarray, ...]
    """Image pixel of each top-view pixel for each camera, float32[h w 2]; far outside where not visible."""
    order: np.ndarray
    """Cameras of each top-view pixel, the one with the finest view of the road first, int[n h w]."""
    bev: BevCamera
    """The top view as a camera."""
    T_base_bev: np.ndarray
    """Its pose, float64[4 4]."""
    resolutions: tuple[tuple[int, int], ...] = field(repr=False)
    """Width and height of the image of each camera [px]."""
    blend: Blend = "gaussian"
    """How pictures meet at the seams."""

    @classmethod
    def around(
        cls,
        rig: Rig,
        size_m: float = 12.0,
        metres_per_px: float = 0.012,
        blend: Blend = "gaussian",
        own_body: Sequence[np.ndarray | None] = (),
        own_car_m: Car | None = None,
    ) -> "SurroundView":
        """The square top view around the middle of the cameras, with the own car left blank.

        Args:
            rig: The cameras of the pictures.
            size_m: Its side [m].
            metres_per_px: Size of its pixels [m].
            blend: How pictures meet at the seams.
            own_body: For each camera bool[h w], True where its picture shows the own car.
            own_car_m: Rear, front, right and left end of the car [m]; None takes the rectangle of the cameras.
        """
        bev, T = top_view(rig, 0.5 * size_m, metres_per_px)
        return cls.of(rig, bev, T, blend=blend, own_car_m=own_car_m or own_car(rig), own_body=own_body)

    @classmethod
    def of(
        cls,
        rig: Rig,
        bev: BevCamera,
        T_base_bev: np.ndarray,
        max_pixel_m: float = 0.4,
        blend: Blend = "gaussian",
        own_car_m: Car | None = None,
        own_body: Sequence[np.ndarray | None] = (),
    ) -> "SurroundView":
        """The tables of a rig.

        Args:
            rig: The cameras of the pictures.
            bev: The top view.
            T_base_bev: Its pose in the base frame; its plane z = 0 is the road.
            max_pixel_m: Where one pixel of a camera covers more road than this in any direction, it is not used [m].
            blend: How pictures meet at the seams.
            own_car_m: Rear, front, right and left end of the own car in the base frame [m], which is left blank; see
                `own_car`. None shows what the cameras see there.
            own_body: For each camera bool[h w], True where its picture shows the own car; None where nothing is known.
        """
        p_base = _places(bev, T_base_bev)
        bodies = tuple(own_body) or (None,) * len(rig)
        least_detail = 1.0 / (float(bev.fx) * max_pixel_m)
        tables, fineness = zip(
            *(
                camera_table(camera, np.asarray(T_base_cam, np.float64), p_base, own_car_m, body, least_detail)
                for camera, T_base_cam, body in zip(rig.cameras, rig.T_base_cam, bodies, strict=True)
            ),
            strict=True,
        )
        sizes = tuple(camera.resolution for camera in rig.cameras)
        order = np.argsort(-np.stack(fineness), axis=0, kind="stable")
        return cls(tables, order, bev, np.asarray(T_base_bev, np.float64), sizes, blend)

    @property
    def metres_per_px(self) -> float:
        """Size of a pixel of the top view [m]."""
        return 1.0 / float(self.bev.fx)

    def pixels(self, xy_base: np.ndarray) -> np.ndarray:
        """Pixels of the top view, float64[n 2], of places on the road [m] in the base frame."""
        T = self.T_base_bev
        p_bev = (np.column_stack([xy_base, np.zeros(len(xy_base))]) - T[:3, 3]) @ T[:3, :3]
        return p_bev[:, :2] * float(self.bev.fx) + [float(self.bev.cx), float(self.bev.cy)]

    @cached_property
    def seen(self) -> np.ndarray:
        """Whether each camera sees each pixel of the top view, bool[n h w]."""
        return np.stack([uv[..., 0] > -1e3 for uv in self.image_uv])

    @cached_property
    def weights(self) -> np.ndarray:
        """Weight of each camera at each pixel, float32[n h w]; they sum to one where any camera sees the road."""
        return seam_weights(self.seen, self.order[0], self.blend, SEAM_SIGMA_M / self.metres_per_px)

    @cached_property
    def pictures(self) -> PictureStitch:
        """The tables for colour pictures."""
        return PictureStitch.of(self.image_uv, self.weights, self.resolutions)

    def balance(self, images: Sequence[np.ndarray]) -> ColourBalance:
        """Gains and white balance under which all cameras agree in the overlaps.

        Args:
            images: uint8[h w 3] of every camera, in the order of the rig.
        """
        self._check(images)
        return self.pictures.balance(images)

    def stitch(
        self,
        pictures: Sequence[np.ndarray],
        hidden_ids: Sequence[int] = (),
        balance: ColourBalance | None = None,
        height_aware: bool = False,
    ) -> np.ndarray:
        """The top view of pictures uint8[h w 3] or of class ids uint8[h w].

        Pictures are blended across the seams and black where no camera sees the road. Class ids are never mixed: where
        an object hides the road from the finest camera, the next one is used, and 255 means that none shows it.

        Args:
            pictures: Of every camera, in the order of the rig.
            hidden_ids: Ids of what hides the road: the own car, other road users, everything upright.
            balance: Gains of the cameras; None finds them in these pictures.
            height_aware: Where two cameras contradict each other, since something stands up there, the better one is
                shown alone: no ghosts.

        Raises:
            SemlocError: the number or size of the pictures is not that of the cameras.
        """
        self._check(pictures)
        if pictures[0].ndim == 3:
            return self.pictures.stitch(pictures, balance or self.balance(pictures), height_aware)
        shown = np.arange(256, dtype=np.uint8)
        shown[list(hidden_ids)] = UNLABELED_ID
        top = np.stack([_looked_up(cv2.LUT(m, shown), uv) for m, uv in zip(pictures, self.image_uv, strict=True)])
        ranked = np.take_along_axis(top, self.order, axis=0)
        stitched = ranked[0]
        for next_best in ranked[1:]:
            stitched = np.where(stitched == UNLABELED_ID, next_best, stitched)
        return stitched

    def _check(self, pictures: Sequence[np.ndarray]) -> None:
        what = "masks" if len(pictures) and pictures[0].ndim == 2 else "pictures"
        if len(pictures) != len(self.image_uv):
            raise SemlocError(
                f"top view: given {len(pictures)} {what}; expected one for each of {len(self.image_uv)} cameras, in "
                "the order of the calibration"
            )
        for index, (picture, size) in enumerate(zip(pictures, self.resolutions, strict=False)):
            if (picture.shape[1], picture.shape[0]) != size and picture.ndim == 3:
                raise SemlocError(
                    f"top view: picture {index} has {picture.shape[1]}x{picture.shape[0]} px; the calibration says "
                    f"{size[0]}x{size[1]}; give pictures of that size, or resize the camera (Camera.resized)"
                )


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


def _places(bev: BevCamera, T_base_bev: np.ndarray) -> np.ndarray:
    """Point of the road in the base frame that each pixel of the top view shows [m], float64[h w 3]."""
    width, height = bev.resolution
    grid = np.stack(np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)), axis=-1)
    return np.asarray(bev.unproject(grid)[0], dtype=np.float64) @ T_base_bev[:3, :3].T + T_base_bev[:3, 3]


def _looked_up(mask: np.ndarray, uv: np.ndarray) -> np.ndarray:
    return cv2.remap(mask, uv, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=UNLABELED_ID)
