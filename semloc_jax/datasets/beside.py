"""Files that people put next to a recording (room: datasets; host).

In: the path of a recording. Out: its calibration and its maps, where they lie in it or beside it.
"""

from pathlib import Path

CALIBRATIONS = ("calib.yaml", "camchain.yaml", "calibration.yaml", "camera_info.yaml", "calib.xml", "calib.json")
MAPS = ("map.geojson", "map.gpkg", "map.osm", "map.xodr")


def calibration_beside(path: Path) -> Path | None:
    """The calibration file in a recording's folder or beside it; None where there is none."""
    return next((place / name for place in _places(path) for name in CALIBRATIONS if (place / name).is_file()), None)


def maps_beside(path: Path) -> dict[str, Path]:
    """Maps in a recording's folder or beside it, by the name of their format."""
    found: dict[str, Path] = {}
    for place in _places(path):
        for name in MAPS:
            if (place / name).is_file():
                found.setdefault(name.split(".")[1], place / name)
    return found


def _places(path: Path) -> list[Path]:
    return [path, path.parent] if path.is_dir() else [path.parent]
