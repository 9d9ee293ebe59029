"""OCamCalib (Scaramuzza) calibrations (room: cameras; host).

In: calib_results.txt: polynomial, inverse polynomial, centre (row, column), affine c d e, size (height width).
Out: Rig of one fisheye fitted to the inverse polynomial; a message states the error of the fit in pixels.
"""

import logging
from pathlib import Path

import numpy as np

from semloc_jax.cameras.angle_polynomial import PolynomialFisheyeCamera
from semloc_jax.cameras.base import Camera
from semloc_jax.cameras.fisheye import KannalaBrandtCamera
from semloc_jax.cameras.io.fields import check_focal, numbers, read_text, resolution
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError

_log = logging.getLogger(__name__)
_MAX_ERROR_PX = 2.0
_WORD_OF_ERROR_PX = 0.2
_MOST_TERMS = 32
_LARGEST_THETA_RAD = 1.92
_NUM_ANGLES = 800


def is_ocamcalib(path: Path) -> bool:
    """Whether a file is a calib_results.txt of OCamCalib."""
    if path.suffix != ".txt" or path.stat().st_size > 1_000_000:
        return False
    lines = _lines(path)
    return len(lines) >= 5 and [len(line) for line in lines[2:5]] == [2, 3, 2] and _is_count(lines[0])


def rig_from_ocamcalib(path: Path) -> Rig:
    """The camera, named by the file; OCamCalib has no vehicle frame, so T_base_cam is the identity."""
    where, lines = f"calibration {path}", _lines(path)
    inverse = _polynomial(lines[1], f"{where} inverse polynomial")
    row, column = numbers(lines[2], (2,), f"{where} centre")
    c, d, e = numbers(lines[3], (3,), f"{where} affine parameters")
    height, width = resolution(numbers(lines[4], (2,), f"{where} size"), f"{where} size")
    if not 0.5 < c < 2.0:
        raise SemlocError(f"{where}: affine parameter c {c}; expected about 1; check the order of the lines")
    theta, rho = _radius(inverse, row, column, height, width, where)
    # OCamCalib counts rows down and columns right: u = rho y/r + column, v = c rho x/r + row; d and e are its shear.
    camera, error_px = _fitted(theta, rho, (column, row, width, height), c)
    shear_px = max(abs(d), abs(e)) * float(rho.max())
    check_focal(float(camera.fx), float(camera.fy), where)
    if not error_px <= _MAX_ERROR_PX:
        raise SemlocError(
            f"{where}: no fisheye model here fits its polynomial ({error_px:.1f} px off); expected a smooth lens; "
            "calibrate with Kalibr (equidistant) or cv2.fisheye"
        )
    if max(error_px, shear_px) > _WORD_OF_ERROR_PX:
        _log.warning("%s: fitted to %.2f px, its shear of up to %.2f px is left out", where, error_px, shear_px)
    _log.warning("%s: no extrinsics; T_base_cam is the identity (write a camchain with T_body_cam)", where)
    return Rig([camera], np.eye(4)[None], [path.stem])


def _radius(
    inverse: np.ndarray, row: float, column: float, height: float, width: float, where: str
) -> tuple[np.ndarray, np.ndarray]:
    """Angles to the axis and the radius [px] there, as far as the picture reaches and the polynomial rises."""
    theta = np.linspace(0.0, _LARGEST_THETA_RAD, _NUM_ANGLES)
    # Its angle counts from the plane of the lens: -90 deg is the optical axis.
    with np.errstate(over="ignore", invalid="ignore"):
        rho = np.polynomial.polynomial.polyval(theta - 0.5 * np.pi, inverse)
    corner = np.hypot(max(row, height - 1 - row), max(column, width - 1 - column))
    rising = np.concatenate([[True], np.diff(rho) > 0])
    usable = np.logical_and.accumulate(rising & (rho <= corner) & np.isfinite(rho))
    if usable.sum() < 50 or abs(rho[0]) > 0.1 * corner:
        raise SemlocError(f"{where}: the inverse polynomial does not rise from the centre; expected that of world2cam")
    return theta[usable], rho[usable]


def _fitted(
    theta: np.ndarray, rho: np.ndarray, pixels: tuple[float, float, float, float], c: float
) -> tuple[Camera, float]:
    """The better of the two fisheyes and its largest error [px]."""
    odd = np.stack([theta**power for power in (1, 3, 5, 7, 9)], axis=1)
    full = np.stack([theta**power for power in (1, 2, 3, 4)], axis=1)
    k, p = (np.linalg.lstsq(basis, rho, rcond=None)[0] for basis in (odd, full))
    errors = [float(np.abs(basis @ fit - rho).max()) for basis, fit in ((odd, k), (full, p))]
    end = float(theta[-1])
    if errors[0] <= errors[1] and k[0] > 0:
        return KannalaBrandtCamera(k[0], c * k[0], *pixels, *(k[1:] / k[0]), max_theta_rad=end), errors[0]
    if p[0] <= 0:
        return PolynomialFisheyeCamera(1.0, 1.0, *pixels), np.inf
    return PolynomialFisheyeCamera(p[0], c * p[0], *pixels, *(p[1:] / p[0]), max_theta_rad=end), errors[1]


def _polynomial(line: list[str], where: str) -> np.ndarray:
    count = int(numbers(line[:1], (1,), where)[0]) if line else 0
    if not 2 <= count <= _MOST_TERMS or len(line) != count + 1:
        raise SemlocError(f"{where}: {len(line) - 1} coefficients after the count {count}; expected as many as it says")
    return numbers(line[1:], (count,), where)


def _is_count(line: list[str]) -> bool:
    return line[0].isdigit() and int(line[0]) == len(line) - 1


def _lines(path: Path) -> list[list[str]]:
    lines = [line.split("#", 1)[0].split() for line in read_text(path).splitlines()]
    return [line for line in lines if line]
