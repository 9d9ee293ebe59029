"""What the frames of a drive say about a calibration, as arrays for the solver (room: calibration; host).

In: frames, start poses, masks, map, sensors. Out: picture rows, textures of one level, motion, anchors.
Everything is float64 relative to one origin: the way of a whole drive and tenths of a millimetre meet in one cost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.calibration.config import Intrinsics, SelfCalibrationConfig
from semloc_jax.calibration.drive_problem import Anchors, DriveMotion, PictureRows
from semloc_jax.calibration.frames import StartPoses
from semloc_jax.cameras import Camera, Rig
from semloc_jax.datasets import Frame, GnssTrack
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.geometry import rigid
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.localization.map_window import MapWindows
from semloc_jax.maps import SemanticMap
from semloc_jax.perception.cost_maps import cost_maps
from semloc_jax.residuals.alignment import CameraViews, Usable
from semloc_jax.residuals.texture import RampTexture, pack
from semloc_jax.residuals.view import ViewConfig, view
from semloc_jax.structs import ViewSamples

_FOCAL = ("fx", "fy", "cx", "cy")
_FIXED = ("width", "height", "max_radius", "max_theta_rad", "max_phi_rad", "max_height_m")
_VAGUE_M, _VAGUE_RAD = 30.0, 1.0
"""Sigma of the start poses: it only keeps the equations regular where nothing else holds a frame."""
_MARGIN_SHARE = 0.1
"""Share of the image width by which a map sample may lie outside of it and still be kept: the mount may be wrong."""


@dataclass(frozen=True)
class Pictures:
    """Frames, their cameras as the masks show them, and the masks.

    Attributes:
        frames: In time order.
        rig: Cameras in pixels of the masks, mounts as they are given.
        masks: Class ids of every camera of every frame.
        localizer: Map, class table, channels.
    """

    frames: tuple[Frame, ...]
    rig: Rig
    masks: list[list[np.ndarray]]
    localizer: FrameLocalizer

    @classmethod
    def of(cls, frames: Sequence[Frame], rig: Rig, source: MaskSource, localizer: FrameLocalizer) -> "Pictures":
        """Masks of all frames read into memory."""
        rig = source.seen_by(rig.select(source.cameras))
        return cls(tuple(frames), rig, [source.masks(frame) for frame in frames], localizer)


def unknown_fields(camera: Camera, intrinsics: Intrinsics) -> tuple[str, ...]:
    """Fields of a camera model that are to be estimated."""
    if intrinsics == "none":
        return ()
    fields = [name for name in vars(camera) if name not in _FIXED]
    return tuple(name for name in fields if intrinsics == "all" or name in _FOCAL)


def picture_rows(
    pictures: Pictures, rig: Rig, T_map_base: np.ndarray, local: LocalFrame, config: SelfCalibrationConfig
) -> tuple[PictureRows, ...]:
    """What each picture shows of the map, seen with the rig's mounts and lenses from the given poses.

    Args:
        pictures: Frames and masks.
        rig: Cameras in pixels of the masks, with the best mounts so far.
        T_map_base: float64[n 4 4], map frame.
        local: Frame of all positions.
        config: Scene, unknown intrinsics.
    """
    localizer = pictures.localizer
    settings = localizer.config
    windows = MapWindows(localizer.map, settings.search_radius_m, settings.sample_spacing_m, settings.sample_capacity)
    how = config.scene.view_of(ViewConfig(margin_share=_MARGIN_SHARE))
    seen = [_seen(windows, rig, T, localizer.channel_of_label, how, local) for T in T_map_base]
    groups = []
    for group in pictures.rig.groups():
        places = [(i, c) for i in range(len(seen)) for c in group.index]
        frame, camera = (np.array(column) for column in zip(*places, strict=True))
        columns = [np.stack([np.asarray(part[k])[c] for part, c in zip(_picked(seen, frame), camera, strict=True)])
                   for k in range(3)]  # fmt: skip
        stacked = jax.tree.map(
            lambda leaf, g=group, c=camera: jnp.asarray(np.asarray(leaf, np.float64)[[g.index.index(i) for i in c]]),
            group.camera,
        )
        views = CameraViews(
            camera=stacked,
            T_cam_base=jnp.broadcast_to(jnp.eye(4, dtype=jnp.float64), (len(places), 4, 4)),
            p_map=jnp.asarray(columns[0], jnp.float64),
            tangent_map=jnp.zeros(columns[0].shape, jnp.float64),
            channel=jnp.asarray(columns[1], jnp.int32),
            weight=jnp.asarray(columns[2], jnp.float64),
            edge=jnp.zeros(columns[1].shape, jnp.int32),  # a calibration asks for no edge
            index=jnp.asarray(frame * len(pictures.rig) + camera, jnp.int32),
        )
        then = np.stack([_motion_to_picture(pictures, i, c) for i, c in places])
        names = unknown_fields(pictures.rig.cameras[group.index[0]], config.intrinsics)
        groups.append(PictureRows(views, jnp.asarray(frame), jnp.asarray(camera), jnp.asarray(then), names))
    return tuple(groups)


def _picked(seen: list, frame: np.ndarray) -> list:
    return [seen[i] for i in frame]


def _seen(
    windows: MapWindows,
    rig: Rig,
    T: np.ndarray,
    channel_of_label: np.ndarray,
    config: ViewConfig,
    local: LocalFrame,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points in the local frame, channels and weights of each camera, `[cam 3 p]`, `[cam p]`, `[cam p]`."""
    window = windows.around(T[:3, 3])
    near = window.local_map.frame
    samples = _views(window.samples, jnp.asarray(near.from_map(T)), rig, jnp.asarray(channel_of_label), config)
    shift = local.from_map(near.origin_map, np.float64)
    p_map = np.asarray(samples.p_map, np.float64) + shift[:, None]
    return p_map, np.asarray(samples.channel), np.asarray(samples.weight, np.float64)


@partial(jax.jit, static_argnames="config")
def _views(samples, T_local_base, rig, channel_of_label, config: ViewConfig) -> ViewSamples:
    return view(samples, T_local_base, rig, channel_of_label, config)


def _motion_to_picture(pictures: Pictures, frame: int, camera: int) -> np.ndarray:
    """How far the vehicle moved between the time of a frame and that of a picture, which its own rig says."""
    name = pictures.rig.names[camera]
    own = pictures.frames[frame].rig
    nominal = np.asarray(pictures.rig.T_base_cam[camera], np.float64)
    return np.asarray(own.T_base_cam[own.index(name)], np.float64) @ rigid.inverse(nominal)


def level_texture(pictures: Pictures, ramp_px: float, stride: int, finest_stride: int) -> tuple[RampTexture, Usable]:
    """Cost maps of all pictures on one level as one texture, and their usable pixels.

    The texture has room for the level of `finest_stride`: of one size, all levels share a compiled solver.
    """
    config = replace(pictures.localizer.config.cost_maps, ramp_px=(ramp_px,), stride=(stride,))
    table, num = pictures.localizer.shown, len(pictures.rig) * len(pictures.localizer.shown.channels)
    shape = [max(mask.shape[axis] for masks in pictures.masks for mask in masks) for axis in (0, 1)]
    size, most = (num * (-(-shape[0] // s)) * (-(-shape[1] // s)) for s in (stride, finest_stride))
    texels = np.zeros(most * len(pictures.masks), np.uint32)
    usable = []
    for index, masks in enumerate(pictures.masks):
        maps = cost_maps(masks, table, config)
        packed = pack(maps)
        texels[index * size : (index + 1) * size] = np.asarray(packed.texels)
        usable.append(np.asarray(maps.usable))
    texture = RampTexture(
        texels=jnp.asarray(texels),
        start=jnp.asarray(0, jnp.int32),
        height=packed.height[0],
        width=packed.width[0],
        stride=jnp.asarray(stride, jnp.float64),
        ramp_px=jnp.asarray(ramp_px, jnp.float64),
        num_channels=len(table.channels),
    )
    return texture, Usable(jnp.asarray(np.concatenate(usable)), config.usable_stride)


def motion_of(start: StartPoses, config: SelfCalibrationConfig) -> DriveMotion:
    """Motion between the frames by wheels; without them, that the rear axle does not slip sideways or lift off."""
    num = len(start.frames)
    T, jacobian, sqrt_info = np.tile(np.eye(4), (num, 1, 1)), np.zeros((num, 6, 2)), np.zeros((num, 6, 6))
    for i in range(num - 1):
        if start.motion is not None:
            step = start.motion[i]
            # The direction of travel is no unknown here: it defines the mount of the cameras about the vertical.
            T[i], jacobian[i] = step.T_from_to, step.jacobian[:, :2]
            sqrt_info[i] = np.linalg.inv(np.linalg.cholesky(step.covariance))
            continue
        way_m = float(np.linalg.norm(start.T_map_base[i + 1, :3, 3] - start.T_map_base[i, :3, 3]))
        step_s = start.frames[i + 1].time_s - start.frames[i].time_s
        share, noise = config.factors.side_slip_share, config.motion
        # The tangent of a constant turn has no part sideways; neither rate needs to be known for that. That of a turn
        # which changes at a constant rate a has v a t^3 / 12.
        slipped_m = share * np.sqrt(way_m * noise.slip_length_m)
        bent_m = way_m * step_s**2 * np.deg2rad(noise.unknown_yaw_acceleration_degps2) / 12.0
        sqrt_info[i, 0, 1] = 1.0 / max(np.hypot(slipped_m, bent_m), 1e-3)
        sqrt_info[i, 1, 2] = 1.0 / max(noise.heave_share * np.sqrt(way_m * noise.slip_length_m), 1e-3)
    return DriveMotion(jnp.asarray(T), jnp.asarray(jacobian), jnp.asarray(sqrt_info))


def anchors_of(
    start: StartPoses,
    semantic_map: SemanticMap,
    gnss: GnssTrack | None,
    log: MotionLog | None,
    reference: np.ndarray | None,
    local: LocalFrame,
    config: SelfCalibrationConfig,
) -> Anchors:
    """Fixes, road and reference poses of the frames.

    Args:
        start: Frames and start poses.
        semantic_map: Its road surface is taken.
        gnss: Fixes in the map frame.
        log: Carries a frame to the time of a fix; None where there are no wheels.
        reference: Poses from elsewhere, float64[n 4 4], map frame; NaN where unknown.
        local: Frame of all positions.
        config: Standard deviations.
    """
    num, factors = len(start.frames), config.factors
    fix_base, p_fix, fix_info = np.zeros((num, 3)), np.zeros((num, 2)), np.zeros((num, 2))
    point, normal = np.zeros((num, 3)), np.tile([0.0, 0.0, 1.0], (num, 1))
    T_reference, reference_info = start.T_map_base.copy(), np.zeros((num, 6, 6))
    reference_info[:] = np.diag(1.0 / np.array([_VAGUE_M] * 3 + [_VAGUE_RAD] * 3))
    sharp = np.diag(1.0 / np.array([factors.reference_m] * 3 + [np.deg2rad(factors.reference_deg)] * 3))
    for i, (frame, T) in enumerate(zip(start.frames, start.T_map_base, strict=True)):
        plane = semantic_map.ground.plane(T[:2, 3], near_z_m=float(T[2, 3]))
        point[i], normal[i] = [*T[:2, 3], plane.height_at(T[:2, 3])], plane.normal
        if reference is not None and np.isfinite(reference[i]).all():
            T_reference[i], reference_info[i] = reference[i], sharp
        fix = _nearest_fix(gnss, frame.time_s, factors.gnss_reach_s)
        if fix is not None and gnss is not None:
            carried = np.eye(4) if log is None else log.increment(frame.time_s, gnss.time_s[fix]).T_from_to
            if log is None and abs(gnss.time_s[fix] - frame.time_s) > 0.02:
                continue
            fix_base[i] = carried[:3, :3] @ np.array(gnss.antenna_base) + carried[:3, 3]
            p_fix[i] = local.from_map(gnss.p_enu[fix, :2], np.float64)
            fix_info[i] = 1.0 / (factors.gnss_inflation * gnss.sigma_m[fix, :2])
    road = config.scene.road
    road_info = np.tile(1.0 / np.array([road.height_m] + 2 * [np.deg2rad(road.roll_pitch_deg)]), (num, 1))
    point, T_reference = local.from_map(point, np.float64), local.from_map(T_reference, np.float64)
    arrays = (fix_base, p_fix, fix_info, point, normal, road_info, T_reference, reference_info)
    return Anchors(*(jnp.asarray(array) for array in arrays))


def _nearest_fix(gnss: GnssTrack | None, time_s: float, reach_s: float) -> int | None:
    if gnss is None or not len(gnss.time_s):
        return None
    nearest = int(np.argmin(np.abs(gnss.time_s - time_s)))
    return nearest if abs(gnss.time_s[nearest] - time_s) <= reach_s else None
