"""The package's own drive layout (room: datasets; host).

In: a folder with calib.yaml, frames.csv, rgb/ sem/ sem_net/ CAMERA/ID.*, sensor logs, poses and maps. Out: Drive.
"""

from collections.abc import Iterable
from pathlib import Path

from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets.base import IMAGE, Drive, Frame
from semloc_jax.datasets.sensors import read_gnss, read_imu, read_wheel_odometry
from semloc_jax.datasets.tables import read_rows
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import read_trajectory
from semloc_jax.storage import json_document

TABLE_NAME = "drive"
CLASS_IDS = {
    "unlabeled": 0,
    "road": 1,
    "sidewalk": 2,
    "terrain": 3,
    "building": 4,
    "vegetation": 5,
    "sky": 6,
    "vehicle": 7,
    "ego": 8,
    "lane_solid": 10,
    "lane_dashed": 11,
    "stop_line": 12,
    "crosswalk": 13,
    "arrow": 14,
    "slot_line": 15,
    "speed_bump": 16,
    "pole": 20,
    "sign": 21,
    "traffic_light": 22,
    "pillar": 23,
    "cone": 24,
    "wall": 25,
    "curb": 26,
    "guardrail": 27,
}
"""Class ids of the masks of this layout; a drive states its own in meta.json."""
MASK_SOURCES = ("sem", "sem_net")
_MAPS = {"exact": "map.geojson", "errors": "map_with_errors.geojson"}
_SUFFIXES = {IMAGE: (".jpg", ".png"), "sem": (".png",), "sem_net": (".png",)}


def is_drive(path: Path) -> bool:
    """Whether a folder has this layout."""
    return (path / "frames.csv").is_file() and (path / "calib.yaml").is_file()


def read_drive(path: str | Path, calibration: str | Path | None = None) -> Drive:
    """Drive of a drive folder; sensors, poses and maps that are absent stay None.

    Args:
        path: folder.
        calibration: calibration file instead of its calib.yaml.

    Raises:
        SemlocError: calib.yaml or frames.csv is missing or wrong.
    """
    path = Path(path)
    if not path.is_dir():
        raise SemlocError(f"drive {path}: no such folder; expected calib.yaml, frames.csv and sem/CAMERA/ID.png")
    rig = read_calibration(calibration if calibration is not None else path / "calib.yaml")
    kinds = {kind: suffix for kind in _SUFFIXES if (suffix := _suffix_of(path / kind, _SUFFIXES[kind])) is not None}
    return Drive(
        name=path.resolve().name,
        path=path,
        frames=_read_frames(path, rig, kinds),
        rig=rig,
        table_name=TABLE_NAME,
        class_ids=_class_ids(path / "meta.json"),
        mask_sources=tuple(kind for kind in MASK_SOURCES if kind in kinds),
        maps={kind: path / file for kind, file in _MAPS.items() if (path / file).is_file()},
        truth=read_trajectory(path / "poses_body.tum") if (path / "poses_body.tum").is_file() else None,
        gnss=read_gnss(path / "gps.csv") if (path / "gps.csv").is_file() else None,
        odometry=read_wheel_odometry(path / "wheel_odom.csv") if (path / "wheel_odom.csv").is_file() else None,
        imu=read_imu(path / "imu.csv") if (path / "imu.csv").is_file() else None,
    )


def _read_frames(path: Path, rig: Rig, kinds: dict[str, str]) -> tuple[Frame, ...]:
    frames = []
    for index, row in enumerate(read_rows(path / "frames.csv", ("frame", "t"))):
        try:
            time_s = float(row["t"])
        except ValueError as error:
            raise SemlocError(f"drive {path}: frames.csv row {index + 1}: {error}; expected a time in s") from error
        files = {
            kind: {camera: path / kind / camera / f"{row['frame']}{suffix}" for camera in rig.names}
            for kind, suffix in kinds.items()
        }
        frames.append(Frame(index, row["frame"], time_s, row.get("variant") or "", rig, files))
    if not frames:
        raise SemlocError(f"drive {path}: frames.csv names no frame; expected one line for each image")
    return tuple(sorted(frames, key=lambda frame: frame.time_s))


def _suffix_of(folder: Path, suffixes: Iterable[str]) -> str | None:
    """File ending in use below a folder of camera folders; None where there is no such file."""
    return next((suffix for suffix in suffixes if next(folder.glob(f"*/*{suffix}"), None) is not None), None)


def _class_ids(meta: Path) -> dict[str, int]:
    if not meta.is_file():
        return dict(CLASS_IDS)
    classes = json_document(meta.read_bytes(), f"drive file {meta}").get("classes")
    is_table = isinstance(classes, dict) and all(type(value) is int and 0 <= value < 256 for value in classes.values())
    if not is_table:
        raise SemlocError(
            f'drive file {meta}: no class ids ({str(classes)[:60]}); expected {{"classes": {{"road": 1, ...}}}}, '
            "each id a whole number from 0 to 255"
        )
    return dict(classes)
