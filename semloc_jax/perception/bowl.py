"""All cameras around a car on a bowl, seen from outside (room: perception; host).

In: pictures of every camera, the rig. Out: a picture as from a camera that flies behind and above the car.
The road is flat near the car and rises further out, so that what stands there stands up in the picture, too: on a top
view it is drawn out along the ground.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from semloc_jax.cameras import PinholeCamera, Rig, mounted
from semloc_jax.errors import SemlocError
from semloc_jax.perception.colour_balance import ColourBalance
from semloc_jax.perception.picture_stitch import PictureStitch
from semloc_jax.perception.view_tables import Car, camera_table, own_car, seam_weights

_SEAM_SIGMA_PX = 12.0
"""Standard deviation of the blend at a seam, in the view from outside; ours."""
_FARTHEST_M = 60.0
_FOCAL_SHARE = 0.55
"""Of the width of the view: 85 degrees wide."""
_HALVINGS = 24
"""60 m halved as often are 4 micrometres."""
_AWAY_M, _UP_M, _DOWN_DEG = 3.2, 3.6, 30.0
"""Where the view is taken from: beyond the end of the car, above the road, and how far it looks down; ours."""
_CAR_HEIGHT_M = 1.4
_ROOF, _SIDE, _END = (150, 140, 130), (110, 102, 95), (85, 78, 72)
"""Blue, green and red of the box that stands for the car."""


@dataclass(frozen=True)
class Bowl:
    """The surface: flat around the car, then a parabola.

    Args:
        car_m: rear, front, right and left end of the car in the base frame [m].
        flat_m: width of the flat rim around the car [m].
        rise_per_m: height d^2 * rise_per_m at d metres beyond the rim [1/m].
    """

    car_m: Car
    flat_m: float = 3.0
    rise_per_m: float = 0.25

    def height(self, xy_base: np.ndarray) -> np.ndarray:
        """Height of the bowl [m], float64[...], over places float64[... 2] of the base frame."""
        rear, front, right, left = self.car_m
        beyond_x = np.maximum(np.maximum(rear - xy_base[..., 0], xy_base[..., 0] - front), 0.0)
        beyond_y = np.maximum(np.maximum(right - xy_base[..., 1], xy_base[..., 1] - left), 0.0)
        return self.rise_per_m * np.maximum(np.hypot(beyond_x, beyond_y) - self.flat_m, 0.0) ** 2

    def met_by(self, start_base: np.ndarray, ray_base: np.ndarray) -> np.ndarray:
        """Where rays leave the bowl from inside, float64[... 3]; NaN where they do not within 60 m.

        The inside of the bowl is convex, so a ray leaves it once, and halving the way finds where.

        Args:
            start_base: float64[3], inside the bowl.
            ray_base: unit vectors float64[... 3].
        """
        inside = np.zeros(ray_base.shape[:-1])
        outside = np.full(ray_base.shape[:-1], _FARTHEST_M)
        for _ in range(_HALVINGS):
            middle = 0.5 * (inside + outside)
            p_base = start_base + middle[..., None] * ray_base
            is_in = p_base[..., 2] > self.height(p_base[..., :2])
            inside, outside = np.where(is_in, middle, inside), np.where(is_in, outside, middle)
        p_base = start_base + outside[..., None] * ray_base
        return np.where((outside < _FARTHEST_M)[..., None], p_base, np.nan)


@dataclass(frozen=True)
class BowlView:
    """Which pixel of which camera shows each pixel of the view from outside; made once for a rig.

    >>> view = sj.BowlView.around(rig, from_deg=30.0)
    >>> view.stitch(images).shape
    (540, 960, 3)
    """

    image_uv: tuple[np.ndarray, ...]
    """Image pixel of each pixel of the view for each camera, float32[h w 2]; far outside where not visible."""
    best: np.ndarray
    """The camera that shows each pixel finest, int[h w]."""
    resolutions: tuple[tuple[int, int], ...] = field(repr=False)
    """Width and height of the image of each camera [px]."""
    bowl: Bowl
    """The surface that carries the pictures."""
    camera: PinholeCamera
    """The camera outside."""
    T_base_cam: np.ndarray
    """Its pose in the base frame, float64[4 4]."""

    @classmethod
    def around(
        cls,
        rig: Rig,
        from_deg: float = 0.0,
        size_px: tuple[int, int] = (960, 540),
        own_body: Sequence[np.ndarray | None] = (),
        own_car_m: Car | None = None,
    ) -> "BowlView":
        """The view of a car from outside.

        Args:
            rig: the cameras of the pictures.
            from_deg: where the view is taken from: 0 behind the car, 90 right of it, 180 ahead of it.
            size_px: width and height of the view.
            own_body: for each camera bool[h w], True where its picture shows the own car.
            own_car_m: rear, front, right and left end of the car [m]; None takes the rectangle of the cameras.

        Raises:
            SemlocError: the cameras do not surround a car, and its ends are not given.
        """
        car = own_car_m or own_car(rig)
        if car is None:
            raise SemlocError(
                "bowl: the cameras do not stand around a car, so its ends are unknown; give --own-car "
                "REAR,FRONT,RIGHT,LEFT"
            )
        bowl = Bowl(car)
        camera, T = _outside(car, from_deg, size_px)
        grid = np.stack(np.meshgrid(np.arange(size_px[0]), np.arange(size_px[1])), axis=-1).astype(np.float64)
        rays = np.asarray(camera.unproject(grid)[0], dtype=np.float64) @ T[:3, :3].T
        p_base = bowl.met_by(T[:3, 3], rays / np.linalg.norm(rays, axis=-1, keepdims=True))
        bodies = tuple(own_body) or (None,) * len(rig)
        found = [
            camera_table(own, np.asarray(T_base_cam, np.float64), p_base, car, body)
            for own, T_base_cam, body in zip(rig.cameras, rig.T_base_cam, bodies, strict=True)
        ]
        best = np.argmax(np.stack([fineness for _, fineness in found]), axis=0)
        sizes = tuple(own.resolution for own in rig.cameras)
        return cls(tuple(uv for uv, _ in found), best, sizes, bowl, camera, T)

    @cached_property
    def pictures(self) -> PictureStitch:
        """The tables for colour pictures."""
        seen = np.stack([uv[..., 0] > -1e3 for uv in self.image_uv])
        weights = seam_weights(seen, self.best, "gaussian", _SEAM_SIGMA_PX)
        return PictureStitch.of(self.image_uv, weights, self.resolutions)

    def stitch(self, pictures: Sequence[np.ndarray], balance: ColourBalance | None = None) -> np.ndarray:
        """The view uint8[h w 3] of pictures uint8[h w 3], blue green red, in the order of the rig; the car is a box.

        Args:
            pictures: of every camera.
            balance: gains of the cameras; None finds them in these pictures.
        """
        view = self.pictures.stitch(pictures, balance or self.pictures.balance(pictures))
        for corners_base, colour in _faces(self.bowl.car_m, self.T_base_cam[:3, 3]):
            p_cam = (corners_base - self.T_base_cam[:3, 3]) @ self.T_base_cam[:3, :3]
            uv = np.asarray(self.camera.project(p_cam)[0])
            cv2.fillConvexPoly(view, np.round(uv).astype(np.int32), colour, cv2.LINE_AA)
        return view


def _outside(car_m: Car, from_deg: float, size_px: tuple[int, int]) -> tuple[PinholeCamera, np.ndarray]:
    """A camera that looks at the car from above, as far away as its length asks for, inside the bowl."""
    rear, front, right, left = car_m
    middle, turned = np.array([0.5 * (rear + front), 0.5 * (right + left)]), np.deg2rad(from_deg)
    # Behind the car is -x; 90 degrees to its right -y.
    away_m = 0.5 * (front - rear) + _AWAY_M
    eye = middle - away_m * np.array([np.cos(turned), np.sin(turned)])
    T = mounted((float(eye[0]), float(eye[1]), _UP_M), down_deg=_DOWN_DEG, yaw_deg=float(np.rad2deg(turned)))
    width, height = size_px
    focal = _FOCAL_SHARE * width
    camera = PinholeCamera(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), width, height)
    return camera, T


def _faces(car_m: Car, eye_base: np.ndarray) -> list[tuple[np.ndarray, tuple[int, int, int]]]:
    """The sides of the car that the eye sees, corners float64[4 3] with a colour, the roof last."""
    rear, front, right, left = car_m
    top = _CAR_HEIGHT_M
    walls = [
        ((rear, right), (rear, left), eye_base[0] < rear, _END),
        ((front, right), (front, left), eye_base[0] > front, _END),
        ((rear, right), (front, right), eye_base[1] < right, _SIDE),
        ((rear, left), (front, left), eye_base[1] > left, _SIDE),
    ]
    faces = [
        (np.array([(*a, 0.0), (*b, 0.0), (*b, top), (*a, top)]), colour) for a, b, is_seen, colour in walls if is_seen
    ]
    roof = np.array([(rear, right, top), (front, right, top), (front, left, top), (rear, left, top)])
    return [*faces, (roof, _ROOF)]
