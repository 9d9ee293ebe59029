"""A camera image as a gravity-aligned cylinder: upright things stand upright, boxes fit (room: perception; host).

In: a camera, its pose, the direction up. Out: CylinderView: pictures and masks resampled, points and boxes both ways.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.cameras import Camera, CylindricalCamera
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.rigid import pose_from
from semloc_jax.perception.ground_contact import SightErrors, along_and_across, contact_range

UP = (0.0, 0.0, 1.0)
_FAR = -1e4
_LOOKS_DOWN = 0.2
"""Horizontal part of a line of sight below which the upper edge of the image says where ahead is."""
_TAN_UP, _TAN_DOWN = 0.8, 2.0
"""What is shown above and below the horizon, tangent of the elevation: above 39 deg there is nothing to drive into, and
below 63 deg the own car."""
_BORDER_POINTS = 9
"""Places along each side of a box that are carried to the other image: sides of boxes are curved there."""

Box = Sequence[float] | Float[np.ndarray, " 4"]
"""Left, top, right and lower border [px]; those of one pixel at (u, v) are u - 0.5, v - 0.5, u + 0.5, v + 0.5."""


class GroundSight(NamedTuple):
    """A place on the road.

    Args:
        xy_base: `float64[2]` [m].
        covariance: `float64[2 2]` [m^2].
        by_height: `float64[2]`, how far it moves where the road is one sigma higher than thought [m]; part of the
            covariance.
    """

    xy_base: Float[np.ndarray, " 2"]
    covariance: Float[np.ndarray, "2 2"]
    by_height: Float[np.ndarray, " 2"]


@dataclass(frozen=True)
class CylinderView:
    """One camera and the cylinder about the upright axis through its lens.

    Attributes:
        camera, T_base_cam: the camera and its pose.
        cylinder: the resampled image as a camera, about as many pixels a radian as the middle of the camera.
        T_base_cylinder: its pose: the same place; y points down, z ahead and level.
        image_uv: float32[h w 2], pixel of the camera that each pixel of the cylinder shows; far outside for none.

    >>> view = CylinderView.of(rig.cameras[0], rig.T_base_cam[0])
    >>> panorama = view.warp(image)                  # uint8[h w 3]; a mask becomes a mask
    >>> box = view.box_from_camera((300, 200, 340, 280))
    """

    camera: Camera
    T_base_cam: Float[np.ndarray, "4 4"]
    cylinder: CylindricalCamera
    T_base_cylinder: Float[np.ndarray, "4 4"]
    image_uv: Float[np.ndarray, "h w 2"]

    @classmethod
    def of(
        cls,
        camera: Camera,
        T_base_cam: Float[np.ndarray, "4 4"],
        up_base: Sequence[float] | Float[np.ndarray, " 3"] = UP,
        px_per_rad: float | None = None,
    ) -> "CylinderView":
        """The cylinder that shows what a camera sees.

        Args:
            camera: any camera with a centre (not a top view).
            T_base_cam: its pose.
            up_base: against gravity, in the base frame; the default is that of a car that stands level.
            px_per_rad: None takes the focal length of the camera.

        Raises:
            SemlocError: the camera sees nothing around the horizon.
        """
        T_base_cam = np.asarray(T_base_cam, np.float64)
        T = _levelled(T_base_cam, np.asarray(up_base, np.float64))
        focal_px = float(camera.fx) if px_per_rad is None else float(px_per_rad)
        phi = _azimuths(camera, T[:3, :3].T @ T_base_cam[:3, :3])
        width, height = (int(np.ceil(span * focal_px)) + 1 for span in (np.ptp(phi), _TAN_UP + _TAN_DOWN))
        cylinder = CylindricalCamera(focal_px, -phi[0] * focal_px, _TAN_UP * focal_px, width, height)
        return cls.on(cylinder, camera, T_base_cam, up_base)

    @classmethod
    def on(
        cls,
        cylinder: CylindricalCamera,
        camera: Camera,
        T_base_cam: Float[np.ndarray, "4 4"],
        up_base: Sequence[float] | Float[np.ndarray, " 3"] = UP,
    ) -> "CylinderView":
        """What a camera sees on a given cylinder.

        Args:
            cylinder: scale, centre and size of it.
            camera: any camera with a centre (not a top view).
            T_base_cam: its pose.
            up_base: against gravity, in the base frame.
        """
        T_base_cam = np.asarray(T_base_cam, np.float64)
        T = _levelled(T_base_cam, np.asarray(up_base, np.float64))
        size = (int(cylinder.width), int(cylinder.height))
        grid = np.stack(np.meshgrid(*(np.arange(side, dtype=np.float64) for side in size)), axis=-1)
        uv, seen = _carried(grid, cylinder, camera, T_base_cam[:3, :3].T @ T[:3, :3])
        uv[~seen] = _FAR
        return cls(camera, T_base_cam, cylinder, T, uv.astype(np.float32))

    @property
    def seen(self) -> Bool[np.ndarray, "h w"]:
        """Which pixels of the cylinder the camera shows."""
        return self.image_uv[..., 0] > 0.5 * _FAR

    def warp(self, image: np.ndarray, outside: int = 0) -> np.ndarray:
        """The image on the cylinder: pictures [h w 3] between pixels, class ids [h w] the nearest one.

        Args:
            image: of the camera.
            outside: value where the camera shows nothing.
        """
        mode = cv2.INTER_NEAREST if image.ndim == 2 else cv2.INTER_LINEAR
        return cv2.remap(
            image, self.image_uv, None, mode, borderMode=cv2.BORDER_CONSTANT, borderValue=(float(outside),) * 4
        )

    def to_camera(self, uv: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Pixels of the camera of pixels of the cylinder, and whether it shows them."""
        return _carried(uv, self.cylinder, self.camera, self.T_base_cam[:3, :3].T @ self.T_base_cylinder[:3, :3])

    def from_camera(self, uv: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Pixels of the cylinder of pixels of the camera, and whether it shows them."""
        return _carried(uv, self.camera, self.cylinder, self.T_base_cylinder[:3, :3].T @ self.T_base_cam[:3, :3])

    def ground(
        self,
        foot_uv: Float[np.ndarray, " 2"],
        errors: SightErrors,
        top_v: float | None = None,
        size_m: tuple[float, float] | None = None,
        road_m: float = 0.0,
    ) -> GroundSight:
        """Place on the road in the base frame that a foot point is.

        Args:
            foot_uv: pixel of the cylinder where the thing meets the road.
            errors: of the sight.
            top_v: row of its upper end, with `size_m` a second cue.
            size_m: height of things of its class and the standard deviation of that.
            road_m: height of the road there above the plane z = 0 of the base frame.

        Returns:
            Infinite numbers for a foot at or above the horizon.
        """
        focal_px, (phi, tan_foot) = float(self.cylinder.fx), self._angles(foot_uv)
        tan_top = None if top_v is None else float(self._angles(np.array([0.0, top_v]))[1])
        height_m = float(self.T_base_cylinder[2, 3]) - road_m
        contact = contact_range(float(tan_foot), height_m, focal_px, errors, tan_top, size_m)
        if not np.isfinite(contact.range_m):
            return GroundSight(np.full(2, np.inf), np.full((2, 2), np.inf), np.zeros(2))
        sight = self.T_base_cylinder[:3, :3] @ [np.sin(phi), 0.0, np.cos(phi)]
        offset = contact.range_m * sight[:2]
        across_m2 = (contact.range_m**2 + height_m**2) * (errors.pixel_px / focal_px) ** 2
        covariance = along_and_across(sight[:2], contact.sigma_m**2, across_m2)
        return GroundSight(self.T_base_cylinder[:2, 3] + offset, covariance, contact.by_height_m * sight[:2])

    def foot(self, p_base: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Pixels of the cylinder of places [m] in the base frame, and whether the camera shows them."""
        T = self.T_base_cylinder
        uv, valid = (np.asarray(part) for part in self.cylinder.project((p_base - T[:3, 3]) @ T[:3, :3]))
        inside = valid & np.asarray(self.cylinder.in_image(uv[..., 0], uv[..., 1], 1.0))
        u, v = np.rint(np.where(inside[..., None], uv, 0.0)).astype(int).T
        return uv, inside & self.seen[v, u]

    def _angles(self, uv: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " 2"]:
        """Azimuth and tangent of the elevation, positive downward."""
        camera = self.cylinder
        return (np.asarray(uv, np.float64) - [float(camera.cx), float(camera.cy)]) / [
            float(camera.fx),
            float(camera.fy),
        ]

    def box_from_camera(self, box: Box) -> Float[np.ndarray, " 4"]:
        """The smallest box of the cylinder around a box of the camera."""
        return _around(*self.from_camera(outline(box)), "cylinder")

    def box_to_camera(self, box: Box) -> Float[np.ndarray, " 4"]:
        """The smallest box of the camera around a box of the cylinder; `to_camera(outline(box))` is its true shape."""
        return _around(*self.to_camera(outline(box)), "camera")


def outline(box: Box) -> Float[np.ndarray, "n 2"]:
    """Places along the four sides of a box, clockwise in the image."""
    left, top, right, low = box
    share = np.linspace(0.0, 1.0, _BORDER_POINTS)[:-1]
    corners = np.array([[left, top], [right, top], [right, low], [left, low]])
    sides = [a + share[:, None] * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return np.concatenate(sides)


def _levelled(T_base_cam: np.ndarray, up_base: np.ndarray) -> Float[np.ndarray, "4 4"]:
    up = up_base / np.linalg.norm(up_base)
    _, down, ahead = T_base_cam[:3, :3].T
    level = ahead - (ahead @ up) * up
    if np.linalg.norm(level) < _LOOKS_DOWN:  # straight down or up: ahead is where the upper edge of the image is
        level = np.sign(ahead @ up) * (down - (down @ up) * up)
    level = level / np.linalg.norm(level)
    return pose_from(np.stack([np.cross(-up, level), -up, level], axis=1), T_base_cam[:3, 3])


def _azimuths(camera: Camera, R_cylinder_cam: np.ndarray) -> tuple[float, float]:
    """Least and largest azimuth around the horizon that the camera shows [rad]."""
    phi = np.linspace(-np.pi, np.pi, 721)[1:-1]
    tan = np.linspace(-0.3, _TAN_DOWN, 24)
    rays = np.stack([*np.broadcast_arrays(np.sin(phi), tan[:, None], np.cos(phi))], axis=-1)
    uv, valid = (np.asarray(part) for part in camera.project(rays @ R_cylinder_cam))
    shown = (valid & np.asarray(camera.in_image(uv[..., 0], uv[..., 1]))).any(axis=0)
    if not shown.any():
        raise SemlocError(
            "cylinder: the camera sees nothing between the horizon and the road; check T_base_cam (z of the base frame "
            "points up) and the intrinsics (semloc check-calib)"
        )
    return float(phi[shown].min()), float(phi[shown].max())


def _carried(
    uv: np.ndarray, one: Camera, other: Camera, R_other_one: np.ndarray
) -> tuple[Float[np.ndarray, "*n 2"], Bool[np.ndarray, " *n"]]:
    """Pixels of a second camera at the same place, and whether it shows them."""
    ray, valid = (np.asarray(part) for part in one.unproject(np.asarray(uv, np.float64)))
    moved, seen = (np.array(part) for part in other.project(ray.astype(np.float64) @ R_other_one.T))
    return moved.astype(np.float64), valid & seen & np.asarray(other.in_image(moved[..., 0], moved[..., 1]))


def _around(uv: np.ndarray, seen: np.ndarray, where: str) -> Float[np.ndarray, " 4"]:
    if not seen.any():
        raise SemlocError(f"box: no part of it is shown by the {where}; give a box inside of both images")
    return np.concatenate([uv[seen].min(axis=0), uv[seen].max(axis=0)])


def resized(picture: UInt8[np.ndarray, "h w 3"], size: tuple[int, int]) -> UInt8[np.ndarray, "i j 3"]:
    """The picture with other width and height: smaller ones are averaged, larger ones bilinear."""
    if picture.shape[1::-1] == size:
        return picture
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA if size[0] < picture.shape[1] else cv2.INTER_LINEAR)
