"""From radiance to the picture of a camera: blur, bloom, exposure, colours, rain, noise, compression (room: simulation;
host).

In: radiance. Out: uint8 picture. Nothing here moves what is seen by more than a fraction of a pixel.
"""

import cv2
import numpy as np
from jaxtyping import Float, UInt8


def photographed(
    radiance: Float[np.ndarray, "h w 3"], rng: np.random.Generator, is_dark: bool, is_rainy: bool
) -> UInt8[np.ndarray, "h w 3"]:
    """The picture, blue green red.

    Args:
        radiance: one for each pixel of the picture.
        rng: all that is random.
        is_dark: whether it is night: longer exposure, more noise.
        is_rainy: whether rain falls.
    """
    x = _blurred(radiance.astype(np.float32), rng)
    x = x * _exposure(x, rng, is_dark)
    x += rng.uniform(0.0, 0.25) * cv2.GaussianBlur(np.maximum(x - 0.9, 0.0), (0, 0), rng.uniform(3.0, 15.0))
    x += rng.uniform(0.0, 0.12) * (rng.random() < 0.3)  # stray light
    if is_rainy:
        x = _rained_on(x, rng, is_dark)
    x *= _vignette(x.shape, rng)[..., None]
    x = _coloured(x, rng)
    x += _noise(x, rng, is_dark)
    if rng.random() < 0.4:  # sharpened by the camera
        x += rng.uniform(0.2, 1.0) * (x - cv2.GaussianBlur(x, (0, 0), rng.uniform(0.7, 1.5)))
    picture = np.round(255.0 * np.clip(x, 0.0, 1.0)).astype(np.uint8)
    if rng.random() < 0.7:
        _, packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(35, 96))])
        picture = cv2.imdecode(packed, cv2.IMREAD_COLOR)
    return picture


def _blurred(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    if rng.random() < 0.6:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.3, 1.1))
    if rng.random() < 0.2:  # motion, as far to either side
        length, turn = int(rng.integers(1, 4)), rng.uniform(0.0, np.pi)
        kernel = np.zeros((7, 7), np.float32)
        end = np.round(3 + length * np.array([np.cos(turn), np.sin(turn)])).astype(int)
        cv2.line(kernel, tuple(map(int, end)), tuple(map(int, 6 - end)), 1.0, 1)
        x = cv2.filter2D(x, -1, kernel / kernel.sum())
    if rng.random() < 0.3:  # colours are not equally large
        height, width = x.shape[:2]
        for channel, scale in ((0, 1.0 + rng.normal(0.0, 5e-4)), (2, 1.0 + rng.normal(0.0, 5e-4))):
            move = np.array([[scale, 0.0, 0.5 * width * (1 - scale)], [0.0, scale, 0.5 * height * (1 - scale)]])
            x[..., channel] = cv2.warpAffine(x[..., channel], move, (width, height), borderMode=cv2.BORDER_REPLICATE)
    return x


def _exposure(x: np.ndarray, rng: np.random.Generator, is_dark: bool) -> float:
    """What brings the mean to somewhere usual, now and then far off."""
    mean = float(np.clip(x, 0.0, 3.0).mean())
    wanted = rng.uniform(0.04, 0.25) if is_dark else rng.uniform(0.15, 0.6)
    return float(np.clip(wanted / max(mean, 1e-3) * np.exp(rng.normal(0.0, 0.25)), 0.3, 8.0))


def _rained_on(x: np.ndarray, rng: np.random.Generator, is_dark: bool) -> np.ndarray:
    """Streaks in the air, drops on the glass."""
    height, width = x.shape[:2]
    streaks = np.zeros((height, width), np.float32)
    lean = rng.uniform(-0.3, 0.3)
    for _ in range(int(rng.integers(5, 120))):
        u, v, length = rng.uniform(0, width), rng.uniform(0, height), rng.uniform(4.0, 25.0)
        end = int(u + lean * length), int(v + length)
        cv2.line(streaks, (int(u), int(v)), end, float(rng.uniform(0.3, 1.0)), 1, cv2.LINE_AA)
    x = x + rng.uniform(0.02, 0.2) * (0.4 if is_dark else 1.0) * cv2.GaussianBlur(streaks, (0, 0), 0.6)[..., None]
    soft = cv2.GaussianBlur(x, (0, 0), 5.0)
    drops = np.zeros((height, width), np.float32)
    for _ in range(int(rng.integers(0, 12))):
        place = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        cv2.circle(drops, place, int(rng.integers(2, 10)), 1.0, -1, cv2.LINE_AA)
    return x + rng.uniform(0.3, 1.0) * drops[..., None] * (soft - x)


def _vignette(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    height, width = shape[:2]
    center = rng.uniform(0.2, 0.8, 2) * (width, height)
    u, v = (np.arange(width) - center[0]) / width, (np.arange(height)[:, None] - center[1]) / width
    return (1.0 - rng.uniform(0.0, 0.6) * (u * u + v * v)).astype(np.float32)


def _coloured(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """White balance, saturation and the curve of a camera."""
    x = np.maximum(x * np.exp(rng.normal(0.0, 0.07, 3)), 0.0)
    grey = x.mean(axis=2, keepdims=True)
    saturation = 0.0 if rng.random() < 0.08 else rng.uniform(0.4, 1.6)
    x = np.maximum(grey + saturation * (x - grey), 0.0) ** rng.uniform(0.45, 1.0)
    bent = x * x * (3.0 - 2.0 * np.minimum(x, 1.0))
    return (x + rng.uniform(0.0, 0.7) * (bent - x)).astype(np.float32)


def _noise(x: np.ndarray, rng: np.random.Generator, is_dark: bool) -> np.ndarray:
    strength = rng.uniform(0.0, 0.07 if is_dark else 0.03)
    grains = rng.normal(size=x.shape).astype(np.float32)
    if rng.random() < 0.3:
        grains = grains.mean(axis=2, keepdims=True) * 1.7
    return strength * grains
