"""Every reader of the package with a sound input to begin from, and what must hold of whatever it accepts."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from semloc_jax.calibration.ground_points import read_ground_pairs
from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets.nmea import read_nmea
from semloc_jax.datasets.pandaset.cuboids import read_cuboids
from semloc_jax.datasets.pictures import read_picture
from semloc_jax.evaluation import read_trajectory
from semloc_jax.evaluation.metrics import Metric
from semloc_jax.evaluation.report import read_metrics, write_metrics
from semloc_jax.inputs.config_files import read_yaml
from semloc_jax.maps import SemanticMap, read_lane_centers, read_map
from semloc_jax.maps.ground_raster import read_ground_raster
from semloc_jax.maps.io import write_map
from semloc_jax.maps.io.lanes import left_out
from semloc_jax.perception import class_table, load_class_table
from semloc_jax.perception.masks import read_mask
from semloc_jax.perception.network import load_network_preset
from semloc_jax.perception.onnx_header import read_onnx_header
from semloc_jax.storage import npz_arrays
from tests.cameras.calibration_files import calibration_files
from tests.maps.io.apollo_file import write as write_apollo
from tests.maps.io.ngii_files import write_ngii
from tests.maps.io.nuscenes_file import expansion
from tests.perception.onnx_files import red_or_blue

MOST_BYTES = 400_000
TEXTS = {
    "fixes.nmea": """$GPGGA,123519.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,
$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W
$GPGGA,123520.00,4807.040,N,01131.004,E,1,08,0.9,545.4,M,46.9,M,,
""",
    "ground.asc": "ncols 4\nnrows 3\nxllcorner 0\nyllcorner 0\ncellsize 1\nNODATA_value -9999\n" + "1 2 3 4\n" * 3,
    "config.yaml": "verdict:\n  max_cost: 0.6\nframes: '::2'\nseed: 3\n",
    "preset.yaml": "model: net.onnx\nwidth_px: 640\nheight_px: 360\nclass_table: cityscapes\n",
    "pairs.csv": "camera_a,u_a,v_a,camera_b,u_b,v_b\nfront,1.5,2,left,3,4\nfront,5,6,left,7,8.25\n",
}


class Reader(NamedTuple):
    """A file that is damaged, and what reads it: the file itself, or a place in the folder that holds it."""

    name: str
    file: Path
    """The sound input."""
    read: Callable[[Path], object]
    folder: Path | None = None
    """Is copied with the file where a reader wants a folder."""
    opened: Path | None = None
    """What in the folder is given to the reader; None for the folder."""

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
        return copy if self.opened is None else copy / self.opened.relative_to(self.folder)


def _linked(source: str, target: str) -> None:
    Path(target).symlink_to(Path(source).resolve())


def readers(simulated: Path, data: Path | None, place: Path) -> Iterator[Reader]:
    """Readers of maps, calibrations, tables and settings; those of the shared data only where it is there.

    Args:
        simulated: a small simulated drive.
        data: folder of the shared data.
        place: where inputs are written.
    """
    yield from _of_maps(simulated, place)
    yield from _of_calibrations(read_calibration(simulated / "calib.yaml"), place)
    yield from _of_tables(simulated, place)
    if data is not None:
        yield from _of_data(data)


def _of_maps(simulated: Path, place: Path) -> Iterator[Reader]:
    semantic_map = read_map(simulated / "map.geojson")
    for suffix in (".geojson", ".gpkg", ".osm", ".smap"):
        path = place / f"made{suffix}"
        write_map(semantic_map, path)
        yield Reader(f"map {suffix}", path, use_map)
    yield Reader("map of a drive", simulated / "map.geojson", use_map)
    yield Reader("Apollo map", write_apollo(place), use_map)
    (place / "boston.json").write_text(json.dumps(expansion()))
    yield Reader("nuScenes map", place / "boston.json", use_map)
    shapes = place / "ngii"
    shapes.mkdir()
    write_ngii(shapes)
    for name in ("B2_SURFACELINEMARK.shp", "B2_SURFACELINEMARK.dbf", "B2_SURFACELINEMARK.shx", "B3_SURFACEMARK.shp",
                 "B3_SURFACEMARK.prj", "C6_POSTPOINT.shp"):  # fmt: skip
        yield Reader(f"NGII {name}", shapes / name, use_map, shapes)
    town = place / "town"
    town.mkdir()
    write_map(semantic_map, town / "lanelet2.osm")
    (town / "map_projector_info.yaml").write_text("projector_type: LocalCartesian\nmap_origin:\n  latitude: 48.1\n"
                                                  "  longitude: 11.6\n  altitude: 500\n")  # fmt: skip
    yield Reader("projector info", town / "map_projector_info.yaml", use_map, town, town / "lanelet2.osm")


def _of_calibrations(rig: Rig, place: Path) -> Iterator[Reader]:
    folder = place / "calibrations"
    folder.mkdir()
    for kind, path in calibration_files(folder, rig, rig).items():
        is_table = path.parent != folder
        yield Reader(f"calibration {kind}", path, use_calibration, path.parent if is_table else None, path)


def _of_tables(simulated: Path, place: Path) -> Iterator[Reader]:
    yield Reader("trajectory", simulated / "poses_body.tum", use_trajectory)
    yield Reader("picture", next((simulated / "sem").rglob("*.png")), read_picture)
    yield Reader("mask", next((simulated / "sem").rglob("*.png")), read_mask)
    reads = (read_nmea, read_ground_raster, read_yaml, load_network_preset, read_ground_pairs)
    for (name, text), read in zip(TEXTS.items(), reads, strict=True):
        (place / name).write_text(text)
        yield Reader(name, place / name, read)
    yield Reader("network", red_or_blue(place / "net.onnx"), read_onnx_header)
    write_metrics([Metric("lateral", 0.05, "m"), Metric("recall", 0.9, "share")], place / "metrics.json")
    yield Reader("metrics", place / "metrics.json", read_metrics)
    table = place / "table.yaml"
    shutil.copy(Path(class_table.__file__).parent / "class_tables" / "drive.yaml", table)
    yield Reader("class table", table, load_class_table)
    np.save(place / "poses.npy", np.tile(np.eye(4), (5, 1, 1)))
    yield Reader("poses.npy", place / "poses.npy", use_trajectory)
    np.savetxt(place / "poses_kitti.txt", np.tile(np.eye(4)[:3].ravel(), (5, 1)))
    yield Reader("KITTI poses", place / "poses_kitti.txt", use_trajectory)
    np.savez(place / "state.npz", a=np.arange(6.0), b=np.zeros((2, 3), np.float32))
    yield Reader("state.npz", place / "state.npz", lambda path: npz_arrays(path, "state"))


def _of_data(data: Path) -> Iterator[Reader]:
    """Real files of foreign formats, the smallest of each."""
    for suffix in (".xodr", ".osm"):
        found = sorted(data.glob(f"maps_*/**/*{suffix}"), key=lambda path: path.stat().st_size)
        found = [path for path in found if "debug" not in path.name and path.stat().st_size < MOST_BYTES]
        yield from (Reader(f"real {path.name}", path, use_map) for path in found[:2])
    for path in sorted(data.glob("av2_*/**/log_map_archive*.json"))[:1]:
        yield Reader("Argoverse 2 map", path, use_map)
    for pattern in ("fisheye_*/**/*.json", "fisheye_*/**/*.txt", "fisheye_*/**/*.y*ml", "kitti_*/calib*"):
        for path in sorted(data.glob(pattern), key=lambda path: path.stat().st_size)[:1]:
            yield Reader(f"calibration {path.name}", path, use_calibration)
    for path in sorted(data.glob("pandaset_*/annotations/cuboids/*.gz"))[:1]:
        yield Reader("cuboids", path, read_cuboids)


def use_map(path: Path) -> SemanticMap:
    """Reads a map, asks for a place in it, and looks whether every number in it is one."""
    found = read_map(path)
    left_out(path)
    for line in read_lane_centers(path, found.origin):
        assert np.isfinite(line).all(), "a lane that is not finite"
    middle = found.extent.mean(axis=0)
    near = found.query(middle, 100.0)
    assert np.isfinite(found.extent).all(), "an extent that is not finite"
    assert all(np.isfinite(element.points).all() for element in near.elements), "points that are not finite"
    return found


def use_calibration(path: Path) -> Rig:
    """Reads a calibration and looks whether its numbers are numbers and its mounts rotations."""
    rig = read_calibration(path)
    R = np.asarray(rig.T_base_cam)[:, :3, :3]
    assert all(np.isfinite([c.fx, c.fy, c.cx, c.cy]).all() for c in rig.cameras), "a lens that is not finite"
    assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-3), "a mount that is no rotation"
    return rig


def use_trajectory(path: Path) -> object:
    """Reads poses and looks whether they are poses, in the order of time."""
    found = read_trajectory(path)
    R = found.T_map_base[:, :3, :3]
    assert np.isfinite(found.T_map_base).all() and np.isfinite(found.time_s).all(), "poses that are not finite"
    assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-3), "poses that are no rotations"
    assert np.all(np.diff(found.time_s) >= 0.0), "times that go back"
    return found
