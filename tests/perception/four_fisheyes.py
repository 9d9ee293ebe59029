"""A car with four fisheyes, and what they see of a road of which every spot is known."""

import cv2
import numpy as np

from semloc_jax.cameras import KannalaBrandtCamera, Rig

PAINT = 15
YAWS_DEG, PLACES = (0.0, 90.0, 180.0, -90.0), ((3.7, 0.0), (1.9, 1.0), (-0.9, 0.0), (1.9, -1.0))
NAMES = ("front", "left", "rear", "right")
TEXEL_M, HALF_M = 0.01, 9.0


def pose(yaw_deg, place, pitch_deg=35.0, height_m=0.9):
    """T_base_cam of a camera that looks `yaw_deg` to the left and `pitch_deg` down."""
    yaw, pitch = np.deg2rad(yaw_deg), np.deg2rad(pitch_deg)
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    T_base_cam = np.eye(4)
    T_base_cam[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T_base_cam[:3, 3] = [*place, height_m]
    return T_base_cam


def four_fisheyes(pitch_deg=35.0):
    """The rig, 640 x 480 px each."""
    cameras = [KannalaBrandtCamera(196.0, 196.0, 319.5, 239.5, 640, 480, -0.013, -0.004)] * 4
    poses = np.stack([pose(*part, pitch_deg) for part in zip(YAWS_DEG, PLACES, strict=True)])
    return Rig(cameras, poses, NAMES)


def seen_ground(rig, height_m=0.0):
    """Place (x, y) [m] of the road that each pixel of each camera sees, and whether it looks down."""
    found = []
    for camera, T in zip(rig.cameras, np.asarray(rig.T_base_cam), strict=True):
        uv = np.stack(np.meshgrid(np.arange(640.0), np.arange(480.0)), axis=-1)
        ray = np.asarray(camera.unproject(uv)[0]) @ T[:3, :3].T
        reach = (T[2, 3] - height_m) / np.maximum(-ray[..., 2], 1e-6)
        found.append((T[:2, 3] + reach[..., None] * ray[..., :2], ray[..., 2] < 0))
    return found


def painted(rig, is_paint, height_m=0.0):
    """Masks of every camera by following the ray of each pixel down to the road: the other way round."""
    return [np.where(is_paint(ground) & down, PAINT, 1).astype(np.uint8) for ground, down in seen_ground(rig, height_m)]


def road_picture(seed=0, lines=()):
    """A road of asphalt, stains and painted bars (x0, y0, x1, y1) [m], uint8[n n 3] at 1 cm, x up, y left."""
    rng = np.random.default_rng(seed)
    size = round(2 * HALF_M / TEXEL_M)
    picture = np.full((size, size), 100.0)
    for grain, depth in ((3, 20.0), (12, 40.0), (40, 25.0)):
        noise = cv2.resize(rng.normal(size=(size // grain, size // grain)), (size, size), interpolation=cv2.INTER_CUBIC)
        picture += depth * cv2.GaussianBlur(noise, None, grain)
    for x0, y0, x1, y1 in lines:
        low, high = texel(np.array([max(x0, x1), max(y0, y1)])), texel(np.array([min(x0, x1), min(y0, y1)]))
        (left, top), (right, bottom) = (np.ceil(corner - 1e-6).astype(int) for corner in (low, high))
        picture[top:bottom, left:right] = 215.0
    return np.repeat(np.clip(picture, 5, 245).astype(np.uint8)[..., None], 3, axis=2)


def texel(p_base):
    """Pixel (u, v) of the road picture of places [m]."""
    p_base = np.asarray(p_base)
    return np.stack([(HALF_M - p_base[..., 1]) / TEXEL_M, (HALF_M - p_base[..., 0]) / TEXEL_M], axis=-1) - 0.5


def photographed(rig, road):
    """Pictures of the road by every camera, uint8[480 640 3]; the sky is blue."""
    pictures = []
    for ground, down in seen_ground(rig):
        uv = np.where(down[..., None], texel(ground), -1e4).astype(np.float32)
        picture = cv2.remap(road, uv, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(90,) * 3)
        picture[~down] = (200, 150, 120)
        pictures.append(picture)
    return pictures
