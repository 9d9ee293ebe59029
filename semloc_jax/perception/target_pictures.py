"""Calibration targets found in pictures: boards before a camera, mats on the ground (room: perception; host).

In: a folder with targets.yaml, boards/CAMERA/*.png, mats/CAMERA.png and mats.csv. Out: corners in pixels and metres.
"""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from jaxtyping import Float

from semloc_jax.cameras import BevCamera, Camera
from semloc_jax.cameras.bev import T_base_bev
from semloc_jax.errors import SemlocError
from semloc_jax.storage import reading

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
_PATCH_PX_M = 0.008
_MARGIN_M = 0.45
"""Around a mat: mounts by drawing are off by as much on the ground."""
_REFINE_PX = 5
_FAR_OFF_M = 0.5


@dataclass(frozen=True)
class Board:
    """A chessboard, or a ChArUco board where `marker_m` is not zero.

    Attributes:
        columns, rows: inner corners along and across it.
        square_m: side of its squares.
        marker_m: side of its markers; 0 for a plain chessboard.
        dictionary: name of the dictionary of its markers, as OpenCV calls it.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = "DICT_4X4_100"

    def places(self) -> Float[np.ndarray, "n 3"]:
        """The inner corners on the board [m]."""
        at = np.stack(np.meshgrid(np.arange(self.columns), np.arange(self.rows)), axis=-1).reshape(-1, 2)
        return np.column_stack([self.square_m * at, np.zeros(len(at))])

    def find(self, grey: np.ndarray) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]] | None:
        """Corners on the board [m] and in the picture [px]; None where it is not seen."""
        if self.marker_m:
            return self._find_coded(grey)
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        found, corners = cv2.findChessboardCornersSB(grey, (self.columns, self.rows), flags=flags)
        return (self.places(), corners.reshape(-1, 2).astype(np.float64)) if found else None

    def _find_coded(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        code = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard((self.columns + 1, self.rows + 1), self.square_m, self.marker_m, code)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        if ids is None or len(ids) < 8:
            return None
        return board.getChessboardCorners()[ids.ravel()].astype(np.float64), corners.reshape(-1, 2).astype(np.float64)


@dataclass(frozen=True)
class SurveyedMats:
    """Corners of mats measured on the ground: place [m] in the base frame by mat, float64[rows columns 2]."""

    mats: Mapping[str, Float[np.ndarray, "r c 2"]]


def read_boards(folder: Path) -> tuple[Board, Board | None]:
    """The board, and the mat where there is one, of targets.yaml.

    Raises:
        SemlocError: no such file, or a number is missing or cannot be meant.
    """
    path = folder / "targets.yaml"
    if not path.is_file():
        raise SemlocError(
            f"targets {folder}: no targets.yaml; expected 'board: {{columns: 8, rows: 5, square_m: 0.1}}' (inner "
            "corners), and 'mat:' likewise for mats on the ground"
        )
    with reading(f"targets {path}"):
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict) or "board" not in content:
        raise SemlocError(f"targets {path}: no key board; expected columns, rows (inner corners) and square_m under it")
    return _board(content["board"], f"targets {path}: board"), (
        _board(content["mat"], f"targets {path}: mat") if content.get("mat") else None
    )


def _board(said: Any, where: str) -> Board:
    try:
        board = Board(**said)
        is_sound = min(int(board.columns), int(board.rows)) >= 3 and 0.005 < float(board.square_m) < 2.0
    except (TypeError, ValueError) as error:
        raise SemlocError(f"{where}: {error}; expected columns, rows, square_m (marker_m, dictionary)") from error
    if not is_sound or not 0.0 <= board.marker_m < board.square_m or not hasattr(cv2.aruco, board.dictionary):
        raise SemlocError(f"{where}: {said}; expected 3 and more inner corners a side and squares of 5 mm to 2 m")
    return board


def read_survey(folder: Path, mat: Board) -> SurveyedMats:
    """Surveyed corners of mats.csv: columns mat, column, row, x_m, y_m.

    Raises:
        SemlocError: no such file, a number that is none, a mat that is not whole.
    """
    path = folder / "mats.csv"
    if not path.is_file():
        raise SemlocError(f"targets {folder}: no mats.csv; expected columns mat, column, row, x_m, y_m")
    mats: dict[str, np.ndarray] = {}
    with reading(f"targets {path}"), path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for number, row in enumerate(rows):
        try:
            at = int(row["row"]), int(row["column"])
            place = mats.setdefault(str(row["mat"]), np.full((mat.rows, mat.columns, 2), np.nan))
            place[at] = float(row["x_m"]), float(row["y_m"])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise SemlocError(
                f"targets {path} line {number + 2}: {error}; expected mat, column (0 ... {mat.columns - 1}), row "
                f"(0 ... {mat.rows - 1}), x_m, y_m"
            ) from error
    whole = {name: _filled(place) for name, place in mats.items()}
    if not whole:
        raise SemlocError(f"targets {path}: no rows; expected the surveyed corners of at least one mat")
    return SurveyedMats(whole)


def _filled(place: np.ndarray) -> np.ndarray:
    """All corners of a mat of which at least its four outer ones were measured."""
    known = np.isfinite(place).all(axis=-1)
    rows, columns = place.shape[:2]
    at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(np.float64)
    if known.sum() < 4:
        raise SemlocError(f"targets mats.csv: {known.sum()} corners of a mat; expected its four outer corners and more")
    H, _ = cv2.findHomography(at[known], place[known])
    return np.where(known[..., None], place, cv2.perspectiveTransform(at.reshape(1, -1, 2), H).reshape(place.shape))


def grey_pictures(folder: Path) -> dict[str, np.ndarray]:
    """Grey pictures of a folder by file name."""
    files = sorted(f for f in folder.iterdir() if f.suffix.lower() in PICTURE_SUFFIXES) if folder.is_dir() else []
    found = {
        file.name: cv2.imdecode(np.frombuffer(file.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE) for file in files
    }
    broken = [name for name, picture in found.items() if picture is None]
    if broken:
        raise SemlocError(f"targets {folder / broken[0]}: cannot be read as a picture; write it again")
    return found


def find_mat(
    grey: np.ndarray, camera: Camera, T_base_cam: Float[np.ndarray, "4 4"], mat: Board, places: np.ndarray
) -> Float[np.ndarray, "r c 2"] | None:
    """Pixels of the corners of one mat; None where the camera does not show it as a whole.

    It is looked for from above, where it is not distorted, around the place where it was surveyed; its corners are
    refined in the picture itself.

    Args:
        grey: the picture.
        camera: its lens, calibrated.
        T_base_cam: its mount by drawing.
        mat: what it looks like.
        places: surveyed corners [m], float64[rows columns 2].
    """
    low, high = places.min(axis=(0, 1)) - _MARGIN_M, places.max(axis=(0, 1)) + _MARGIN_M
    bev = BevCamera.covering(high[0], -low[0], high[1], -low[1], _PATCH_PX_M)
    width, height = bev.resolution
    grid = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), axis=-1)
    uv, seen = _pixels(np.asarray(bev.unproject(grid)[0]) @ T_base_bev()[:3, :3].T, camera, T_base_cam)
    if not seen.any():
        return None
    patch = cv2.remap(grey, np.where(seen[..., None], uv, -9.0).astype(np.float32), None, cv2.INTER_LINEAR)
    found = mat.find(patch)
    if found is None or len(found[1]) != mat.rows * mat.columns:
        return None
    shape = places.shape
    p_base = np.asarray(bev.unproject(found[1].astype(np.float64))[0]) @ T_base_bev()[:3, :3].T
    # A chessboard looks the same turned by half: the order nearer to the survey is meant.
    orders = [order.reshape(shape[0], shape[1], 3) for order in (p_base, p_base[::-1])]
    nearest = min(orders, key=lambda order: np.linalg.norm(order[..., :2] - places, axis=-1).mean())
    if np.linalg.norm(nearest[..., :2] - places, axis=-1).mean() > _FAR_OFF_M:
        return None
    rough, _ = _pixels(nearest, camera, T_base_cam)
    return _refined(grey, rough)


def _pixels(p_base: np.ndarray, camera: Camera, T_base_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    T = np.asarray(T_base_cam, np.float64)
    uv, valid = (np.array(a) for a in camera.project((p_base - T[:3, 3]) @ T[:3, :3]))
    return uv, valid & np.asarray(camera.in_image(uv[..., 0], uv[..., 1]))


def _refined(grey: np.ndarray, rough: np.ndarray) -> np.ndarray:
    """Corners in the picture, in a window that holds no neighbouring corner."""
    steps = [np.linalg.norm(np.diff(rough, axis=axis), axis=-1).min() for axis in (0, 1)]
    window = int(np.clip(0.45 * min(steps), 2, _REFINE_PX))
    corners = rough.reshape(-1, 1, 2).astype(np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    refined = cv2.cornerSubPix(grey, corners.copy(), (window, window), (-1, -1), criteria)
    # What wandered out of its window found another edge.
    strayed = np.linalg.norm((refined - corners).reshape(-1, 2), axis=1) > window
    refined[strayed] = np.nan
    return refined.reshape(-1, 2).astype(np.float64).reshape(rough.shape)
