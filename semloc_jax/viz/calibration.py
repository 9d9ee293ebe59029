"""A calibration drawn on a picture: horizon, ground grid, map, and the picture without distortion (room: viz).

In: a picture, its camera, where it sits. Out: image arrays and Figures.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from matplotlib.figure import Figure

from semloc_jax.cameras import BevCamera, Camera, CylindricalCamera, PinholeCamera, Rig
from semloc_jax.cameras.bev import T_base_bev
from semloc_jax.maps import LocalMap, sample
from semloc_jax.perception.surround import SurroundView
from semloc_jax.viz.bev import VEHICLE_M
from semloc_jax.viz.overlay import draw_contours, project_contours
from semloc_jax.viz.style import SHIFT, new_figure

_ALONG, _ACROSS, _HORIZON = (64, 196, 255), (255, 179, 0), (255, 255, 255)
"""Grid lines along x, across it, and the horizon, red green blue."""
_GRID_M, _STEP_M = (30.0, 10.0), (5.0, 2.0)
"""Half length and step of the grid along x and y around a narrow camera."""
_WIDE_GRID_M, _WIDE_STEP_M = (12.0, 12.0), (2.0, 2.0)
_LEGEND = "white: horizon   blue: lines ahead   amber: lines across, on the road"
_FAR_M = 1e6
_FISHEYE_DEG = 100.0
"""Wider pictures are drawn on an upright cylinder instead of a plane."""
_SPACING_M, _TOP_VIEW_M = 0.25, 12.0
_DIRECTIONS = {"ahead": 0.0, "left": 90.0, "behind": 180.0, "right": -90.0}


def draw_calibration(
    image: np.ndarray,
    camera: Camera,
    T_base_cam: np.ndarray,
    local_map: LocalMap | None = None,
    T_map_base: np.ndarray | None = None,
) -> np.ndarray:
    """A copy of an RGB picture with the horizon, a ground grid in the vehicle frame, and the map.

    Lines along x are blue (every 2 m), lines across it amber (every 5 m, 2 m in wide pictures), the horizon is white;
    the vehicle's directions stand on it.

    Args:
        image: uint8[h w 3], red green blue.
        camera: Its camera.
        T_base_cam: Where it sits.
        local_map: The map around the vehicle.
        T_map_base: Pose of the vehicle in the map, with `local_map`.
    """
    thick = max(1, round(image.shape[1] / 900))
    picture = np.ascontiguousarray(image).copy()
    if local_map is not None and T_map_base is not None:
        contours = project_contours(sample(local_map, _SPACING_M), local_map.frame, T_map_base, camera, T_base_cam)
        picture = draw_contours(picture, contours, 2 * thick)
    x, y = _grid(T_base_cam, _view_deg(camera) > _FISHEYE_DEG)
    azimuth = np.radians(np.arange(-180.0, 180.5, 0.5))
    horizon = _FAR_M * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
    lines = [*_grid_lines(x, y), (horizon, _HORIZON)]
    for pieces, (_, colour) in zip(_pieces([points for points, _ in lines], camera, T_base_cam), lines, strict=True):
        _draw(picture, pieces, colour, thick)
    _write_labels(picture, camera, T_base_cam, (x, y), thick)
    return picture


def undistorted(image: np.ndarray, camera: Camera, T_base_cam: np.ndarray) -> tuple[np.ndarray, Camera, np.ndarray]:
    """The picture without distortion, with the camera and the place T_base_cam that would have taken it.

    Narrow pictures become those of a pinhole of the same direction. Wide ones are laid on an upright cylinder, in which
    poles stand vertical and the horizon is a straight level line, if the extrinsics are right.
    """
    width, height = camera.resolution
    view_deg = _view_deg(camera)
    R_cam_new = np.eye(3)
    if view_deg <= _FISHEYE_DEG:
        target: Camera = PinholeCamera(camera.fx, camera.fy, camera.cx, camera.cy, width, height)
        T_new = np.asarray(T_base_cam, dtype=np.float64)
    else:
        focal = (width - 1) / np.radians(min(view_deg, 190.0))
        target = CylindricalCamera(focal, 0.5 * (width - 1), 0.35 * height, width, height, fy=focal)
        T_new = _upright(np.asarray(T_base_cam, dtype=np.float64))
        R_cam_new = np.asarray(T_base_cam)[:3, :3].T @ T_new[:3, :3]
    grid = np.stack(np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)), axis=-1)
    ray, sees = (np.asarray(a) for a in target.unproject(grid))
    uv, valid = (np.array(a) for a in camera.project(ray @ R_cam_new.T))
    uv[~(valid & sees)] = -1e4
    picture = cv2.remap(image, uv.astype(np.float32), None, cv2.INTER_LINEAR, borderValue=(22, 26, 33))
    return picture, target, T_new


def calibration_figure(
    name: str,
    image: np.ndarray,
    camera: Camera,
    T_base_cam: np.ndarray,
    local_map: LocalMap | None = None,
    T_map_base: np.ndarray | None = None,
    findings: Sequence[str] = (),
) -> Figure:
    """One camera: its picture and the same without distortion, both with what `draw_calibration` draws."""
    flat, flat_camera, T_flat = undistorted(image, camera, T_base_cam)
    ratio = image.shape[0] / image.shape[1]
    words = [f"! {text}" for text in findings] or ["nothing implausible found"]
    figure = new_figure(15.2, 7.6 * ratio + 0.5 + 0.24 * len(words), dark=True)
    parts = ((image, camera, T_base_cam, name), (flat, flat_camera, T_flat, f"{name}, without distortion"))
    for axes, (picture, model, T, title) in zip(figure.subplots(1, 2), parts, strict=True):
        axes.imshow(draw_calibration(picture, model, T, local_map, T_map_base), interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(title, color="#e8edf4", fontsize=11, loc="left", pad=5)
    figure.text(0.99, 0.01, _LEGEND, color="#c9d1dc", fontsize=9, ha="right", va="bottom")
    colour = "#ff8a80" if findings else "#00e676"
    figure.supxlabel("\n".join(words), color=colour, fontsize=9, x=0.01, ha="left")
    return figure


def top_view_figure(images: Mapping[str, np.ndarray], rig: Rig) -> Figure:
    """All cameras stitched on the plane of the road, with a metric grid, the outline of a car and the camera places.

    Lines on the road run on from one camera to the next where the extrinsics fit each other.
    """
    range_m = _TOP_VIEW_M if max(map(_view_deg, rig.cameras)) > _FISHEYE_DEG else 2 * _TOP_VIEW_M
    T = T_base_bev()
    T[0, 3] = 1.4  # the middle of a car
    bev = BevCamera.covering(range_m, range_m, range_m, range_m, 2 * range_m / 900)
    view = SurroundView.of(rig, bev, T)
    shown = np.full((*bev.resolution[::-1], 3), (22, 26, 33), np.uint8)
    # The finest camera is drawn last: it stays on top.
    for rank in range(len(rig) - 1, -1, -1):
        for index, name in enumerate(rig.names):
            uv = view.image_uv[index]
            chosen = (view.order[rank] == index) & (uv[..., 0] > -1e3)
            picture = cv2.remap(images[name], uv, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            shown[chosen] = picture[chosen]
    x0 = T[0, 3]
    behind, ahead, side = _shown_range(view, x0, range_m)
    figure = new_figure(8.0, 0.7 + 7.4 * (ahead - behind) / (2.0 * side), dark=True)
    axes = figure.subplots()
    axes.imshow(shown, extent=(range_m, -range_m, x0 - range_m, x0 + range_m), interpolation="antialiased")
    axes.fill(VEHICLE_M[:, 1], VEHICLE_M[:, 0], facecolor="none", edgecolor="#ffffff", linewidth=1.2)
    for name, pose in zip(rig.names, np.asarray(rig.T_base_cam), strict=True):
        axes.plot(pose[1, 3], pose[0, 3], "o", color="#00e676", markersize=5)
        tip = pose[:2, 3] + 1.2 * pose[:2, 2]
        axes.plot([pose[1, 3], tip[1]], [pose[0, 3], tip[0]], color="#00e676", linewidth=1.5)
        axes.annotate(name, (tip[1], tip[0]), color="#00e676", fontsize=9, ha="center")
    axes.set_xticks(np.arange(-range_m, range_m + 1, 4))
    axes.set_yticks(np.arange(-range_m, range_m + 1, 4))
    axes.set_ylim(behind, ahead)
    axes.set_xlim(side, -side)
    axes.grid(True, color="#ffffff", alpha=0.25, linewidth=0.6)
    axes.tick_params(colors="#c9d1dc", labelsize=8)
    axes.set_xlabel("y [m], left is left", color="#c9d1dc", fontsize=9)
    axes.set_ylabel("x [m], ahead is up", color="#c9d1dc", fontsize=9)
    return figure


def _shown_range(view: SurroundView, x0: float, range_m: float) -> tuple[float, float, float]:
    """Where the car is and cameras show the road: from behind, to ahead, to either side [m]."""
    seen = np.stack([uv[..., 0] > -1e3 for uv in view.image_uv]).any(axis=0)
    steps = [np.linspace(range_m, -range_m, size) for size in seen.shape]
    x = [*(x0 + steps[0][seen.any(axis=1)]), *VEHICLE_M[:, 0]]
    y = [*steps[1][seen.any(axis=0)], *VEHICLE_M[:, 1]]
    side = max(map(abs, y)) + 1.0
    return max(min(x) - 1.0, x0 - range_m), min(max(x) + 1.0, x0 + range_m), min(side, range_m)


def _grid(T_base_cam: np.ndarray, is_wide: bool) -> tuple[np.ndarray, np.ndarray]:
    """Whole multiples of the step around the camera along x and y [m]."""
    reach, steps = (_WIDE_GRID_M, _WIDE_STEP_M) if is_wide else (_GRID_M, _STEP_M)
    middle = [round(float(T_base_cam[i, 3]) / step) * step for i, step in enumerate(steps)]
    x, y = (np.arange(m - r, m + r + 0.1, s) for m, r, s in zip(middle, reach, steps, strict=True))
    return x, y


def _grid_lines(x: np.ndarray, y: np.ndarray) -> list[tuple[np.ndarray, tuple[int, int, int]]]:
    """Lines on the road with their colours."""
    along, across = np.arange(x[0], x[-1] + 0.05, 0.1), np.arange(y[0], y[-1] + 0.05, 0.1)
    lines = [(np.stack([along, np.full_like(along, at), np.zeros_like(along)], axis=1), _ALONG) for at in y]
    return lines + [(np.stack([np.full_like(across, at), across, np.zeros_like(across)], axis=1), _ACROSS) for at in x]


def _pieces(lines: Sequence[np.ndarray], camera: Camera, T_base_cam: np.ndarray) -> list[list[np.ndarray]]:
    """For each line the runs of pixels that the camera sees; all lines are projected at once."""
    all_uv, all_seen = _seen(np.concatenate(lines), camera, T_base_cam, margin_share=0.05)
    ends = np.cumsum([len(line) for line in lines])[:-1]
    found = []
    for uv, seen in zip(np.split(all_uv, ends), np.split(all_seen, ends), strict=True):
        jump = np.linalg.norm(np.diff(uv, axis=0), axis=1) > 0.1 * float(camera.width)
        cuts = np.flatnonzero(~seen[1:] | ~seen[:-1] | jump) + 1
        found.append([run for run in np.split(uv, cuts) if len(run) > 1])
    return found


def _seen(
    p_base: np.ndarray, camera: Camera, T_base_cam: np.ndarray, margin_share: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    T = np.asarray(T_base_cam, dtype=np.float64)
    uv, valid = (np.asarray(a) for a in camera.project((p_base - T[:3, 3]) @ T[:3, :3]))
    return uv, valid & np.asarray(camera.in_image(uv[:, 0], uv[:, 1], -margin_share * float(camera.width)))


def _draw(picture: np.ndarray, pieces: list[np.ndarray], colour: tuple[int, int, int], thickness_px: int) -> None:
    fixed = [np.round(piece * 2**SHIFT).astype(np.int32) for piece in pieces]
    cv2.polylines(picture, fixed, False, colour, thickness_px, cv2.LINE_AA, SHIFT)


def _write_labels(
    picture: np.ndarray, camera: Camera, T_base_cam: np.ndarray, grid: tuple[np.ndarray, np.ndarray], thick: int
) -> None:
    """Directions on the horizon and metres on the middle lines of the grid, where there is room for them."""
    x, y = grid
    places = {}
    for name, deg in _DIRECTIONS.items():
        places[name] = (_FAR_M * np.cos(np.radians(deg)), _FAR_M * np.sin(np.radians(deg)), 0.0)
    places |= {f"x={at:g} m": (at, y[len(y) // 2], 0.0) for at in x}
    places |= {f"y={at:g} m": (x[len(x) // 2], at, 0.0) for at in y}
    scale = max(picture.shape[1] / 1500.0, 0.4)
    taken: list[np.ndarray] = []
    for name, uv, seen in zip(places, *_seen(np.array(list(places.values())), camera, T_base_cam), strict=True):
        if not seen or any((np.abs(uv - other) < (130.0 * scale, 26.0 * scale)).all() for other in taken):
            continue
        taken.append(uv)
        if name in _DIRECTIONS:
            at = (round(float(uv[0])), round(float(uv[1])))
            cv2.drawMarker(picture, at, _HORIZON, cv2.MARKER_CROSS, 14 * thick, thick)
        width_px = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, scale, thick)[0][0]
        left = min(round(float(uv[0])) + 4 * thick, picture.shape[1] - width_px - 4)
        at = (left, round(float(uv[1])) - 4 * thick)
        for colour, extra in (((8, 10, 14), 3), ((235, 240, 246), 0)):
            cv2.putText(picture, name, at, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, thick + extra, cv2.LINE_AA)


def _view_deg(camera: Camera) -> float:
    """Horizontal field of view [deg]; 190 where the border of the picture is outside of it."""
    width, height = camera.resolution
    middle = 0.5 * (height - 1)
    ray, valid = (np.asarray(a) for a in camera.unproject(np.array([[0.0, middle], [width - 1.0, middle]])))
    if not valid.all():
        return 190.0
    left, right = (np.arctan2(x, z) for x, _, z in ray)
    return float(np.degrees((right - left) % (2.0 * np.pi)))


def _upright(T_base_cam: np.ndarray) -> np.ndarray:
    """The camera turned upright: level, in the direction in which it looks."""
    ahead = np.array([T_base_cam[0, 2], T_base_cam[1, 2], 0.0])
    if np.linalg.norm(ahead) < 1e-3:  # straight down: the top of the picture is ahead
        ahead = np.array([-T_base_cam[0, 1], -T_base_cam[1, 1], 0.0])
    ahead /= np.linalg.norm(ahead)
    down = np.array([0.0, 0.0, -1.0])
    T = np.array(T_base_cam, dtype=np.float64)
    T[:3, :3] = np.stack([np.cross(down, ahead), down, ahead], axis=1)
    return T
