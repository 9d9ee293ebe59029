"""Faults that last a whole drive, in three severities: one row each (room: simulation; host).

In: Maker. Out: FaultyDrive. A new fault is one small function in `standing_*` and one row here.
"""

from collections.abc import Callable
from dataclasses import dataclass

from semloc_jax.errors import SemlocError
from semloc_jax.simulation import standing_cameras as cameras
from semloc_jax.simulation import standing_maps as maps
from semloc_jax.simulation import standing_masks as masks
from semloc_jax.simulation import standing_sensors as sensors
from semloc_jax.simulation.faulty_drive import FaultyDrive, Maker

NUM_SEVERITIES = 3
MAP, CALIBRATION, TIME, ODOMETRY, GNSS, MASKS = "map", "calibration", "time", "odometry", "gnss", "masks"
FAMILIES = (MAP, CALIBRATION, TIME, ODOMETRY, GNSS, MASKS)
_WHOLE_MAP = "the map and all that is in it move together: nothing on the vehicle can see it"
_STRETCHED = "a map that is evenly too large is a shift that grows; a few percent lie within tyres and camera height"
_EARLY = (
    "masks of the next frame are, at constant speed, those of a camera that stands farther ahead: only a change of "
    "speed tells, or satellites that are surer than the way between two frames"
)
_MOUNT = "a pure shift of the mount moves all cameras with the pose: nothing on the vehicle can see it"


@dataclass(frozen=True)
class StandingFault:
    """One fault with its sizes.

    Args:
        make: the faulty drive of a maker and a size.
        sizes: of the severities 1, 2 and 3.
        unit: of the sizes.
        family: what is wrong, one of FAMILIES.
        apart: why nothing can see it; empty where something can.
        apart_to: the last severity of which that holds.
    """

    make: Callable[[Maker, float], FaultyDrive]
    sizes: tuple[float, float, float]
    unit: str
    family: str
    apart: str = ""
    apart_to: int = NUM_SEVERITIES


_SHARE, _OF_ELEMENTS = "share", "share of its elements"

STANDING: dict[str, StandingFault] = {
    "map_missing": StandingFault(maps.map_missing, (0.2, 0.4, 0.7), _OF_ELEMENTS, MAP),
    "map_worn": StandingFault(maps.map_worn, (0.5, 1.0, 2.0), "m", MAP),
    "map_scattered": StandingFault(maps.map_scattered, (0.3, 1.0, 3.0), "m", MAP),
    "map_mirrored": StandingFault(maps.map_mirrored, (1.0, 0.7, 0.4), _OF_ELEMENTS, MAP),
    "map_scaled": StandingFault(maps.map_scaled, (0.01, 0.03, 0.1), _SHARE, MAP, _STRETCHED),
    "lines_repainted": StandingFault(maps.lines_repainted, (0.3, 0.5, 1.0), "m", MAP),
    "stretch_repainted": StandingFault(maps.stretch_repainted, (0.3, 0.5, 1.0), "m", MAP),
    "one_side_moved": StandingFault(maps.one_side_moved, (0.3, 0.5, 1.0), "m", MAP),
    "old_lanes": StandingFault(maps.old_lanes, (0.3, 0.5, 1.0), "m", MAP),
    "posts_aside": StandingFault(maps.posts_aside, (0.5, 1.0, 2.0), "m", MAP),
    "posts_along": StandingFault(maps.posts_along, (1.0, 2.0, 4.0), "m", MAP),
    "posts_missing": StandingFault(maps.posts_missing, (0.3, 0.6, 1.0), "share of the posts", MAP),
    "dashes_along": StandingFault(maps.dashes_along, (1.0, 2.0, 4.5), "m", MAP),
    "map_phantoms": StandingFault(maps.phantoms, (0.1, 0.3, 0.6), _OF_ELEMENTS, MAP),
    "map_widths": StandingFault(maps.widths, (1.5, 2.0, 3.0), "factor", MAP),
    "map_heights": StandingFault(maps.heights, (0.1, 0.3, 1.0), "m", MAP),
    "map_shifted": StandingFault(maps.map_shifted, (0.3, 0.5, 1.0), "m", MAP, _WHOLE_MAP),
    "map_turned": StandingFault(maps.map_turned, (0.5, 1.0, 2.0), "deg", MAP, _WHOLE_MAP),
    "camera_yaw": StandingFault(cameras.camera_yaw, (0.5, 0.7, 2.0), "deg", CALIBRATION),
    "camera_pitch_lasting": StandingFault(cameras.camera_pitch_lasting, (0.5, 1.0, 2.0), "deg", CALIBRATION),
    "camera_roll": StandingFault(cameras.camera_roll, (1.0, 2.0, 4.0), "deg", CALIBRATION),
    "camera_height": StandingFault(cameras.camera_height, (0.1, 0.2, 0.4), "m", CALIBRATION),
    "one_camera_yaw": StandingFault(cameras.one_camera_yaw, (0.7, 2.0, 5.0), "deg", CALIBRATION),
    "one_camera_pitch": StandingFault(cameras.one_camera_pitch, (0.7, 2.0, 5.0), "deg", CALIBRATION),
    "focal": StandingFault(cameras.focal, (0.02, 0.05, 0.1), _SHARE, CALIBRATION),
    "aspect": StandingFault(cameras.aspect, (0.02, 0.05, 0.1), _SHARE, CALIBRATION),
    "distortion": StandingFault(cameras.distortion, (0.3, 1.0, 2.0), _SHARE, CALIBRATION),
    "principal_point": StandingFault(cameras.principal_point, (4.0, 12.0, 30.0), "px", CALIBRATION),
    "principal_point_down": StandingFault(cameras.principal_point_down, (4.0, 12.0, 30.0), "px", CALIBRATION),
    "camera_ahead": StandingFault(cameras.camera_ahead, (0.3, 0.5, 1.0), "m", CALIBRATION, _MOUNT),
    "camera_aside": StandingFault(cameras.camera_aside, (0.3, 0.5, 1.0), "m", CALIBRATION, _MOUNT),
    "sensors_late": StandingFault(sensors.sensors_late, (0.1, 0.3, 1.0), "s", TIME),
    "wheels_late": StandingFault(sensors.wheels_late, (0.1, 0.3, 1.0), "s", TIME),
    "fixes_late": StandingFault(sensors.fixes_late, (0.2, 0.5, 1.0), "s", TIME),
    "frames_jitter": StandingFault(sensors.frames_jitter, (0.01, 0.03, 0.06), "s", TIME),
    "frames_missing": StandingFault(sensors.frames_missing, (0.3, 0.6, 0.9), "share of the frames", TIME),
    "odometer_scale": StandingFault(sensors.odometer_scale, (0.03, 0.08, 0.2), _SHARE, ODOMETRY),
    "odometer_slips": StandingFault(sensors.odometer_slips, (0.1, 0.3, 1.0), _SHARE, ODOMETRY),
    "odometer_stuck": StandingFault(sensors.odometer_stuck, (1.0, 2.0, 4.0), "s", ODOMETRY),
    "odometer_silent": StandingFault(sensors.odometer_silent, (0.3, 1.0, 3.0), "s", ODOMETRY),
    "gyro_bias": StandingFault(sensors.gyro_bias, (0.5, 2.0, 5.0), "deg/s", ODOMETRY),
    "gyro_scale": StandingFault(sensors.gyro_scale, (0.1, 0.5, 2.0), _SHARE, ODOMETRY),
    "fixes_left": StandingFault(sensors.fixes_left, (1.75, 3.5, 7.0), "m", GNSS),
    "fixes_along": StandingFault(sensors.fixes_along, (4.0, 8.0, 18.0), "m", GNSS),
    "fixes_too_sure": StandingFault(sensors.fixes_too_sure, (1.0, 2.0, 4.0), "m", GNSS),
    "fixes_spoofed": StandingFault(sensors.fixes_spoofed, (3.0, 6.0, 12.0), "m", GNSS),
    "fixes_jump": StandingFault(sensors.fixes_jump, (3.5, 10.0, 30.0), "m", GNSS),
    "fixes_noisy": StandingFault(sensors.fixes_noisy, (2.0, 5.0, 15.0), "m", GNSS),
    "start_along": StandingFault(sensors.start_along, (2.5, 5.0, 8.0), "m", GNSS),
    "masks_mirrored": StandingFault(masks.masks_mirrored, (0.3, 0.6, 1.0), "share of the frames", MASKS),
    "masks_shifted": StandingFault(masks.masks_shifted, (4.0, 12.0, 30.0), "px", MASKS),
    "masks_shifted_down": StandingFault(masks.masks_shifted_down, (4.0, 12.0, 30.0), "px", MASKS),
    "masks_scaled": StandingFault(masks.masks_scaled, (0.02, 0.05, 0.1), _SHARE, MASKS),
    "masks_rotated": StandingFault(masks.masks_rotated, (1.0, 2.0, 4.0), "deg", MASKS),
    "masks_trembling": StandingFault(masks.masks_trembling, (2.0, 5.0, 10.0), "px", MASKS),
    "masks_lost": StandingFault(masks.masks_lost, (0.3, 0.6, 0.9), "share of the width", MASKS),
    "masks_thin": StandingFault(masks.masks_thin, (1.0, 2.0, 3.0), "px", MASKS),
    "masks_fat": StandingFault(masks.masks_fat, (1.0, 3.0, 6.0), "px", MASKS),
    "masks_spotted": StandingFault(masks.masks_spotted, (0.05, 0.15, 0.4), "share of the image", MASKS),
    "masks_blinking": StandingFault(masks.masks_blinking, (0.3, 0.6, 0.9), "share of the frames", MASKS),
    "paint_lost": StandingFault(masks.paint_lost, (0.3, 0.6, 0.9), "share of the paint", MASKS),
    "false_lines": StandingFault(masks.false_lines, (10.0, 20.0, 40.0), "px", MASKS),
    "own_lane_only": StandingFault(masks.own_lane_only, (0.5, 0.35, 0.2), "share of the width", MASKS),
    "other_masks": StandingFault(masks.other_masks, (0.02, 0.2, 0.5), "share of the drive", MASKS, _EARLY, apart_to=1),
}
"""Faults by name."""


def standing_fault(maker: Maker, name: str, severity: int) -> FaultyDrive:
    """The drive with one of `STANDING` in a severity of 1, 2 or 3.

    Raises:
        SemlocError: there is no such severity, or the drive has not what the fault changes.
    """
    require_severity(name, severity)
    fault = STANDING[name]
    return fault.make(maker, fault.sizes[severity - 1])


def require_severity(name: str, severity: int) -> None:
    """Check that a severity is one.

    Raises:
        SemlocError: it is not.
    """
    if severity not in range(1, NUM_SEVERITIES + 1):
        raise SemlocError(f"fault '{name}': severity {severity}; expected 1 to {NUM_SEVERITIES}, as in {name}:2")
