"""`semloc survey`: how well a road can be localized on, before anyone drives it (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from semloc_jax.cli.main import OK
from semloc_jax.inputs.choices import parse_names

if TYPE_CHECKING:
    from semloc_jax.analysis.survey import SurveyConfig


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
    """Also say how this camera should be turned, raised and zoomed to know the pose best, e.g. front."""
    place_down_deg: tuple[float, float] = (-10.0, 25.0)
    """How far it may be turned downwards from how it is mounted; equal ends hold it."""
    place_rise_m: tuple[float, float] = (-0.5, 0.8)
    """How far it may be mounted higher."""
    place_zoom: tuple[float, float] = (0.6, 2.0)
    """Its focal length against the given one: below 1 the view is wider."""
    place_count: int = 12
    """Number of places that this is based on, spread evenly over all ways."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "SurveyConfig":
    """The configuration of a survey."""
    from semloc_jax.analysis.survey import SurveyConfig

    return SurveyConfig()


def run(options: Options) -> int:
    """Survey, print the expected accuracy and the weak stretches."""
    from semloc_jax.reports.survey import PlacementWish, Ranges, open_road, report_survey

    what = (parse_names(options.cameras), options.class_table, options.path, options.spacing_m)
    road = open_road(options.map, options.camera, *what)
    placement = None
    if options.place is not None:
        ranges = Ranges(options.place_down_deg, options.place_rise_m, options.place_zoom)
        placement = PlacementWish(options.place, ranges, options.place_count)
    kept = {key: getattr(options, key) for key in ("spacing_m", "class_table", "cameras", "keep", "place")}
    print(report_survey(road, options.settings, options.keep, placement, options.out, kept))
    return OK
