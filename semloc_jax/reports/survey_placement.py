"""The part of `semloc survey` that says where a camera should look (room: reports).

In: map, cameras, places. Out: placement.csv, placement.png, placed/ (the calibration with that camera placed), a text.
"""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np

    from semloc_jax.analysis.placement import PlacementReport
    from semloc_jax.analysis.survey import SurveyConfig
    from semloc_jax.cameras import Rig
    from semloc_jax.maps import SemanticMap
    from semloc_jax.perception import ClassTable


class Ranges(NamedTuple):
    """Within what a camera may be placed, against how it is mounted."""

    down_deg: tuple[float, float]
    rise_m: tuple[float, float]
    zoom: tuple[float, float]


def write_placement(
    name: str,
    ranges: Ranges,
    semantic_map: "SemanticMap",
    rig: "Rig",
    table: "ClassTable",
    places: "np.ndarray",
    settings: "SurveyConfig",
    calibration: Path,
    folder: Path,
) -> str:
    """Place a camera for these places `[n 4 4]`, write what was found; returns the text for people."""
    import numpy as np

    from semloc_jax import viz
    from semloc_jax.analysis.placement import PlacementConfig, place_camera
    from semloc_jax.cameras.io.corrected import write_corrected
    from semloc_jax.viz.survey import placement_view

    config = PlacementConfig(settings, *ranges)
    report = place_camera(semantic_map, rig, table, places, name, config)
    files = write_corrected(report.rig, calibration, folder / "placed")
    _write_table(report, places, folder)
    picture = viz.save(placement_view(report, name), folder / "placement.png")
    median = [100 * np.median(sigma, axis=0) for sigma in (report.sigma_before, report.sigma_after)]
    medians = ", ".join(
        f"{what} {before / scale:.3g} -> {after / scale:.3g} {unit}"
        for what, before, after, scale, unit in zip(
            ("longitudinal", "lateral", "heading"), *median, (1, 1, 100), ("cm", "cm", "deg"), strict=True
        )
    )
    lines = (
        f"camera {name} placed for {len(places)} places: {report}",
        f"expected sigma, median: {medians}",
        f"placed camera: {', '.join(map(str, files))}, picture: {picture}",
    )
    return "\n".join(lines)


def _write_table(report: "PlacementReport", places: "np.ndarray", folder: Path) -> None:
    from semloc_jax.reports.tables import write_csv

    directions = ("longitudinal_m", "lateral_m", "heading_deg")
    header = ("x_m", "y_m", *(f"sigma_{what}_{when}" for when in ("before", "after") for what in directions))
    rows = [
        tuple(round(float(value), 5) for value in (*place[:2, 3], *before, *after))
        for place, before, after in zip(places, report.sigma_before, report.sigma_after, strict=True)
    ]
    write_csv(folder / "placement.csv", header, rows)
