"""Where a thing stands, from where its foot is seen, and how sure that is (room: perception; host).

In: tangents of the elevations of foot and top, height of the camera over the road. Out: range [m], sigma, covariance.
A foot alone is a ray that meets the road: pitch and road height move it. The height of its class is a second cue, which
neither moves, and both share the pixel of the foot: they are weighed in one least squares.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class SightErrors:
    """Standard deviations of one sight.

    Args:
        pixel_px: of a border in the image.
        pitch_deg: of the camera against the road.
        height_m: of the road against its plane.
    """

    pixel_px: float = 2.0
    pitch_deg: float = 0.3
    height_m: float = 0.05


class Contact(NamedTuple):
    """Horizontal distance of a foot from the camera.

    Args:
        range_m: the distance.
        sigma_m: its standard deviation.
        by_height_m: the part of that which the height of the road has, signed: how much farther it seems where the road
            is one sigma higher than thought. It is the same in every sight of one thing.
    """

    range_m: float
    sigma_m: float
    by_height_m: float


def ground_covariance(
    offset_m: Float[np.ndarray, " 2"], height_m: float, focal_px: float, errors: SightErrors
) -> Float[np.ndarray, "2 2"]:
    """Covariance [m^2] of a place on the road.

    J diag(pixel, pixel)^2 J^T + pitch + height of a line of sight that meets a plane: along it
    ((r^2 + h^2) / h)^2 (sigma_px^2 / f^2 + sigma_pitch^2) + (r / h)^2 sigma_h^2, across it
    (r^2 + h^2) sigma_px^2 / f^2.

    Args:
        offset_m: from the camera to the place, level.
        height_m: of the camera over the road.
        focal_px: pixels a radian.
        errors: of the sight.
    """
    r = float(np.linalg.norm(offset_m))
    slant2, pixel = r * r + height_m * height_m, errors.pixel_px / focal_px
    along = (slant2 / height_m) ** 2 * (pixel**2 + np.deg2rad(errors.pitch_deg) ** 2)
    along += (r / height_m * errors.height_m) ** 2
    return along_and_across(offset_m, along, slant2 * pixel**2)


def along_and_across(offset_m: Float[np.ndarray, " 2"], along_m2: float, across_m2: float) -> Float[np.ndarray, "2 2"]:
    """Covariance with these variances along a line of sight and across it."""
    sight = offset_m / max(float(np.linalg.norm(offset_m)), 1e-6)
    aside = np.array([-sight[1], sight[0]])
    return along_m2 * np.outer(sight, sight) + across_m2 * np.outer(aside, aside)


def contact_range(
    tan_foot: float,
    height_m: float,
    focal_px: float,
    errors: SightErrors,
    tan_top: float | None = None,
    size_m: tuple[float, float] | None = None,
) -> Contact:
    """Range of a foot: tan_foot = h q and tan_top = (h - H) q with q = 1 / range, weighed by what they share.

    The errors of pixels and pitch are angles: they grow with 1 + tan^2 in the tangent.

    Args:
        tan_foot: tangent of the elevation of the foot, positive below the horizon.
        height_m: of the camera over the road at the foot.
        focal_px: pixels a radian of what was measured.
        errors: of the sight.
        tan_top: the same of the upper end; None where it was not seen.
        size_m: height H of things of this class and its standard deviation.

    Returns:
        Infinite range and sigma for a foot at or above the horizon.
    """
    if not tan_foot > 1e-3 or height_m <= 0.0:
        return Contact(np.inf, np.inf, 0.0)
    pixel, pitch = errors.pixel_px / focal_px, np.deg2rad(errors.pitch_deg)
    q = tan_foot / height_m
    if tan_top is None or size_m is None:
        growth = 1.0 + tan_foot**2
        sigma_q = np.sqrt(growth**2 * (pixel**2 + pitch**2) + (q * errors.height_m) ** 2) / height_m
        return Contact(1.0 / q, float(sigma_q / q**2), errors.height_m / tan_foot)
    told, slope = np.array([tan_foot, tan_top]), np.array([height_m, height_m - size_m[0]])
    growth = 1.0 + told**2
    for _ in range(3):  # the errors of the heights count by q, which is asked for
        shared = pitch**2 * np.outer(growth, growth) + (q * errors.height_m) ** 2
        own = np.diag((pixel * growth) ** 2 + [0.0, (q * size_m[1]) ** 2])
        weighed = np.linalg.solve(shared + own, slope)
        variance = 1.0 / float(slope @ weighed)
        q = max(variance * float(weighed @ told), 1e-3)
    by_height_m = variance * float(weighed.sum()) * errors.height_m / q
    return Contact(1.0 / q, float(np.sqrt(variance) / q**2), by_height_m)
