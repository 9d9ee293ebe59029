"""Files that people put next to a recording (room: datasets; host).

In: the path of a recording. Out: its calibration, its maps and its sensor logs, where they lie in it or beside it.
"""

from dataclasses import dataclass
from pathlib import Path

from semloc_jax.datasets.nmea import is_nmea, read_nmea
from semloc_jax.datasets.sensors import GnssTrack, Imu, WheelOdometry, read_gnss, read_imu, read_wheel_odometry
from semloc_jax.evaluation.trajectory import Trajectory, read_trajectory

CALIBRATIONS = ("calib.yaml", "camchain.yaml", "calibration.yaml", "camera_info.yaml", "calib.xml", "calib.json")
POSES = ("poses_body.tum", "poses.tum", "poses.txt", "poses.npy")
FIXES = ("gps.csv", "gnss.csv", "gps.nmea", "gnss.nmea", "nmea.txt", "gps.txt")


@dataclass(frozen=True)
class Logs:
    """Sensor logs; None where there are none."""

    gnss: GnssTrack | None = None
    odometry: WheelOdometry | None = None
    imu: Imu | None = None
    truth: Trajectory | None = None


def calibration_beside(path: Path) -> Path | None:
    """The calibration file in a recording's folder or beside it; None where there is none."""
    return next((place / name for place in _places(path) for name in CALIBRATIONS if (place / name).is_file()), None)


def maps_in(folder: Path) -> dict[str, Path]:
    """Maps in a folder by their suffix: files called `map` of any format, in the order of the table of formats."""
    from semloc_jax.maps.io.formats import MAP_SUFFIXES  # loads all readers: only whoever looks for maps pays for them

    return {suffix[1:]: folder / f"map{suffix}" for suffix in MAP_SUFFIXES if (folder / f"map{suffix}").is_file()}


def maps_beside(path: Path) -> dict[str, Path]:
    """Maps in a recording's folder or beside it; of one format the nearest."""
    found: dict[str, Path] = {}
    for place in _places(path):
        found = found | {kind: file for kind, file in maps_in(place).items() if kind not in found}
    return found


def logs_beside(path: Path) -> Logs:
    """Fixes (gps.csv or NMEA), odometry, inertial data and poses in a recording's folder or, of a file, beside it.

    Raises:
        SemlocError: a log is there and is not what its name says.
    """
    folder = path if path.is_dir() else path.parent
    fixes, wheels, inertial = folder_file(folder, FIXES), folder / "wheel_odom.csv", folder / "imu.csv"
    poses = folder_file(folder, POSES)
    return Logs(
        gnss=None if fixes is None else read_fixes(fixes),
        odometry=read_wheel_odometry(wheels) if wheels.is_file() else None,
        imu=read_imu(inertial) if inertial.is_file() else None,
        truth=None if poses is None else read_trajectory(poses),
    )


def read_fixes(path: Path) -> GnssTrack:
    """Satellite fixes of a table or of NMEA sentences.

    Raises:
        SemlocError: it is neither.
    """
    return read_nmea(path) if is_nmea(path) else read_gnss(path)


def folder_file(folder: Path, names: tuple[str, ...]) -> Path | None:
    """The first of the names that is a file in a folder."""
    return next((folder / name for name in names if (folder / name).is_file()), None)


def _places(path: Path) -> list[Path]:
    return [path, path.parent] if path.is_dir() else [path.parent]
