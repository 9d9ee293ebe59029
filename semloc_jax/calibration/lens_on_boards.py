"""The lens of a fisheye from views of a board (room: calibration; host).

In: corners on the board and in the pictures. Out: LensFit: a Kannala-Brandt camera, residuals, what the views cover.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.cameras import Camera, KannalaBrandtCamera
from semloc_jax.errors import SemlocError

_FEWEST_VIEWS = 6
_NUM_RINGS, _NUM_SECTORS = 3, 8
_LEAST_SECTORS, _LEAST_ANGLE_DEG = 5, 40.0
_WIDEST_DEG = 84.0
"""OpenCV starts from the tangent of the angle: farther corners upset it, though the model goes beyond."""
_OUTLIER = 3.0
View = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]


@dataclass(frozen=True)
class LensFit:
    """A calibrated lens.

    Attributes:
        camera: the lens.
        rms_px: of all corners of the views that were used.
        residuals_px: found less projected corner of each used view, float64[n 2].
        corners_px: where they are.
        used: which views were used.
        covered: parts of the picture that hold corners: rings from the middle outward, sectors from the right downward.
        widest_deg: largest angle of a corner to the axis.
    """

    camera: KannalaBrandtCamera
    rms_px: float
    residuals_px: tuple[np.ndarray, ...]
    corners_px: tuple[np.ndarray, ...]
    used: tuple[int, ...]
    covered: Bool[np.ndarray, "3 8"]
    widest_deg: float


def fit_lens(views: Sequence[View], drawing: Camera, name: str) -> LensFit:
    """The lens under which all views of the board fit.

    Args:
        views: corners on the board [m] and in the picture [px].
        drawing: a rough lens: its focal length, centre and size.
        name: of the camera, for messages.

    Raises:
        SemlocError: too few views, views on one side only, or a fit that OpenCV gives up.
    """
    if len(views) < _FEWEST_VIEWS:
        raise SemlocError(
            f"camera {name}: the board is found in {len(views)} pictures; expected {_FEWEST_VIEWS} and more, in all "
            "parts of the picture; check columns and rows (inner corners) in targets.yaml, or take more pictures"
        )
    covered = coverage([uv for _, uv in views], drawing)
    if covered.any(axis=0).sum() < _LEAST_SECTORS:
        raise SemlocError(
            f"camera {name}: the views of the board cover {covered.any(axis=0).sum()} of {_NUM_SECTORS} directions "
            f"from the middle of the picture; expected {_LEAST_SECTORS} and more; take pictures on the other sides, too"
        )
    used = [k for k, (_, uv) in enumerate(views) if _angles_deg(uv, drawing).max() < _WIDEST_DEG]
    fitted = _fitted([views[k] for k in used], drawing, name)
    rms = np.array([np.sqrt((r**2).sum(axis=1).mean()) for r in fitted[1]])
    good = rms <= _OUTLIER * np.median(rms)
    if not good.all() and good.sum() >= _FEWEST_VIEWS:
        used = [k for k, keep in zip(used, good, strict=True) if keep]
        fitted = _fitted([views[k] for k in used], drawing, name)
    camera, residuals = fitted
    corners = tuple(views[k][1] for k in used)
    widest = max(float(_angles_deg(uv, camera).max()) for uv in corners)
    if widest < _LEAST_ANGLE_DEG:
        raise SemlocError(
            f"camera {name}: the views reach {widest:.0f} deg from the axis; expected {_LEAST_ANGLE_DEG:.0f} and more; "
            "hold the board near the rim of the picture, too"
        )
    rms_px = float(np.sqrt((np.concatenate(residuals) ** 2).sum(axis=1).mean()))
    return LensFit(camera, rms_px, residuals, corners, tuple(used), coverage(corners, camera), widest)


def coverage(corners_px: Sequence[Float[np.ndarray, "n 2"]], camera: Camera) -> Bool[np.ndarray, "3 8"]:
    """Which parts of the picture hold corners: three rings of the image circle, eight directions."""
    off = np.concatenate(list(corners_px)) - [float(camera.cx), float(camera.cy)]
    radius = np.linalg.norm(off, axis=1) / (0.5 * float(camera.width))
    ring = np.minimum((radius * _NUM_RINGS / 0.9).astype(int), _NUM_RINGS - 1)
    sector = (
        np.floor((np.arctan2(off[:, 1], off[:, 0]) / (2.0 * np.pi) % 1.0) * _NUM_SECTORS).astype(int) % _NUM_SECTORS
    )
    found = np.zeros((_NUM_RINGS, _NUM_SECTORS), bool)
    found[ring, sector] = True
    return found


def _angles_deg(uv: np.ndarray, camera: Camera) -> np.ndarray:
    off = (uv - [float(camera.cx), float(camera.cy)]) / [float(camera.fx), float(camera.fy)]
    return np.rad2deg(np.linalg.norm(off, axis=1))


def _fitted(views: Sequence[View], drawing: Camera, name: str) -> tuple[KannalaBrandtCamera, tuple[np.ndarray, ...]]:
    if len(views) < _FEWEST_VIEWS:
        raise SemlocError(
            f"camera {name}: {len(views)} views of the board lie within {_WIDEST_DEG:.0f} deg of the axis; expected "
            f"{_FEWEST_VIEWS} and more; take more pictures nearer to the middle"
        )
    K = np.array([[drawing.fx, 0, drawing.cx], [0, drawing.fy, drawing.cy], [0, 0, 1]], np.float64)
    words = ("CALIB_USE_INTRINSIC_GUESS", "CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW")
    # OpenCV 5 moved the flags of its fisheye to the front.
    flags = sum(getattr(cv2.fisheye, word, None) or getattr(cv2, word) for word in words)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-9)
    size = drawing.resolution
    places, corners = ([v[part].reshape(1, -1, v[part].shape[1]) for v in views] for part in (0, 1))
    try:
        _, K, D, turned, moved = cv2.fisheye.calibrate(
            places, corners, size, K, np.zeros((4, 1)), None, None, flags, stop
        )
    except cv2.error as error:
        raise SemlocError(
            f"camera {name}: the views do not fit any fisheye lens ({str(error).strip().splitlines()[-1][:80]}); take "
            "views with the board tilted and nearer, and check targets.yaml"
        ) from error
    residuals = []
    for p, uv, r, t in zip(places, corners, turned, moved, strict=True):
        shown, _ = cv2.fisheye.projectPoints(p, r, t, K, D)
        residuals.append((uv - shown)[0])
    limit = getattr(drawing, "max_theta_rad", None)
    camera = KannalaBrandtCamera(K[0, 0], K[1, 1], K[0, 2], K[1, 2], *size, *D.ravel(), max_theta_rad=None)
    if limit is not None:
        camera = KannalaBrandtCamera(
            K[0, 0], K[1, 1], K[0, 2], K[1, 2], *size, *D.ravel(), min(float(limit), float(camera.max_theta_rad))
        )
    return camera, tuple(residuals)
