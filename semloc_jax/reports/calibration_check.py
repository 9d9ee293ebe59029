"""The report of a calibration as it stands: what `semloc check-calib` prints and draws (room: reports; host).

In: a drive or a calibration file, pictures, a map. Out: findings, text, pictures with horizon, ground grid and map.
"""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from semloc_jax import viz
from semloc_jax.calibration.inertial_plausibility import LEAST_TURNS, implausible_inertial, implausible_noise
from semloc_jax.calibration.turns_of_cameras import turns_of_cameras
from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.cameras.plausibility import Finding, implausible, view_angles_deg
from semloc_jax.datasets import Drive, Frame, open_drive
from semloc_jax.datasets.detect import is_recording
from semloc_jax.datasets.inertial import read_imu_noise
from semloc_jax.datasets.pictures import as_colour, read_picture
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import read_trajectory
from semloc_jax.inputs.surround_inputs import pictures_by_camera
from semloc_jax.maps import LocalMap, SemanticMap, read_map
from semloc_jax.reports.folder import make_folder
from semloc_jax.storage import output_path
from semloc_jax.viz import calibration as drawing

_LOG = logging.getLogger(__name__)
_MAP_RADIUS_M = 60.0
_TURN_FRAMES = 200
"""Images whose turns are held against those of the inertial sensor: some seconds of driving are enough."""


@dataclass(frozen=True)
class CalibrationCheck:
    """What is checked.

    Args:
        path: A drive of any kind, or a calibration file.
        calib: Calibration file to use for the drive.
        image: Picture of the first camera, or a folder of pictures named by cameras, where `path` is a calibration.
        cameras: Names of cameras; None for all.
        frame: Index of the frame of the drive.
        map: Map to draw; None for the drive's own.
        poses: Trajectory file of the vehicle; None for the drive's truth, else its fixes.
        imu: imu.yaml of Kalibr with the noise of the inertial sensor; None: its noise is not looked at.
    """

    path: Path
    calib: Path | None = None
    image: Path | None = None
    cameras: tuple[str, ...] | None = None
    frame: int = 0
    map: Path | None = None
    poses: Path | None = None
    imu: Path | None = None


class CalibrationReport(NamedTuple):
    """What looks wrong, and the text for people."""

    findings: list[Finding]
    text: str


def report_calibration_check(check: CalibrationCheck, out: Path | None = None) -> CalibrationReport:
    """Check the numbers of a calibration and draw how it looks.

    Args:
        check: What is checked.

    Raises:
        SemlocError: neither a drive nor a calibration can be read.
    """
    rig, drive, images = _open(check)
    sizes = {name: (picture.shape[1], picture.shape[0]) for name, picture in images.items()}
    findings = implausible(rig, sizes) + _inertial(drive, rig, check.imu)
    lines = [_line(rig, name) for name in rig.names] + [f"warning: {finding}" for finding in findings]
    if not findings:
        lines.append("nothing implausible found; look at the pictures" if images else "nothing implausible found")
    if not images:
        lines.append("no picture: no image to draw on" + ("; give --image FILE" if drive is None else " in the drive"))
    usable = {name: images[name] for name in rig.names if name in images}
    if usable:
        lines += [f"picture: {path}" for path in _draw(check, rig, drive, usable, findings, out)]
    return CalibrationReport(findings, "\n".join(lines))


def _inertial(drive: Drive | None, rig: Rig, imu_yaml: Path | None) -> list[Finding]:
    """What looks wrong in the inertial data, where there are any; turns are those of the first camera with images."""
    if drive is None or drive.imu is None:
        return []
    seen = [name for name in rig.names if drive.frames[0].has("rgb", name)]
    frames = [frame for frame in drive.frames[:_TURN_FRAMES] if seen and frame.has("rgb", seen[0])]
    turns = turns_of_cameras(frames, seen[0]) if len(frames) > LEAST_TURNS else None
    found = implausible_inertial(drive.imu, turns)
    return found if imu_yaml is None else found + implausible_noise(drive.imu, read_imu_noise(imu_yaml))


def _open(check: CalibrationCheck) -> tuple[Rig, Drive | None, dict[str, np.ndarray]]:
    """The rig, the drive where there is one, and a picture (blue green red) of each camera that has one."""
    names = check.cameras
    drive = _drive(check) if is_recording(check.path) else None
    if drive is None:
        rig = read_calibration(check.calib or check.path)
        rig = rig.select(names) if names else rig
        pictures = {name: as_colour(read_picture(path)) for name, path in _pictures(check.image, rig).items()}
        return rig, None, pictures
    frame = _frame(drive, check.frame)
    rig = frame.rig.select(names) if names else frame.rig
    return rig, drive, {name: frame.image(name) for name in rig.names if frame.has("rgb", name)}


def _drive(check: CalibrationCheck) -> Drive | None:
    """The drive; None, with a warning, where it cannot be opened but its calibration can be read."""
    try:
        return open_drive(check.path, check.calib)
    except SemlocError as error:
        try:
            read_calibration(check.calib or check.path)
        except SemlocError:
            raise error from None
        _LOG.warning("the calibration alone is checked: %s", error)
        return None


def _pictures(given: Path | None, rig: Rig) -> dict[str, Path]:
    """Files by camera: the given one for the first camera, or those of a folder that have a camera in their name."""
    if given is None or not given.is_dir():
        return {} if given is None else {rig.names[0]: given}
    return pictures_by_camera(given, rig.names)


def _frame(drive: Drive, index: int) -> Frame:
    if not -len(drive) <= index < len(drive):
        raise SemlocError(f"drive {drive.name}: no frame {index}; it has {len(drive)} frames")
    return drive.frames[index]


def _line(rig: Rig, name: str) -> str:
    """The numbers of a camera in one line."""
    camera, T = rig.cameras[rig.index(name)], np.asarray(rig.T_base_cam[rig.index(name)])
    yaw, pitch, roll = view_angles_deg(T)
    width, height = camera.resolution
    return (
        f"{name}: {type(camera).__name__} {width}x{height} px, f {float(camera.fx):.1f} px, at x {T[0, 3]:.2f} "
        f"y {T[1, 3]:.2f} z {T[2, 3]:.2f} m, looks {yaw:z.1f} deg left, {pitch:z.1f} deg down, rolled {roll:z.1f} deg"
    )


def _draw(
    check: CalibrationCheck, rig: Rig, drive: Drive | None, images: dict, findings: list[Finding], out: Path | None
) -> list[Path]:
    """One picture for each camera and one from above."""
    local_map, T_map_base = _map_around(check, drive)
    rgb = {name: np.ascontiguousarray(picture[..., ::-1]) for name, picture in images.items()}
    folder = make_folder(out)
    shown = rig.select(list(images))
    fitting, paths = [], []
    for name, camera, T in zip(shown.names, shown.cameras, np.asarray(shown.T_base_cam), strict=True):
        texts = [finding.text for finding in findings if finding.camera == name]
        size = (rgb[name].shape[1], rgb[name].shape[0])
        # Pictures of another size are drawn as they would look with the calibration scaled to them.
        scaled = camera if size == camera.resolution else camera.resized(*size)
        figure = drawing.calibration_figure(name, rgb[name], scaled, T, local_map, T_map_base, texts)
        paths.append(viz.save(figure, output_path(folder, f"calib_{name}", suffix=".png")))
        fitting.append(scaled)
    top = drawing.top_view_figure(rgb, type(shown)(fitting, shown.T_base_cam, shown.names))
    return [*paths, viz.save(top, folder / "calib_top_view.png")]


def _map_around(check: CalibrationCheck, drive: Drive | None) -> tuple[LocalMap | None, np.ndarray | None]:
    """The map around the vehicle and its pose, where both are known."""
    path = check.map or (drive.map_path if drive is not None else None)
    if drive is None or path is None:
        return None, None
    semantic_map = read_map(path)
    T = _pose(check, drive, _frame(drive, check.frame), semantic_map)
    if T is None:
        _LOG.warning("the map is not drawn: no pose is known; give --poses FILE.tum")
        return None, None
    return semantic_map.query(T[:3, 3], _MAP_RADIUS_M), T


def _pose(check: CalibrationCheck, drive: Drive, frame: Frame, semantic_map: SemanticMap) -> np.ndarray | None:
    if check.poses is not None:
        return read_trajectory(check.poses).interpolate(np.array([frame.time_s]))[0]
    if drive.truth is not None:
        return drive.truth_at(frame)
    if drive.gnss is None or (drive.gnss.origin is not None and semantic_map.origin is None):
        return None
    fix = drive.in_map_of(semantic_map.origin).gnss_prior(frame.time_s)
    _LOG.warning(
        "the map is drawn where the satellite fixes put the vehicle: it may lie metres beside the picture; judge the "
        "calibration by the horizon and the grid, or give --poses FILE.tum of a first run of semloc localize"
    )
    return semantic_map.road_pose(float(fix.p_enu[0]), float(fix.p_enu[1]), fix.heading_rad)
