"""A segmenter for road paint that needs no network (room: perception; host).

In: an image and, if known, its camera above the road. Out: class ids of the table `lane_paint` (1 is paint).
"""

import cv2
import numpy as np

from semloc_jax.cameras import Camera, PinholeCamera
from semloc_jax.errors import SemlocError
from semloc_jax.perception.class_table import UNLABELED_ID
from semloc_jax.perception.ground_view import GroundView
from semloc_jax.perception.paint_candidates import PaintCandidates, PaintConfig, find_candidates, paint_brightness
from semloc_jax.perception.paint_filter import keep_paint

PAINT_ID = 1
_MIN_COMPONENT_PX = 6
_GUESSED_HORIZON, _GUESSED_HEIGHT_M, _GUESSED_VIEW_DEG = 0.57, 1.4, 60.0


class ClassicalPaintSegmenter:
    """Lane lines, stop lines, crosswalk bars, arrows and letters of a plain image: image (BGR) -> class ids.

    The image is warped to the road plane, where all paint has the same size in any direction and any camera. Spots
    brighter than the road and narrower than a stroke are kept where the road around them is even and grey; their
    outline is then drawn in the image itself, halfway between the brightness of paint and road.
    """

    def __init__(
        self,
        camera: Camera | None = None,
        T_base_cam: np.ndarray | None = None,
        config: PaintConfig | None = None,
        hidden: np.ndarray | None = None,
    ) -> None:
        """A segmenter for one camera.

        Args:
            camera: the camera; None guesses a forward camera of 60 deg with the horizon at 57 % of the image height.
            T_base_cam: pose of the camera above the road (plane z = 0 of the base frame).
            config: None for the defaults.
            hidden: pixels that never show road (ego body), bool[h w]; they come out as 255.
        """
        if (camera is None) != (T_base_cam is None):
            raise SemlocError("paint segmenter: give both camera and T_base_cam, or neither to have them guessed")
        self.config = config or PaintConfig()
        self.hidden = None if hidden is None else np.asarray(hidden, bool)
        self._camera, self._T_base_cam = camera, T_base_cam
        self._view: GroundView | None = None
        self._size = (0, 0)

    def __call__(self, image: np.ndarray, frame_id: str = "") -> np.ndarray:
        """Class ids uint8[h w]: 1 paint, 0 the rest, 255 hidden.

        Args:
            image: BGR, uint8[h w 3].
            frame_id: not needed, as no files are read.

        Raises:
            SemlocError: the image is not uint8[h w 3] or has not the size of the camera or of `hidden`.
        """
        view = self._view_for(image)
        top, visible = view.warp(image), view.visible
        if self.hidden is not None:
            covered = cv2.remap(self.hidden.astype(np.uint8), view.image_uv, None, cv2.INTER_NEAREST)
            visible = visible & (covered == 0)
        candidates = find_candidates(top, visible, self.config)
        paint = keep_paint(candidates, top, self.config)
        mask = _outline(image, view, candidates, paint, self.config)
        if self.hidden is not None:
            mask[self.hidden] = UNLABELED_ID
        return mask

    def _view_for(self, image: np.ndarray) -> GroundView:
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise SemlocError(f"paint segmenter: given {image.dtype}{list(image.shape)}, expected BGR uint8[h w 3]")
        size = image.shape[1], image.shape[0]
        if self._camera is not None and self._camera.resolution != size:
            expected = "{}x{}".format(*self._camera.resolution)
            raise SemlocError(
                f"paint segmenter: given an image of {size[0]}x{size[1]} px for a camera of {expected} px"
            )
        if self.hidden is not None and self.hidden.shape != image.shape[:2]:
            raise SemlocError(f"paint segmenter: hidden has shape {self.hidden.shape}, the image {image.shape[:2]}")
        if self._view is None or self._size != size:
            pose = (self._camera, self._T_base_cam) if self._camera is not None else guess_forward_camera(*size)
            self._view = GroundView.of(*pose, self.config.metres_per_px, self.config.range_m)
            self._size = size
        return self._view


def guess_forward_camera(width_px: int, height_px: int) -> tuple[PinholeCamera, np.ndarray]:
    """A usual forward camera and its T_base_cam, for images without calibration."""
    focal = 0.5 * width_px / np.tan(np.deg2rad(_GUESSED_VIEW_DEG) / 2)
    camera = PinholeCamera(focal, focal, width_px / 2 - 0.5, height_px / 2 - 0.5, width_px, height_px)
    pitch = np.arctan((_GUESSED_HORIZON - 0.5) * height_px / focal)
    forward, down = np.array([np.cos(pitch), 0, np.sin(pitch)]), np.array([np.sin(pitch), 0, -np.cos(pitch)])
    T_base_cam = np.eye(4)
    T_base_cam[:3, :3] = np.stack([[0, -1, 0], down, forward], axis=1)
    T_base_cam[2, 3] = _GUESSED_HEIGHT_M
    return camera, T_base_cam


def _outline(
    image: np.ndarray, view: GroundView, candidates: PaintCandidates, paint: np.ndarray, config: PaintConfig
) -> np.ndarray:
    """The spots in the image: pixels brighter than halfway between their road and their paint, uint8[h w]."""
    mask = np.zeros(image.shape[:2], np.uint8)
    if not paint.any():
        return mask
    excess = np.where(paint, np.maximum(candidates.grey - candidates.background, 0.0), np.float32(0))
    sigma = 0.2 / config.metres_per_px
    # Mean weighted by the excess itself: the soft rim of a stroke must not darken its paint.
    total = np.maximum(cv2.GaussianBlur(excess, (0, 0), sigma), 1e-3)
    halfway = candidates.background + 0.5 * cv2.GaussianBlur(excess * excess, (0, 0), sigma) / total
    near = cv2.dilate(paint.astype(np.uint8), config.disk(0.25))
    level, inside = view.warp_back(halfway), view.warp_back(near, cv2.INTER_NEAREST)
    mask[(inside > 0) & (paint_brightness(image) > level)] = 1
    _, label, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= _MIN_COMPONENT_PX
    large[0] = False
    return np.where(large[label], np.uint8(PAINT_ID), np.uint8(0))
