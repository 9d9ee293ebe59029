"""`semloc check-calib`: is this calibration right? Numbers, warnings and pictures of it (room: cli)."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from semloc_jax.cli.main import LOST, OK
from semloc_jax.inputs.choices import parse_names

if TYPE_CHECKING:
    import numpy as np

    from semloc_jax.cameras import Rig
    from semloc_jax.datasets import Drive, Frame
    from semloc_jax.maps import LocalMap

_MAP_RADIUS_M = 60.0


@dataclass(frozen=True)
class Options:
    """Check a calibration: what looks wrong in its numbers, and how it looks on a picture.

    For each camera the picture and the same without distortion are drawn with the horizon, a ground grid in the vehicle
    frame (blue lines run ahead every 2 m, amber ones across every 5 m) and, with a map and a pose, the map. All cameras
    together are drawn from above. The horizon must lie on the horizon, poles stand upright in the undistorted picture,
    and lines on the road run on from one camera to the next.

    The exit code is 3 with --strict when something looks wrong.
    """

    path: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE|CALIBRATION")]
    """A drive of any kind, or a calibration file."""
    calib: Path | None = None
    """Calibration file to use for the drive."""
    image: Path | None = None
    """Picture of the (first chosen) camera, or a folder of pictures with the names of the cameras in theirs, where a
    calibration is given."""
    cameras: str | None = None
    """Names of cameras, separated by commas; default: all."""
    frame: int = 0
    """Index of the frame of the drive."""
    map: Path | None = None
    """Map to draw; default: the drive's own."""
    poses: Path | None = None
    """Trajectory of the vehicle for the map; default: the drive's truth, else its fixes."""
    strict: bool = False
    """Exit code 3 when something looks wrong."""
    out: Path | None = None
    """Folder for the pictures; default: results/TIME, to which results/latest points."""


def run(options: Options) -> int:
    """Print what the calibration says and what looks wrong, draw it."""
    from semloc_jax.cameras.plausibility import implausible

    logging.basicConfig(format="%(message)s")
    rig, drive, images = _open(options)
    sizes = {name: (picture.shape[1], picture.shape[0]) for name, picture in images.items()}
    findings = implausible(rig, sizes)
    for name in rig.names:
        print(_line(rig, name))
    for finding in findings:
        print(f"warning: {finding}")
    if not findings:
        print("nothing implausible found; look at the pictures" if images else "nothing implausible found")
    usable = {name: images[name] for name in rig.names if name in images}
    if usable:
        _draw(options, rig, drive, usable, findings)
    return LOST if options.strict and findings else OK


def _open(options: Options) -> "tuple[Rig, Drive | None, dict[str, np.ndarray]]":
    """The rig, the drive where there is one, and a picture (blue green red) of each camera that has one."""
    from semloc_jax.cameras import read_calibration
    from semloc_jax.datasets.detect import is_recording
    from semloc_jax.datasets.pictures import as_colour, read_picture

    names = parse_names(options.cameras)
    drive = _drive(options) if is_recording(options.path) else None
    if drive is None:
        rig = read_calibration(options.calib or options.path)
        rig = rig.select(names) if names else rig
        pictures = {name: as_colour(read_picture(path)) for name, path in _pictures(options.image, rig).items()}
        return rig, None, pictures
    frame = _frame(drive, options.frame)
    rig = frame.rig.select(names) if names else frame.rig
    return rig, drive, {name: frame.image(name) for name in rig.names if frame.has("rgb", name)}


def _drive(options: Options) -> "Drive | None":
    """The drive; None, with a word, where it cannot be opened but its calibration can be read."""
    from semloc_jax.cameras import read_calibration
    from semloc_jax.datasets import open_drive
    from semloc_jax.errors import SemlocError

    try:
        return open_drive(options.path, options.calib)
    except SemlocError as error:
        try:
            read_calibration(options.calib or options.path)
        except SemlocError:
            raise error from None
        logging.getLogger(__name__).warning("the calibration alone is checked: %s", error)
        return None


def _pictures(given: Path | None, rig: "Rig") -> dict[str, Path]:
    """Files by camera: the given one for the first camera, or those of a folder that have a camera in their name."""
    if given is None or not given.is_dir():
        return {} if given is None else {rig.names[0]: given}
    files = sorted(file for file in given.iterdir() if file.suffix.lower() in (".png", ".jpg", ".jpeg", ".bmp"))
    found = {name: next((file for file in files if name.lower() in file.stem.lower()), None) for name in rig.names}
    return {name: file for name, file in found.items() if file is not None}


def _frame(drive: "Drive", index: int) -> "Frame":
    from semloc_jax.errors import SemlocError

    if not -len(drive) <= index < len(drive):
        raise SemlocError(f"drive {drive.name}: no frame {index}; it has {len(drive)} frames")
    return drive.frames[index]


def _line(rig: "Rig", name: str) -> str:
    """What the calibration says of a camera, in one line."""
    import numpy as np

    from semloc_jax.cameras.plausibility import view_angles_deg

    camera, T = rig.cameras[rig.index(name)], np.asarray(rig.T_base_cam[rig.index(name)])
    yaw, pitch, roll = view_angles_deg(T)
    width, height = camera.resolution
    return (
        f"{name}: {type(camera).__name__} {width}x{height} px, f {float(camera.fx):.1f} px, at x {T[0, 3]:.2f} "
        f"y {T[1, 3]:.2f} z {T[2, 3]:.2f} m, looks {yaw:.1f} deg left, {pitch:.1f} deg down, rolled {roll:.1f} deg"
    )


def _draw(options: Options, rig: "Rig", drive: "Drive | None", images: dict, findings: list) -> None:
    import numpy as np

    from semloc_jax import viz
    from semloc_jax.reports import results
    from semloc_jax.viz import calibration

    local_map, T_map_base = _map_around(options, drive)
    rgb = {name: np.ascontiguousarray(picture[..., ::-1]) for name, picture in images.items()}
    folder = results.make_folder(options.out)
    shown = rig.select(list(images))
    fitting = []
    for name, camera, T in zip(shown.names, shown.cameras, np.asarray(shown.T_base_cam), strict=True):
        texts = [finding.text for finding in findings if finding.camera == name]
        size = (rgb[name].shape[1], rgb[name].shape[0])
        # Pictures of another size are drawn as they would look with the calibration scaled to them.
        scaled = camera if size == camera.resolution else camera.resized(*size)
        figure = calibration.calibration_figure(name, rgb[name], scaled, T, local_map, T_map_base, texts)
        print(f"picture: {viz.save(figure, folder / f'calib_{name}.png')}")
        fitting.append(scaled)
    top = calibration.top_view_figure(rgb, type(shown)(fitting, shown.T_base_cam, shown.names))
    print(f"picture: {viz.save(top, folder / 'calib_top_view.png')}")


def _map_around(options: Options, drive: "Drive | None") -> "tuple[LocalMap | None, np.ndarray | None]":
    """The map around the vehicle and its pose, where both are known."""
    from semloc_jax.maps import read_map

    path = options.map or (drive.map_path if drive is not None else None)
    if drive is None or path is None:
        return None, None
    semantic_map = read_map(path)
    frame = _frame(drive, options.frame)
    T = _pose(options, drive, frame, semantic_map)
    if T is None:
        logging.getLogger(__name__).warning("the map is not drawn: no pose is known; give --poses FILE.tum")
        return None, None
    return semantic_map.query(T[:3, 3], _MAP_RADIUS_M), T


def _pose(options: Options, drive: "Drive", frame: "Frame", semantic_map) -> "np.ndarray | None":
    import numpy as np

    from semloc_jax.evaluation import read_trajectory

    if options.poses is not None:
        return read_trajectory(options.poses).interpolate(np.array([frame.time_s]))[0]
    if drive.truth is not None:
        return drive.truth_at(frame)
    if drive.gnss is None or (drive.gnss.origin is not None and semantic_map.origin is None):
        return None
    fix = drive.in_map_of(semantic_map.origin).gnss_prior(frame.time_s)
    return semantic_map.road_pose(float(fix.p_enu[0]), float(fix.p_enu[1]), fix.heading_rad)
