"""How mask boundaries are displaced, and which displacements belong together (room: analysis; host).

In: prior values. Out: BoundaryNoise.
Measured at true poses on simulated drives (degraded masks, pinhole and fisheye, 640x400 to 960x600): neighbours on
one edge of one element are wrong together, mostly over 10 px, a little along the whole line; the opposite edge of a
stripe and other elements know nothing of it; and all masks are too thin or too thick by the same.
Lengths are pixels of the mask, whatever the size of the image: the network displaces boundaries, not the camera.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class BoundaryNoise:
    """Prior values for displaced boundaries, before a frame is seen. All values are our choice."""

    own_px2: float = 0.12
    """Variance of a boundary pixel that no other pixel shares."""
    length_px: tuple[float, ...] = (10.0, 150.0)
    """Lengths over which displacements of one edge of one element change."""
    edge_px2: tuple[float, ...] = (0.05, 0.02)
    """Their variances."""
    thickness_px2: float = 0.011
    """Variance of what all masks of an image are too thin or too thick by."""
    efficiency: float = 0.36
    """Curvature of the robust cost over that of squared distances to all that the map has in view: parts are missing,
    the kernel lets go, and ramps on smoothed stairs rise by less than a pixel for each pixel."""
    height_m: float = 0.01
    """How far vehicles really stand off the plane of the road; the prior of the solver leaves room for much more."""
    roll_pitch_deg: float = 0.15

    @property
    def variance_px2(self) -> Float[np.ndarray, " component"]:
        """Own, by length, thickness."""
        return np.array([self.own_px2, *self.edge_px2, self.thickness_px2])

    def road_scatter(self, prior_sigma: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6 6"]:
        """Covariance of the vehicle about the prior that its place on the road gives, whitened by the prior.

        Position and heading: the prior is believed. Height, roll and pitch: as vehicles really stand, if that is less.
        """
        tilt = np.deg2rad(self.roll_pitch_deg)
        real = np.array([np.inf, np.inf, self.height_m, tilt, tilt, np.inf])
        sigma = np.asarray(prior_sigma, np.float64)
        return np.diag(np.where(sigma > 0, np.minimum(real / np.where(sigma > 0, sigma, 1.0), 1.0), 0.0) ** 2)
