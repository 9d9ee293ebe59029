"""Cameras, odometer and satellite offset of a vehicle from one of its drives (room: calibration; host).

In: a Drive with a wrong calibration, a SemanticMap, masks. Out: SelfCalibration: the corrected rig and vehicle, and
what of it the drive could tell. What a mount is off by, vision alone takes for a vehicle that stands elsewhere; the
gauge is broken by how a vehicle can move and stand: along its wheels, not sideways, on the road.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.level_choice import holds
from semloc_jax.alignment.pose_prior import PriorSource
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.calibration.config import CalibrationPriors, SelfCalibrationConfig
from semloc_jax.calibration.drive_problem import (
    COMMON,
    Anchors,
    CalibrationProblem,
    CalibrationSolution,
    CalibrationState,
    solve_calibration,
)
from semloc_jax.calibration.evidence import (
    Pictures,
    anchors_of,
    level_texture,
    motion_of,
    picture_rows,
    unknown_fields,
)
from semloc_jax.calibration.frames import MIN_FRAMES, StartPoses, start_poses
from semloc_jax.calibration.observability import AXES, Observability, observe
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.inputs.mask_view import TopViewSource
from semloc_jax.maps import SemanticMap
from semloc_jax.residuals.pose_terms import Terms, TermSource, from_origin, joined
from semloc_jax.solvers.arrow import reduced

_NOMINAL = np.array([1.0, *[0.0] * 8])
_UNITS = {"gyro_bias": "deg/s", "gnss_east": "m", "gnss_north": "m", "stance_height": "m"}
_UNITS |= {"stance_roll": "deg", "stance_pitch": "deg", "mask_u": "px", "mask_v": "px"}


@dataclass(frozen=True)
class SelfCalibration:
    """What a drive says about the sensors.

    Attributes:
        rig_before: The calibration to start from, cameras of the masks only.
        rig: The corrected one.
        vehicle: `COMMON` by name: odometer scale (true over measured), gyroscope bias [rad/s], GNSS-to-map offset [m],
            stance of the vehicle on the road [m, rad], what the masks are off beside their estimated offset [px].
        observability: Sigmas and verdicts.
        frames: Those used.
        T_map_base: Their poses, float64[n 4 4], map frame.
        inlier_ratio: Share of the visible contour that fits at the end.
        level_px: Ramp of the level of the cost maps that the result comes from.
        converged: Whether the last level converged.
        notes: What was missing, one sentence each.
    """

    rig_before: Rig
    rig: Rig
    vehicle: dict[str, float]
    observability: Observability
    frames: tuple[Frame, ...]
    T_map_base: np.ndarray
    inlier_ratio: float
    level_px: float
    converged: bool
    notes: tuple[str, ...] = ()


def self_calibrate(
    drive: Drive,
    semantic_map: SemanticMap,
    masks: MaskSource,
    prior: PriorSource,
    config: SelfCalibrationConfig | None = None,
    reference: Trajectory | None = None,
    on_frame: Callable[[LocalizationResult], None] | None = None,
    terms: TermSource | None = None,
) -> SelfCalibration:
    """Mounts (and lenses) of all cameras of the masks, odometer scale and GNSS-to-map offset from one drive.

    Args:
        drive: Frames, sensors and the calibration to start from.
        semantic_map: The map.
        masks: Masks of some cameras; not a top view.
        prior: First guess of the vehicle pose of each frame.
        config: None for the defaults.
        reference: Poses of the vehicle from elsewhere (survey, another localizer): they make the whole mount
            observable. None where there are none.
        on_frame: Called with each frame that was localized for a start.
        terms: What else was measured of the pose of a frame, in the map frame; see `pose_term`.

    Raises:
        SemlocError: too few frames, masks that cannot be used, or a map without classes that they show.
    """
    config = config or SelfCalibrationConfig()
    if isinstance(masks, TopViewSource):
        raise SemlocError("masks 'ipm:...': a top view has lost the cameras; give the masks of the cameras themselves")
    start = start_poses(drive, semantic_map, masks, prior, config, on_frame)
    return calibrate_from(start, drive, semantic_map, masks, config, reference, terms)


def calibrate_from(
    start: StartPoses,
    drive: Drive,
    semantic_map: SemanticMap,
    masks: MaskSource,
    config: SelfCalibrationConfig,
    reference: Trajectory | None = None,
    terms: TermSource | None = None,
) -> SelfCalibration:
    """`self_calibrate` from start poses that are known already."""
    if len(start.frames) < MIN_FRAMES:
        raise SemlocError(f"calibration: given {len(start.frames)} frames; expected at least {MIN_FRAMES}")
    masks = with_common_offset(masks)
    pictures = Pictures.of(start.frames, drive.rig, masks, FrameLocalizer(semantic_map, masks.table, config.scene))
    local = LocalFrame(start.T_map_base[:, :3, 3].mean(axis=0))
    log = MotionLog.of_drive(drive, config.motion) if start.motion is not None else None
    poses = None if reference is None else _reference_poses(reference, start.frames)
    with jax.enable_x64(True):
        anchors = anchors_of(start, semantic_map, drive.gnss, log, poses, local, config)
        told = () if terms is None else joined([from_origin(terms(f), local.origin_map) for f in start.frames])
        solution, level_px = _coarse_to_fine(pictures, start, anchors, told, local, config)
        sigma = _sigmas(pictures.rig, config)
        information = np.asarray(reduced(solution.equations)[0])
    nominal = drive.rig.select(masks.cameras)
    observability = _observability(information, sigma, solution, pictures.rig, config)
    T_map_base = local.to_map(solution.state.T_local_base)
    vehicle = dict(zip(COMMON, np.asarray(solution.state.common).tolist(), strict=True))
    return SelfCalibration(
        rig_before=nominal,
        rig=_corrected(nominal, pictures.rig, solution.state, config),
        vehicle=vehicle,
        observability=observability,
        frames=start.frames,
        T_map_base=T_map_base,
        inlier_ratio=float(solution.inlier_ratio),
        level_px=level_px,
        converged=bool(solution.converged),
        notes=_notes(drive, start.motion is not None, T_map_base),
    )


def with_common_offset(masks: MaskSource) -> MaskSource:
    """The masks with one offset against the images for all cameras: one network and one resizing made them all."""
    if not masks.offset_px:
        return masks
    common = np.median([masks.offset_px.get(name, (0.0, 0.0)) for name in masks.cameras], axis=0)
    return replace(masks, offset_px=dict.fromkeys(masks.cameras, (float(common[0]), float(common[1]))))


def _coarse_to_fine(
    pictures: Pictures,
    start: StartPoses,
    anchors: Anchors,
    terms: Terms,
    local: LocalFrame,
    config: SelfCalibrationConfig,
) -> tuple[CalibrationSolution, float]:
    """The solution of the finest level that the masks hold, and its ramp."""
    rig, widest = pictures.rig, _num_intrinsics(pictures.rig, config)
    state = CalibrationState(
        jnp.asarray(local.from_map(start.T_map_base, np.float64)),
        jnp.asarray(np.asarray(rig.T_base_cam, np.float64)),
        jnp.zeros((len(rig), widest)),
        jnp.asarray(_NOMINAL),
    )
    motion, sigma, best = motion_of(start, config), jnp.asarray(_sigmas(rig, config)), None
    maps = config.scene.cost_maps
    strides = [maps.stride[level] for level in config.levels]
    for ramp_px, stride in zip([maps.ramp_px[level] for level in config.levels], strides, strict=True):
        texture, usable = level_texture(pictures, ramp_px, stride, min(strides))
        T_map_base = local.to_map(state.T_local_base)
        moved = eqx.tree_at(lambda r: r.T_base_cam, rig, np.asarray(state.T_base_cam))
        rows = picture_rows(pictures, moved, T_map_base, local, config)
        gain = jnp.asarray(config.scene.noise.gain(ramp_px))
        nominal = jnp.asarray(np.asarray(rig.T_base_cam, np.float64))
        problem = CalibrationProblem(rows, texture, gain, motion, anchors, nominal, jnp.asarray(_NOMINAL), sigma, terms)
        solution = solve_calibration(problem, state, usable, tolerance=config.tolerance, max_steps=config.max_steps)
        if best is not None and not holds(solution.inlier_ratio, config.min_inlier_ratio):
            break
        best, state = (solution, ramp_px), solution.state
    return best


def _num_intrinsics(rig: Rig, config: SelfCalibrationConfig) -> int:
    return max(len(unknown_fields(camera, config.intrinsics)) for camera in rig.cameras)


def _sigmas(rig: Rig, config: SelfCalibrationConfig) -> np.ndarray:
    """Standard deviations of the priors of all shared unknowns, in the order of the solver; 0 for padding."""
    priors = config.priors
    mount = [priors.mount_m] * 3 + [np.deg2rad(priors.mount_deg)] * 3
    lenses = lens_sigmas(rig, tuple(unknown_fields(camera, config.intrinsics) for camera in rig.cameras), priors)
    stance = [priors.stance_m, np.deg2rad(priors.stance_deg), np.deg2rad(priors.stance_deg)]
    vehicle = [priors.odometer_scale, np.deg2rad(priors.gyro_bias_degps), *[priors.gnss_offset_m] * 2, *stance]
    masks = [priors.mask_px] * 2
    return np.concatenate([np.tile(mount, len(rig)), lenses.ravel(), vehicle, masks])


def lens_sigmas(rig: Rig, fields: tuple[tuple[str, ...], ...], priors: CalibrationPriors) -> np.ndarray:
    """Standard deviations of the unknown fields of each camera, `float64[c k]`; 0 for padding."""
    sigma = np.zeros((len(rig), max(len(names) for names in fields)))
    for row, names, camera in zip(sigma, fields, rig.cameras, strict=True):
        for k, name in enumerate(names):
            focal = priors.focal_share * float(getattr(camera, name)) if name in ("fx", "fy") else 0.0
            row[k] = focal or (priors.center_px if name in ("cx", "cy") else priors.distortion)
    return sigma


def _observability(
    information: np.ndarray,
    sigma: np.ndarray,
    solution: CalibrationSolution,
    rig: Rig,
    config: SelfCalibrationConfig,
) -> Observability:
    """Sigmas and directions, mounts along and about the axes of the vehicle."""
    num, widest = len(rig), _num_intrinsics(rig, config)
    turn = np.eye(len(sigma))
    before, after = np.asarray(rig.T_base_cam, np.float64), np.asarray(solution.state.T_base_cam)
    changes = np.zeros(len(sigma))
    for c in range(num):
        R = after[c, :3, :3]
        turn[6 * c : 6 * c + 3, 6 * c : 6 * c + 3] = turn[6 * c + 3 : 6 * c + 6, 6 * c + 3 : 6 * c + 6] = R
        changes[6 * c : 6 * c + 6] = mount_change(before[c], after[c])
    changes[6 * num : (6 + widest) * num] = np.asarray(solution.state.intrinsics).ravel()
    changes[-len(COMMON) :] = np.asarray(solution.state.common) - _NOMINAL
    names, units = [], []
    for camera in rig.names:
        names += [f"{camera} {axis}" for axis in AXES]
        units += ["m"] * 3 + ["deg"] * 3
    for camera, model in zip(rig.names, rig.cameras, strict=True):
        fields = unknown_fields(model, config.intrinsics)
        fields += ("",) * (widest - len(fields))
        names += [f"{camera} {name}" for name in fields]
        units += ["px" if name in ("fx", "fy", "cx", "cy") else "" for name in fields]
    names += COMMON
    units += [_UNITS.get(name, "") for name in COMMON]
    in_unit = np.where(["deg" in unit for unit in units], np.rad2deg(1.0), 1.0)
    free = np.flatnonzero(sigma > 0)
    return observe(
        (turn @ information @ turn.T)[np.ix_(free, free)],
        [names[k] for k in free],
        [units[k] for k in free],
        (changes * in_unit)[free],
        (sigma * in_unit)[free],
        config.observable_ratio,
        config.held_ratio,
    )


def mount_change(T_before: np.ndarray, T_after: np.ndarray) -> np.ndarray:
    """How a mount moved along (x, y, z [m]) and turned about (roll, pitch, yaw [rad]) the axes of the vehicle."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(T_after[:3, :3] @ T_before[:3, :3].T).as_rotvec()
    return np.concatenate([T_after[:3, 3] - T_before[:3, 3], turn])


def _corrected(nominal: Rig, seen: Rig, state: CalibrationState, config: SelfCalibrationConfig) -> Rig:
    """The rig in pixels of the images; what changed in pixels of the masks is scaled back."""
    cameras = []
    for index, (camera, mask_camera) in enumerate(zip(nominal.cameras, seen.cameras, strict=True)):
        change = np.asarray(state.intrinsics[index])
        for k, name in enumerate(unknown_fields(camera, config.intrinsics)):
            across = mask_camera.width / camera.width if name in ("fx", "cx") else mask_camera.height / camera.height
            scale = across if name in ("fx", "fy", "cx", "cy") else 1.0
            value = np.asarray(float(getattr(camera, name)) + change[k] / float(scale))
            camera = eqx.tree_at(lambda c, n=name: getattr(c, n), camera, value)
        cameras.append(camera)
    return Rig(cameras, np.array(state.T_base_cam, np.float64), nominal.names)


def _reference_poses(reference: Trajectory, frames: tuple[Frame, ...]) -> np.ndarray:
    """Poses of the frames, NaN outside of the trajectory."""
    time_s = np.array([frame.time_s for frame in frames])
    inside = (time_s >= reference.time_s[0] - 1e-6) & (time_s <= reference.time_s[-1] + 1e-6)
    poses = np.full((len(frames), 4, 4), np.nan)
    if inside.any():
        poses[inside] = reference.interpolate(np.clip(time_s[inside], reference.time_s[0], reference.time_s[-1]))
    return poses


def _notes(drive: Drive, has_wheels: bool, T_map_base: np.ndarray) -> tuple[str, ...]:
    """What was missing."""
    notes = []
    if not has_wheels:
        notes.append(
            "no wheel odometry: only that the rear axle does not slip sideways ties the poses; the odometer scale stays"
        )
    if drive.gnss is None:
        notes.append("no satellite fixes: the GNSS offset stays")
    length_m = float(np.linalg.norm(np.diff(T_map_base[:, :3, 3], axis=0), axis=1).sum())
    if length_m < 10.0:
        notes.append(f"the vehicle moved {length_m:.1f} m only: a drive of 100 m with curves tells much more")
    return tuple(notes)
