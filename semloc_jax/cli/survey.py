"""`semloc survey`: how well a road can be localized on, before anyone drives it (room: cli)."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from semloc_jax.cli.main import OK
from semloc_jax.reports.survey_placement import Ranges, write_placement

if TYPE_CHECKING:
    from collections.abc import Callable

    from semloc_jax.analysis.survey import Survey, SurveyConfig, Way
    from semloc_jax.cameras import Rig
    from semloc_jax.maps import SemanticMap


@dataclass(frozen=True)
class Options:
    """Expected accuracy along a road, from a map and a calibration alone: no image is needed.

    Writes places.csv, places.geojson, weak.csv, survey.png and config.yaml; with --keep also a small map, with --place
    where a camera should look.
    """

    map: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MAP")]
    """The map."""
    camera: Path
    """Calibration of the cameras."""
    cameras: str | None = None
    """Cameras to use, separated by commas; default: all."""
    path: Path | None = None
    """Trajectory file of the way that is driven, in the frame of the map; default: along the lanes of the map."""
    spacing_m: float = 5.0
    """Distance between places."""
    class_table: str = "drive"
    """What masks will show: a preset or a YAML file."""
    keep: float | None = None
    """Also write a map with this share of the bytes that holds the pose best, e.g. 0.2."""
    place: str | None = None
    """Also say how this camera should be turned, raised and zoomed to know its place best, e.g. front."""
    place_down_deg: tuple[float, float] = (-10.0, 25.0)
    """How far it may be turned downwards from how it is mounted; equal ends hold it."""
    place_rise_m: tuple[float, float] = (-0.5, 0.8)
    """How far it may be mounted higher."""
    place_zoom: tuple[float, float] = (0.6, 2.0)
    """Its focal length against the given one: below 1 the view is wider."""
    place_count: int = 12
    """Number of places that it is judged by, spread evenly over all ways."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "SurveyConfig":
    """The configuration of a survey."""
    from semloc_jax.analysis.survey import SurveyConfig

    return SurveyConfig()


def run(options: Options) -> int:
    """Survey, write, draw, name the weak stretches."""
    import numpy as np
    from tqdm import tqdm

    from semloc_jax import viz
    from semloc_jax.analysis.survey import survey
    from semloc_jax.cameras.io import read_calibration
    from semloc_jax.inputs.choices import parse_names
    from semloc_jax.maps import read_map
    from semloc_jax.perception import load_class_table
    from semloc_jax.reports import results
    from semloc_jax.viz.survey import survey_view

    semantic_map, rig = read_map(options.map), read_calibration(options.camera)
    names = parse_names(options.cameras)
    rig = rig.select(names) if names else rig
    if options.place is not None:
        rig.index(options.place)
    table = load_class_table(options.class_table)
    ways = _ways(options, semantic_map)
    with tqdm(total=sum(len(way.station_m) for way in ways), desc="places", unit="place") as bar:
        found = survey(semantic_map, rig, table, ways, options.settings, lambda: bar.update(1) and None)
    folder = results.make_folder(options.out)
    _write_places(found, semantic_map, folder)
    weak = found.weak_stretches()
    rows = [(s.way, f"{s.from_km:.3f}", f"{s.to_km:.3f}", s.what, f"{s.worst:.4f}") for s in weak]
    results.write_csv(folder / "weak.csv", ("way", "from_km", "to_km", "what", "worst"), rows)
    figure = survey_view(semantic_map.elements, found, f"{semantic_map.name}, cameras {', '.join(rig.names)}")
    record = {key: getattr(options, key) for key in ("spacing_m", "class_table", "cameras", "keep", "place")}
    results.write_record(folder, options.settings, record)
    print(f"picture: {viz.save(figure, folder / 'survey.png')}")
    sigma = np.concatenate([report.sigma for report in found.ways])
    for name, unit, column in zip(("longitudinal", "lateral", "heading"), ("m", "m", "deg"), sigma.T, strict=True):
        print(f"expected sigma {name}: median {np.median(column):.3f} {unit}, worst {column.max():.3f} {unit}")
    for stretch in weak:
        print(f"weak: {stretch}")
    if options.keep is not None:
        _write_small_map(options, semantic_map, rig, ways, folder)
    if options.place is not None:
        places = np.concatenate([way.Ts_map_base for way in ways])
        chosen = places[np.unique(np.linspace(0, len(places) - 1, max(options.place_count, 1)).astype(int))]
        ranges = Ranges(options.place_down_deg, options.place_rise_m, options.place_zoom)
        road = (semantic_map, rig, table, chosen, options.settings)
        print(write_placement(options.place, ranges, *road, options.camera, folder))
    return OK


def _ways(options: Options, semantic_map: "SemanticMap") -> "tuple[Way, ...]":
    from semloc_jax.analysis.lanes import lane_ways
    from semloc_jax.analysis.survey import path_way
    from semloc_jax.evaluation import read_trajectory

    if options.path is None:
        return lane_ways(semantic_map, options.spacing_m)
    return (path_way(options.path.stem, read_trajectory(options.path).T_map_base, options.spacing_m),)


COLUMNS = (
    *("way", "station_m", "x_m", "y_m", "sigma_longitudinal_m", "sigma_lateral_m", "sigma_heading_deg"),
    *("ambiguity", "second_longitudinal_m", "second_lateral_m"),
)


def _write_places(found: "Survey", semantic_map: "SemanticMap", folder: Path) -> None:
    """Write places.csv, and places.geojson in degrees where the map has a place on the earth, else in metres."""
    from semloc_jax.geometry.geodesy import wgs84_from_enu
    from semloc_jax.reports import results

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
    results.write_csv(folder / "places.csv", COLUMNS, rows)
    text = json.dumps({"type": "FeatureCollection", "features": features})
    (folder / "places.geojson").write_text(text, encoding="utf-8")


def _write_small_map(
    options: Options, semantic_map: "SemanticMap", rig: "Rig", ways: "tuple[Way, ...]", folder: Path
) -> None:
    import numpy as np

    from semloc_jax.analysis.selection import small_map
    from semloc_jax.perception import load_class_table

    write, suffix = _format(options.map)
    places = np.concatenate([way.Ts_map_base for way in ways])
    table, size = load_class_table(options.class_table), options.map.stat().st_size if options.map.is_file() else None
    small = small_map(semantic_map, rig, table, places, options.keep, write, size, options.settings)
    path = folder / f"small_map{suffix}"
    write(small.map, path)
    print(f"small map: {path}: {small}")


def _format(path: Path) -> "tuple[Callable[[SemanticMap, Path], None], str]":
    """Writer and suffix of the format of a map, the drive layout for what cannot be written."""
    from semloc_jax.maps.io import write_compact, write_drive_geojson, write_geojson, write_lanelet2

    suffix = path.suffix.lower()
    if suffix in (".osm", ".smap"):
        return {".osm": write_lanelet2, ".smap": write_compact}[suffix], suffix
    if suffix in (".geojson", ".json") and '"frame"' not in path.read_text(encoding="utf-8")[:4000]:
        return write_geojson, ".geojson"
    return write_drive_geojson, ".geojson"
