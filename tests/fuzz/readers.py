"""Every reader of the package with a sound input to begin from, and what must hold of whatever it accepts."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets import Drive, open_drive
from semloc_jax.datasets.nmea import read_nmea
from semloc_jax.datasets.pandaset.cuboids import read_cuboids
from semloc_jax.datasets.pictures import read_picture
from semloc_jax.evaluation import read_trajectory
from semloc_jax.inputs.config_files import read_yaml
from semloc_jax.maps import SemanticMap, read_map
from semloc_jax.maps.heights import read_ground_raster
from semloc_jax.maps.io import left_out, write_map
from semloc_jax.perception import class_table, load_class_table
from semloc_jax.perception.network import load_network_preset
from semloc_jax.storage import npz_arrays

MOST_BYTES = 400_000
NMEA = """$GPGGA,123519.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,
$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W
$GPGGA,123520.00,4807.040,N,01131.004,E,1,08,0.9,545.4,M,46.9,M,,
"""
ASC = "ncols 4\nnrows 3\nxllcorner 0\nyllcorner 0\ncellsize 1\nNODATA_value -9999\n" + "1 2 3 4\n" * 3


class Reader(NamedTuple):
    """A file that is damaged, and what reads it: the file itself, or the folder that holds it."""

    name: str
    file: Path
    """The sound input."""
    read: Callable[[Path], object]
    folder: Path | None = None
    """Is copied with the file where a reader wants a folder."""

    def damaged(self, content: bytes, place: Path) -> Path:
        """What the reader is given: the file in `place`, or a copy of the folder with it."""
        if self.folder is None:
            path = place / self.file.name
            path.write_bytes(content)
            return path
        copy = place / self.folder.name
        shutil.copytree(self.folder, copy, symlinks=True, copy_function=_linked)
        path = copy / self.file.relative_to(self.folder)
        path.unlink()
        path.write_bytes(content)
        return copy


def _linked(source: str, target: str) -> None:
    Path(target).symlink_to(Path(source).resolve())


def readers(simulated: Path, data: Path | None, place: Path) -> Iterator[Reader]:
    """Readers with their inputs; those of the shared data only where it is there.

    Args:
        simulated: a small simulated drive.
        data: folder of the shared data.
        place: where inputs are written.
    """
    semantic_map = read_map(simulated / "map.geojson")
    for suffix in (".geojson", ".gpkg", ".osm", ".smap"):
        path = place / f"made{suffix}"
        write_map(semantic_map, path)
        yield Reader(f"map {suffix}", path, _map)
    yield Reader("map of a drive", simulated / "map.geojson", _map)
    for name in ("frames.csv", "gps.csv", "imu.csv", "wheel_odom.csv", "meta.json", "poses_body.tum", "calib.yaml"):
        yield Reader(f"drive {name}", simulated / name, _drive, simulated)
    yield Reader("calibration", simulated / "calib.yaml", read_calibration)
    yield Reader("trajectory", simulated / "poses_body.tum", read_trajectory)
    yield Reader("picture", next((simulated / "sem").rglob("*.png")), read_picture)
    for name, text, read in (
        ("fixes.nmea", NMEA, read_nmea),
        ("ground.asc", ASC, read_ground_raster),
        ("config.yaml", "verdict:\n  max_cost: 0.6\nframes: '::2'\nseed: 3\n", read_yaml),
        (
            "preset.yaml",
            "model: net.onnx\nwidth_px: 640\nheight_px: 360\nclass_table: cityscapes\n",
            load_network_preset,
        ),
    ):
        (place / name).write_text(text)
        yield Reader(name, place / name, read)
    table = place / "table.yaml"
    shutil.copy(Path(class_table.__file__).parent / "class_tables" / "drive.yaml", table)
    yield Reader("class table", table, load_class_table)
    np.save(place / "poses.npy", np.tile(np.eye(4), (5, 1, 1)))
    yield Reader("poses.npy", place / "poses.npy", read_trajectory)
    np.savez(place / "state.npz", a=np.arange(6.0), b=np.zeros((2, 3), np.float32))
    yield Reader("state.npz", place / "state.npz", lambda path: npz_arrays(path, "state"))
    if data is not None:
        yield from _of_data(data)


def _of_data(data: Path) -> Iterator[Reader]:
    """Real files of foreign formats, the smallest of each."""
    for suffix in (".xodr", ".osm"):
        found = sorted(data.glob(f"maps_*/**/*{suffix}"), key=lambda path: path.stat().st_size)
        found = [path for path in found if "debug" not in path.name and path.stat().st_size < MOST_BYTES]
        yield from (Reader(f"real {path.name}", path, _map) for path in found[:2])
    for path in sorted(data.glob("av2_*/**/log_map_archive*.json"))[:1]:
        yield Reader("Argoverse 2 map", path, _map)
    for pattern in ("fisheye_*/**/*.json", "fisheye_*/**/*.txt", "fisheye_*/**/*.y*ml", "kitti_*/calib*"):
        for path in sorted(data.glob(pattern), key=lambda path: path.stat().st_size)[:1]:
            yield Reader(f"calibration {path.name}", path, read_calibration)
    pandaset = data / "pandaset_002"
    if pandaset.is_dir():
        yield Reader("cuboids", next(pandaset.glob("annotations/cuboids/*.gz")), read_cuboids)
        for name in ("camera/front_camera/poses.json", "camera/front_camera/intrinsics.json", "meta/gps.json"):
            yield Reader(f"PandaSet {Path(name).name}", pandaset / name, _drive, pandaset)
        points = pandaset / "semantic_points_per_sweep.npz"
        yield Reader("PandaSet points", points, lambda path: npz_arrays(path, "points"))


def _map(path: Path) -> SemanticMap:
    """Reads a map, asks for a place in it, and looks whether every number in it is one."""
    found = read_map(path)
    left_out(path)
    middle = found.extent.mean(axis=0)
    near = found.query(middle, 100.0)
    assert np.isfinite(found.extent).all(), "an extent that is not finite"
    assert all(np.isfinite(element.points).all() for element in near.elements), "points that are not finite"
    return found


def _drive(path: Path) -> Drive:
    """Opens a drive and looks whether names are plain and times increase."""
    found = open_drive(path)
    ids, times = [frame.id for frame in found.frames], [frame.time_s for frame in found.frames]
    assert len(set(ids)) == len(ids) and not any("/" in name or name in ("", ".", "..") for name in ids), "names"
    assert np.all(np.diff(times) > 0.0), "times that do not increase"
    return found
