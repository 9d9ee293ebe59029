"""Drives on which something goes wrong, by name: what a localizer must notice and survive (room: simulation; host).

In: a Drive, the map it is localized in, the name of a fault. Out: FaultyDrive. What is drawn at random is seeded.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from semloc_jax.datasets.base import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.simulation.faulty_drive import (
    FaultSizes,
    FaultyDrive,
    Log,
    Maker,
    MaskChange,
    log_rows,
    seen_through,
    with_late_sensors,
)
from semloc_jax.simulation.hostile import PASSING
from semloc_jax.simulation.standing_cameras import with_mounts
from semloc_jax.simulation.standing_faults import STANDING, require_severity, standing_fault

_USUAL_SEVERITY = 2


def with_fault(
    name: str, drive: Drive, semantic_map: SemanticMap, seed: int = 0, sizes: FaultSizes | None = None
) -> FaultyDrive:
    """The drive with one fault.

    Args:
        name: One of `FAULTS`, or of `STANDING` with its severity of 1 to 3: focal:3.
        drive: The drive as it was.
        semantic_map: The map it is localized in.
        seed: Of what is drawn at random.
        sizes: None for the defaults.

    Raises:
        SemlocError: there is no such fault, or the drive has not what it takes away.

    >>> faulty = sj.with_fault("focal:1", drive, semantic_map)
    >>> faulty.drive.rig.cameras[0].resolution == drive.rig.cameras[0].resolution
    True
    """
    own, _, severity = name.partition(":")
    if own not in FAULTS and own not in STANDING:
        raise SemlocError(f"fault '{name}': not known; expected one of {', '.join([*FAULTS, *STANDING])}")
    maker = Maker(name, drive, semantic_map, sizes or FaultSizes(), np.random.default_rng(seed))
    if own in STANDING:
        return standing_fault(maker, own, int(severity) if severity.isdigit() else _USUAL_SEVERITY)
    if severity and own in PASSING:
        require_severity(own, int(severity) if severity.isdigit() else 0)
        passing = PASSING[own]
        maker = replace(maker, sizes=replace(maker.sizes, **{passing.field: passing.sizes[int(severity) - 1]}))
    return FAULTS[own](maker)


def _none(maker: Maker) -> FaultyDrive:
    return maker.made(maker.drive, maker.begin_s, maker.begin_s)


def _gnss_dropout(maker: Maker) -> FaultyDrive:
    end_s = maker.begin_s + maker.sizes.dropout_s
    is_kept = (maker.gnss.time_s < maker.begin_s) | (maker.gnss.time_s >= end_s)
    return maker.made(replace(maker.drive, gnss=log_rows(maker.gnss, is_kept)), maker.begin_s, end_s)


def _gnss_outliers(maker: Maker) -> FaultyDrive:
    fixes, sizes = maker.gnss, maker.sizes
    is_wrong = maker.rng.random(len(fixes.time_s)) < sizes.outlier_share
    angle = maker.rng.uniform(0.0, 2.0 * np.pi, len(fixes.time_s))
    shift = sizes.outlier_m * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    drive = replace(maker.drive, gnss=replace(fixes, p_enu=fixes.p_enu + is_wrong[:, None] * shift))
    return maker.made(drive, maker.drive.frames[0].time_s, maker.end_s)


def _no_gnss_after_start(maker: Maker) -> FaultyDrive:
    from_s = maker.drive.frames[0].time_s + maker.sizes.fixes_until_s
    return maker.made(replace(maker.drive, gnss=log_rows(maker.gnss, maker.gnss.time_s < from_s)), from_s, maker.end_s)


def _black_images(maker: Maker) -> FaultyDrive:
    # A network that sees nothing says everywhere what it says most.
    return _seen_through(
        maker, lambda mask: np.full_like(mask, np.bincount(mask.ravel()).argmax()), lambda image: np.zeros_like(image)
    )


def _occlusion(maker: Maker) -> FaultyDrive:
    blocked = maker.drive.class_ids.get("vehicle", 255)
    return _seen_through(maker, lambda mask: np.full_like(mask, blocked), lambda image: np.full_like(image, 90))


def _wrong_class_table(maker: Maker) -> FaultyDrive:
    if not maker.drive.class_ids:
        raise SemlocError(f"fault '{maker.name}': drive {maker.drive.name} does not state its class ids")
    other = np.full(256, 255, np.uint8)
    for name, value in maker.drive.class_ids.items():
        other[value] = _CITYSCAPES.get(name, _CITYSCAPES["road"] if value else 255)
    return _seen_through(maker, lambda mask: other[mask], lambda image: image)


_CITYSCAPES = {
    **{"road": 0, "sidewalk": 1, "building": 2, "wall": 3, "pole": 5, "traffic_light": 6, "sign": 7},
    **{"vegetation": 8, "terrain": 9, "sky": 10, "vehicle": 13, "ego": 255},
}
"""Train ids of Cityscapes, where paint is road."""


def _no_odometry(maker: Maker) -> FaultyDrive:
    odometry, end_s = maker.odometry, maker.begin_s + maker.sizes.odometry_s
    is_kept = (odometry.time_s < maker.begin_s) | (odometry.time_s >= end_s)
    return maker.made(replace(maker.drive, odometry=log_rows(odometry, is_kept)), maker.begin_s, end_s)


def _time_offset(maker: Maker) -> FaultyDrive:
    # The truth is that of the exposures: what a frame is off by is what the sensors make of it.
    return maker.whole(drive=with_late_sensors(maker.drive, maker.sizes.clock_s))


def _camera_pitch(maker: Maker) -> FaultyDrive:
    angle = np.deg2rad(maker.sizes.pitch_deg)
    turn = np.eye(4)
    turn[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]

    def bump(Ts_base_cam: np.ndarray) -> None:
        Ts_base_cam[0] = Ts_base_cam[0] @ turn

    return with_mounts(maker, bump)


def _kidnapped(maker: Maker) -> FaultyDrive:
    """A stretch of the way is cut out of frames, sensors and truth, and the clock is set back by the time it took."""
    odometry, from_s = maker.odometry, maker.begin_s
    times = np.array([frame.time_s for frame in maker.drive.frames])
    last = int(np.flatnonzero(times <= from_s)[-1])
    way = odometry.distance_m(times) - odometry.distance_m(times[last : last + 1])
    landed = np.flatnonzero(way >= maker.sizes.jump_m)
    if len(landed) == 0:
        raise SemlocError(
            f"fault 'kidnapped': drive {maker.drive.name} goes on for {way[-1]:.0f} m only; expected more than "
            f"{maker.sizes.jump_m:.0f} m"
        )
    first = int(landed[0])
    cut_s = times[first] - times[last + 1]
    frames = [*maker.drive.frames[: last + 1], *maker.drive.frames[first:]]
    frames = [replace(f, time_s=f.time_s - (cut_s if k > last else 0.0)) for k, f in enumerate(frames)]

    logs = {
        name: _without(log, float(times[last + 1]), float(times[first]))
        for name in ("gnss", "odometry", "imu", "truth")
        if (log := getattr(maker.drive, name)) is not None
    }
    drive = replace(maker.drive, frames=tuple(frames), **logs)
    landing_s = float(frames[last + 1].time_s)
    return FaultyDrive(maker.name, drive, maker.semantic_map, landing_s, landing_s)


def _without(log: Log, from_s: float, to_s: float) -> Log:
    """A log without a stretch of time, what follows set back to its begin."""
    is_before, is_after = log.time_s < from_s - 1e-9, log.time_s >= to_s - 1e-9
    kept = log_rows(log, is_before | is_after)
    return replace(kept, time_s=np.where(kept.time_s >= to_s - 1e-9, kept.time_s - (to_s - from_s), kept.time_s))


def _off_map(maker: Maker) -> FaultyDrive:
    """The map ends where the vehicle is when the fault begins: a plane across its way."""
    frame = min(maker.drive.frames, key=lambda f: abs(f.time_s - maker.begin_s))
    T = maker.drive.truth_at(frame)
    elements = [part for element in maker.semantic_map.elements if (part := _behind(element, T)) is not None]
    return maker.made(maker.drive, frame.time_s, maker.end_s, maker.semantic_map.with_elements(elements))


def _behind(element: MapElement, T_map_base: np.ndarray) -> MapElement | None:
    """The part of an element that lies behind a vehicle; areas and objects that reach over the plane are left out."""
    ahead_m = (element.points - T_map_base[:3, 3]) @ T_map_base[:3, 0]
    if (ahead_m <= 0.0).all():
        return element
    is_behind = np.flatnonzero(ahead_m <= 0.0)
    if element.closed or len(is_behind) < 2 or len(is_behind) != np.ptp(is_behind) + 1:
        return None
    return replace(element, points=element.points[is_behind])


def _seen_through(maker: Maker, change_mask: MaskChange, change_image: MaskChange) -> FaultyDrive:
    """The drive with other masks and images for a short time."""
    end_s = maker.begin_s + maker.sizes.short_s
    changed = seen_through(maker.drive.frames, change_mask, change_image)
    frames = tuple(
        new if maker.begin_s <= old.time_s < end_s else old
        for new, old in zip(changed, maker.drive.frames, strict=True)
    )
    return maker.made(replace(maker.drive, frames=frames), maker.begin_s, end_s)


FAULTS: dict[str, Callable[[Maker], FaultyDrive]] = {
    "none": _none,
    "gnss_dropout": _gnss_dropout,
    "gnss_outliers": _gnss_outliers,
    "no_gnss_after_start": _no_gnss_after_start,
    "black_images": _black_images,
    "occlusion": _occlusion,
    "no_odometry": _no_odometry,
    "wrong_class_table": _wrong_class_table,
    "time_offset": _time_offset,
    "camera_pitch": _camera_pitch,
    "kidnapped": _kidnapped,
    "off_map": _off_map,
}
"""Faults by name; `none` is what the others are compared with."""
