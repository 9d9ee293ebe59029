"""The report of a survey: what `semloc survey` writes (room: reports; host).

In: a map file, a calibration file. Out: places.csv, places.geojson, weak.csv, survey.png, a small map, a placed camera.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from semloc_jax import viz
from semloc_jax.analysis.lanes import lane_ways
from semloc_jax.analysis.selection import small_map
from semloc_jax.analysis.survey import Survey, SurveyConfig, Way, path_way, survey_ways
from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.evaluation import read_trajectory
from semloc_jax.geometry.geodesy import wgs84_from_enu
from semloc_jax.maps import SemanticMap, read_map
from semloc_jax.maps.io import write_drive_geojson, write_geojson
from semloc_jax.maps.io.formats import FORMATS, format_of
from semloc_jax.perception import ClassTable, load_class_table
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.survey_placement import Ranges, write_placement
from semloc_jax.reports.tables import write_csv
from semloc_jax.storage import write_text
from semloc_jax.viz.survey import survey_view

COLUMNS = (
    *("way", "station_m", "x_m", "y_m", "sigma_longitudinal_m", "sigma_lateral_m", "sigma_heading_deg"),
    *("ambiguity", "second_longitudinal_m", "second_lateral_m"),
)


class SurveyRoad(NamedTuple):
    """What is surveyed.

    Args:
        map_path: the map file.
        map: its content.
        calibration: the calibration file.
        rig: the cameras that are used.
        table: the classes that masks will show.
        ways: the places, in the order of travel.
    """

    map_path: Path
    map: SemanticMap
    calibration: Path
    rig: Rig
    table: ClassTable
    ways: tuple[Way, ...]


class PlacementWish(NamedTuple):
    """Which camera is to be placed, within which ranges, judged by how many places."""

    camera: str
    ranges: Ranges
    num_places: int


def open_road(
    map_path: Path,
    calibration: Path,
    cameras: tuple[str, ...] | None = None,
    class_table: str = "drive",
    path: Path | None = None,
    spacing_m: float = 5.0,
) -> SurveyRoad:
    """The map, the cameras and the places of a survey.

    Args:
        map_path: Any map that `read_map` takes.
        calibration: Calibration file.
        cameras: Names of cameras; None for all.
        class_table: What masks will show: a preset or a YAML file.
        path: Trajectory file of the way in the frame of the map; None for the lanes of the map.
        spacing_m: Distance between places [m].
    """
    semantic_map, rig = read_map(map_path), read_calibration(calibration)
    rig = rig.select(cameras) if cameras else rig
    if path is None:
        ways = lane_ways(semantic_map, spacing_m)
    else:
        ways = (path_way(path.stem, read_trajectory(path).T_map_base, spacing_m),)
    return SurveyRoad(map_path, semantic_map, calibration, rig, load_class_table(class_table), ways)


def report_survey(
    road: SurveyRoad,
    settings: SurveyConfig | None = None,
    keep: float | None = None,
    placement: PlacementWish | None = None,
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> str:
    """Survey a road, write everything, and return the text for people.

    Args:
        road: What is surveyed.
        keep: Share of the bytes of a small map that is written as well; None for none.
        placement: A camera to place as well; None for none.
    """
    settings = settings or SurveyConfig()
    if placement is not None:
        road.rig.index(placement.camera)
    with tqdm(total=sum(len(way.station_m) for way in road.ways), desc="places", unit="place", disable=None) as bar:
        given = (road.map, road.rig, road.table, road.ways, settings)
        found = survey_ways(*given, lambda: bar.update(1) and None)
    folder = make_folder(out)
    _write_places(found, road.map, folder)
    weak = found.weak_stretches()
    rows = [(s.way, f"{s.from_km:.3f}", f"{s.to_km:.3f}", s.what, f"{s.worst:.4f}") for s in weak]
    write_csv(folder / "weak.csv", ("way", "from_km", "to_km", "what", "worst"), rows)
    write_record(folder, settings, options or {})
    figure = survey_view(road.map.elements, found, f"{road.map.name}, cameras {', '.join(road.rig.names)}")
    lines = [f"picture: {viz.save(figure, folder / 'survey.png')}", *_sigma_lines(found)]
    lines += [f"weak: {stretch}" for stretch in weak]
    places = np.concatenate([way.Ts_map_base for way in road.ways])
    if keep is not None:
        lines.append(_write_small_map(road, places, keep, settings, folder))
    if placement is not None:
        lines.append(_write_placement(road, places, placement, settings, folder))
    return "\n".join(lines)


def _sigma_lines(found: Survey) -> list[str]:
    sigma = np.concatenate([report.sigma for report in found.ways])
    columns = zip(("longitudinal", "lateral", "heading"), ("m", "m", "deg"), sigma.T, strict=True)
    return [
        f"expected sigma {name}: median {np.median(column):.3f} {unit}, worst {column.max():.3f} {unit}"
        for name, unit, column in columns
    ]


def _write_places(found: Survey, semantic_map: SemanticMap, folder: Path) -> None:
    """Write places.csv, and places.geojson in degrees where the map has a place on the earth, else in metres."""
    rows, features = [], []
    for report in found.ways:
        places = report.way.Ts_map_base[:, :3, 3]
        shown = places[:, :2]
        if semantic_map.origin is not None:
            lat, lon, _ = wgs84_from_enu(places, semantic_map.origin)
            shown = zip(lon.tolist(), lat.tolist(), strict=True)
        numbers = (report.way.station_m, *places[:, :2].T, *report.sigma.T, report.ambiguity, *report.second_m.T)
        for point, values in zip(shown, zip(*numbers, strict=True), strict=True):
            row = (report.way.name, *(round(float(value), 5) for value in values))
            rows.append(row)
            geometry = {"type": "Point", "coordinates": [round(float(value), 8) for value in point]}
            properties = dict(zip(COLUMNS, row, strict=True))
            features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    write_csv(folder / "places.csv", COLUMNS, rows)
    text = json.dumps({"type": "FeatureCollection", "features": features})
    write_text(folder / "places.geojson", text)


def _write_small_map(road: SurveyRoad, places: np.ndarray, keep: float, settings: SurveyConfig, folder: Path) -> str:
    write, suffix = _format(road.map_path)
    size = road.map_path.stat().st_size if road.map_path.is_file() else None
    small = small_map(road.map, road.rig, road.table, places, keep, write, size, settings)
    path = folder / f"small_map{suffix}"
    write(small.map, path)
    return f"small map: {path}: {small}"


def _format(path: Path) -> tuple[Callable[[SemanticMap, Path], None], str]:
    """Writer and suffix of the format of a map, the drive layout for what cannot be written."""
    if path.suffix.lower() in FORMATS["GeoJSON"].suffixes:
        is_drive = '"frame"' in path.read_text(encoding="utf-8")[:4000]
        return (write_drive_geojson if is_drive else write_geojson), ".geojson"
    row = format_of(path)
    if row is None or row.write is None or row is FORMATS["GeoPackage"]:  # an empty GeoPackage has 100 kB
        return write_drive_geojson, ".geojson"
    return row.write, row.suffixes[0]


def _write_placement(
    road: SurveyRoad, places: np.ndarray, placement: PlacementWish, settings: SurveyConfig, folder: Path
) -> str:
    spread = np.linspace(0, len(places) - 1, max(placement.num_places, 1)).astype(int)
    given = (road.map, road.rig, road.table, places[np.unique(spread)], settings)
    return write_placement(placement.camera, placement.ranges, *given, road.calibration, folder)
