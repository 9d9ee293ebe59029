"""A segmenter for road paint and white posts that needs no network (room: perception; host).

In: an image and, if known, its camera above the road. Out: class ids of the table `classical`.
"""

from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np

from semloc_jax.cameras import Camera, PinholeCamera
from semloc_jax.errors import SemlocError
from semloc_jax.perception.class_table import UNLABELED_ID
from semloc_jax.perception.classical_posts import find_posts
from semloc_jax.perception.ground_view import GroundView
from semloc_jax.perception.paint_candidates import PaintCandidates, PaintConfig, find_candidates, paint_brightness
from semloc_jax.perception.paint_colours import TopView
from semloc_jax.perception.paint_filter import keep_paint
from semloc_jax.perception.paint_search import draw_strokes, search_strokes

PAINT_ID, POST_ID = 1, 2
_CLEAR_PX = 1
_SHARP_TO_SOFT = 2.0
"""Ridges with two sharp edges in a spot of paint, for each with a soft one: sun through leaves has soft edges."""
_BLINDING = 250.0
_BLIND_M = 0.5
"""Ground that is white over this size shows no paint."""
_LEAN = 0.15
"""Largest tangent of an upright against the columns of an image in which posts are looked for."""
_MIN_COMPONENT_PX = 6
_GUESSED_HORIZON, _GUESSED_HEIGHT_M, _GUESSED_VIEW_DEG = 0.57, 1.4, 60.0


class ClassicalPaintSegmenter:
    """Lane lines, stop lines, crosswalk bars, arrows, letters and posts of a plain image: image (BGR) -> class ids.

    The image is warped to the road plane, where all paint has the same size in any direction and any camera. Strokes
    are ridges with two sharp edges, an even width and a contrast to the road on both sides; they are drawn between
    these edges. Other spots that are narrower than a stroke (letters, heads of arrows) are kept where the road around
    them is even and grey; their outline lies halfway between the brightness of paint and road.
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
        self._pose: tuple[Camera, np.ndarray] | None = None
        self._size = (0, 0)

    def __call__(self, image: np.ndarray, frame_id: str = "", traffic: np.ndarray | None = None) -> np.ndarray:
        """Class ids uint8[h w]: 1 paint, 2 white posts, 255 hidden or overexposed road, 0 the rest.

        Args:
            image: BGR, uint8[h w 3].
            frame_id: not needed, as no files are read.
            traffic: pixels of moving objects where they are known, bool[h w]; they come out as 255. Their edges look
                like strokes of paint, which have a say in where the road goes.

        Raises:
            SemlocError: the image is not uint8[h w 3] or has not the size of the camera, of `hidden` or of `traffic`.
        """
        hidden = self._hidden_with(traffic)
        view = self._view_for(image, hidden)
        top, visible = view.warp(image), view.visible
        if hidden is not None:
            covered = cv2.remap(hidden.astype(np.uint8), view.image_uv, None, cv2.INTER_NEAREST)
            visible = visible & (covered == 0)
        pose = self._pose[1]
        candidates = find_candidates(top, visible, self.config)
        strokes, sharp = search_strokes(image, top, candidates, TopView.of(top, view, pose), self.config)
        drawn = draw_strokes(strokes, view)
        mask = _beside(_spots(image, view, top, candidates, sharp, self.config), drawn)
        mask[drawn] = PAINT_ID
        mask[(mask == 0) & _overexposed(top, view, self.config)] = UNLABELED_ID
        if self.shows_posts:
            mask[find_posts(image, view)] = POST_ID
        if hidden is not None:
            mask[hidden] = UNLABELED_ID
        return mask

    @cached_property
    def shows_posts(self) -> bool:
        """Whether uprights stand along the columns of the image, so that posts are looked for; False before a guess."""
        return self._camera is not None and _is_upright(self._camera, np.asarray(self._T_base_cam))

    def _hidden_with(self, traffic: np.ndarray | None) -> np.ndarray | None:
        if traffic is None or self.hidden is None:
            return self.hidden if traffic is None else np.asarray(traffic, bool)
        if traffic.shape != self.hidden.shape:
            raise SemlocError(f"paint segmenter: hidden has shape {self.hidden.shape}, traffic {traffic.shape}")
        return self.hidden | np.asarray(traffic, bool)

    def _view_for(self, image: np.ndarray, hidden: np.ndarray | None) -> GroundView:
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise SemlocError(f"paint segmenter: given {image.dtype}{list(image.shape)}, expected BGR uint8[h w 3]")
        size = image.shape[1], image.shape[0]
        if self._camera is not None and self._camera.resolution != size:
            expected = "{}x{}".format(*self._camera.resolution)
            raise SemlocError(
                f"paint segmenter: given an image of {size[0]}x{size[1]} px for a camera of {expected} px"
            )
        if hidden is not None and hidden.shape != image.shape[:2]:
            raise SemlocError(f"paint segmenter: hidden has shape {hidden.shape}, the image {image.shape[:2]}")
        if self._view is None or self._size != size:
            pose = (self._camera, self._T_base_cam) if self._camera is not None else guess_forward_camera(*size)
            self._view = GroundView.of(*pose, self.config.metres_per_px, self.config.range_m)
            self._pose = pose[0], np.asarray(pose[1])
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


def _spots(
    image: np.ndarray,
    view: GroundView,
    top: np.ndarray,
    candidates: PaintCandidates,
    edges: np.ndarray,
    config: PaintConfig,
) -> np.ndarray:
    """Paint of any shape on an even road, uint8[h w]."""
    sharp, soft = (
        np.bincount(candidates.label[edges == sign], minlength=candidates.label.max() + 1) for sign in (1, -1)
    )
    boxes = {number: box for number, box in candidates.boxes.items() if sharp[number] >= _SHARP_TO_SOFT * soft[number]}
    candidates = replace(candidates, boxes=boxes)
    return _outline(image, view, candidates, keep_paint(candidates, top, config), config)


def _beside(spots: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """The spots off the strokes: their outline is coarser than that of a stroke."""
    size = 2 * _CLEAR_PX + 1
    spots[cv2.dilate(drawn.astype(np.uint8), np.ones((size, size), np.uint8)) > 0] = 0
    return spots


def _overexposed(top: np.ndarray, view: GroundView, config: PaintConfig) -> np.ndarray:
    """Road so bright that white paint cannot be told from it, bool[h w] of the image."""
    size = max(round(_BLIND_M / config.metres_per_px), 1)
    white = cv2.inRange(top, (_BLINDING,) * 3, (255.0,) * 3)
    wide = cv2.morphologyEx(white, cv2.MORPH_OPEN, np.ones((size, size), np.uint8))
    return view.warp_back(wide, cv2.INTER_NEAREST) > 0


def _is_upright(camera: Camera, T_base_cam: np.ndarray) -> bool:
    """Whether a post 10 m ahead of a camera stands along a column of its image, in the middle and at both sides."""
    width, height = camera.resolution
    for share in (0.2, 0.5, 0.8):
        ray = np.asarray(camera.unproject(np.array([share * width, 0.5 * height]))[0], np.float64)
        place = T_base_cam[:3, :3] @ ray * 10.0 + T_base_cam[:3, 3]
        ends = np.array([[place[0], place[1], z] for z in (0.0, 1.0)])
        uv, valid = camera.project((ends - T_base_cam[:3, 3]) @ T_base_cam[:3, :3])
        step = np.asarray(uv[1] - uv[0])
        if not bool(np.all(valid)) or abs(step[0]) > _LEAN * abs(step[1]):
            return False
    return True


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
    rows, columns = np.nonzero(mask > 0)
    label = cv2.connectedComponents(mask, connectivity=8)[1][rows, columns]
    mask[rows, columns] = np.where((np.bincount(label) >= _MIN_COMPONENT_PX)[label], PAINT_ID, 0)
    return mask
