"""Precise road maps of the National Geographic Information Institute of Korea, as shapefiles (room: maps; host).

In: a folder with B2_SURFACELINEMARK.shp and its neighbours (needs the extra `gis`). Out: SemanticMap in the ENU frame
of its middle. Codes are those of the institute's specification; what it leaves open is in NgiiStyle.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError, install_command
from semloc_jax.geometry.geodesy import enu_from_projected
from semloc_jax.maps.curves import without_repeats
from semloc_jax.maps.elements import VIRTUAL, GeoOrigin, MapElement
from semloc_jax.maps.io.paint import assuming, strokes
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.structs import ElementClass

_LAYERS = ("B1_SAFETYSIGN", "B2_SURFACELINEMARK", "B3_SURFACEMARK", "C1_TRAFFICLIGHT", "C4_SPEEDBUMP", "C6_POSTPOINT")
_POINT_LAYERS = ("C1_TRAFFICLIGHT", "C6_POSTPOINT")
"""Layers of points, which say where something stands and not how high it is."""
_STOP_LINE = "530"
_CROSSINGS = ("5321", "5322", "534")
_STROKES = {"1": ("solid",), "2": ("dashed",), "3": ("dashed", "solid"), "4": ("solid", "dashed")}
"""Third digit of the type of a line mark: its strokes from the left."""
_COLOURS = {"1": "yellow", "2": "white", "3": "blue"}


@dataclass(frozen=True)
class NgiiStyle:
    """Sizes that the format leaves open, after Korean practice for towns; all are our choice."""

    width_m: float = 0.15
    stop_line_width_m: float = 0.45
    double_gap_m: float = 0.12
    dash_m: float = 3.0
    gap_m: float = 5.0


def is_ngii(folder: Path) -> bool:
    """Returns whether a folder holds shapefiles of a precise road map."""
    return folder.is_dir() and any(_shapefile(folder, layer) for layer in _LAYERS)


def read_ngii(folder: str | Path, origin: GeoOrigin | None = None, style: NgiiStyle | None = None) -> SemanticMap:
    """Returns the map in a folder of shapefiles.

    Args:
        folder: holds the layers.
        origin: place of the ENU frame; None takes the middle of the map.
        style: widths and dashes that the format leaves open.

    Raises:
        SemlocError: pyogrio is not installed, a layer is broken or has no reference system.
    """
    folder = Path(folder)
    layers, crs = _layers(folder)
    skipped = _other_layers(folder)
    firsts = np.array([points[0] for features in layers.values() for _, points, _ in features]).reshape(-1, 3)
    if not len(firsts):
        return SemanticMap((), origin, folder.name, dict(skipped))
    origin = origin or _middle(firsts, crs)
    elements: list[MapElement] = []
    for layer, features in layers.items():
        for index, (record, points, closed) in enumerate(features):
            name = str(record.get("ID") or f"{layer}_{index}")
            has_height = bool(np.isfinite(points[:, 2]).all()) and bool((points[:, 2] != 0.0).any())
            # Metres first: widths, dashes and distances mean nothing in a file whose unit is the degree.
            points = enu_from_projected(np.nan_to_num(points), crs, origin)
            found = list(_elements(layer, name, record, points, closed, has_height, style or NgiiStyle()))
            elements += found
            skipped.update([] if found else [f"{layer} {record.get('Kind', '')}".strip()])
            skipped.update([_not_sampled(layer)] if layer in _POINT_LAYERS and found else [])
    return SemanticMap(_with_own_ids(elements), origin, folder.name, dict(skipped))


def _layers(folder: Path) -> tuple[dict[str, list[tuple[dict[str, Any], np.ndarray, bool]]], str]:
    """Returns the features of each known layer, and the reference system that they share."""
    found: dict[str, list] = {}
    crs = ""
    for layer in _LAYERS:
        path = _shapefile(folder, layer)
        if path is None:
            continue
        own, found[layer] = _features(path)
        if not own or (crs and own != crs):
            raise SemlocError(
                f"map {folder.name}: layer {layer} has reference system '{own[:40]}'; expected one for all"
            )
        crs = own
    return found, crs


def _other_layers(folder: Path) -> Counter[str]:
    """Returns how many features each layer holds that is not read."""
    known = {path for layer in (*_LAYERS, "A2_LINK") if (path := _shapefile(folder, layer)) is not None}
    left: Counter[str] = Counter()
    for path in sorted(set(folder.glob("*.[sS][hH][pP]")) - known):
        left[f"layer {path.stem}"] += len(_features(path)[1])
    return left


def _not_sampled(layer: str) -> str:
    return f"{layer}: kept, but no contour (points without a height)"


def _with_own_ids(elements: list[MapElement]) -> tuple[MapElement, ...]:
    """Returns the elements with ids made unique: parts of one record share its id."""
    seen: Counter[str] = Counter()
    found = []
    for element in elements:
        seen[element.id] += 1
        count = seen[element.id]
        found.append(element if count == 1 else replace(element, id=f"{element.id}~{count}"))
    return tuple(found)


def link_lines(folder: Path, origin: GeoOrigin | None) -> Iterator[np.ndarray]:
    """Yields the driving links, which are the centre lines of lanes in their direction, `float64[k 3]`.

    Args:
        folder: holds the layer A2_LINK; nothing where it does not.
        origin: that of the map.
    """
    path = _shapefile(folder, "A2_LINK")
    if path is None or origin is None:
        return
    crs, features = _features(path)
    if not crs:
        raise SemlocError(f"map {folder.name}: layer A2_LINK has no reference system; expected that of the others")
    for _, points, _ in features:
        yield enu_from_projected(np.nan_to_num(points), crs, origin)


def _shapefile(folder: Path, layer: str) -> Path | None:
    return next((path for path in sorted(folder.glob("*.[sS][hH][pP]")) if path.stem.upper().startswith(layer)), None)


def _features(path: Path) -> tuple[str, list[tuple[dict[str, Any], np.ndarray, bool]]]:
    """Returns the reference system of a layer, and attributes, points `[k 3]` and closedness of each part."""
    try:
        import pyogrio
        import shapely
    except ImportError as error:
        raise SemlocError(f"shapefiles need pyogrio, which is not installed; run: {install_command('gis')}") from error
    try:
        meta, _, geometry, fields = pyogrio.raw.read(path)
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, UnicodeDecodeError) as error:
        raise SemlocError(f"map {path.name}: cannot be read ({str(error)[:80]})") from error
    found = []
    for row, blob in enumerate(geometry):
        record = {key: values[row] for key, values in zip(meta["fields"], fields, strict=True)}
        for part in shapely.get_parts(shapely.from_wkb(blob)) if blob is not None else ():
            closed = part.geom_type == "Polygon"
            points = shapely.get_coordinates(part.exterior if closed else part, include_z=True)
            if len(points):
                found.append((record, points[:-1] if closed else points, closed))
    return str(meta["crs"] or ""), found


def _elements(
    layer: str,
    name: str,
    record: dict[str, Any],
    points: np.ndarray,
    closed: bool,
    has_height: bool,
    style: NgiiStyle,
) -> Iterator[MapElement]:
    """Yields the elements of one record; none for kinds that cannot be seen."""
    points = without_repeats(points, closed)
    kind, sort = (str(record.get(key) or "").strip() for key in ("Kind", "Type"))
    told = {"ngii": layer, "kind": kind, "type": sort}
    base = {"has_height": has_height, "attributes": told}
    if layer == "B2_SURFACELINEMARK" and len(points) > 1:
        if kind == _STOP_LINE:
            line = assuming(MapElement(name, ElementClass.STOP_LINE, points, **base), "width")
            yield from strokes(line, ["solid"], style.stop_line_width_m, 0.0, style.dash_m, style.gap_m)
            return
        told["color"] = _COLOURS.get(sort[:1], "")
        line = assuming(MapElement(name, ElementClass.LANE_MARKING, points, **base), "width")
        words = _STROKES.get(sort[2:3], ("solid",))
        words = words * 2 if sort[1:2] == "2" and len(words) == 1 else words
        yield from strokes(line, words, style.width_m, style.double_gap_m, style.dash_m, style.gap_m)
    elif layer == "B3_SURFACEMARK" and closed and len(points) > 2:
        label = ElementClass.CROSSWALK if kind in _CROSSINGS else ElementClass.ROAD_MARK
        yield MapElement(
            name, label, points, closed=True, shape="" if label != ElementClass.ROAD_MARK else kind, **base
        )
    elif layer == "B1_SAFETYSIGN":
        is_plate = closed and len(points) > 2 and bool(np.ptp(points[:, 2]) > 0.1)
        yield MapElement(name, ElementClass.SIGN, points, closed=is_plate, style="" if is_plate else VIRTUAL, **base)
    elif layer == "C4_SPEEDBUMP" and closed and len(points) > 2:
        yield MapElement(name, ElementClass.SPEED_BUMP, points, closed=True, **base)
    elif layer in _POINT_LAYERS:
        label = ElementClass.POLE if layer == "C6_POSTPOINT" else ElementClass.TRAFFIC_LIGHT
        # A point has a position but no height: it is kept and not sampled.
        yield MapElement(name, label, points[:1] + np.array([[0.0] * 3, [0.0, 0.0, 1.0]]), style=VIRTUAL, **base)


def _middle(firsts: np.ndarray, crs: str) -> GeoOrigin:
    """Returns the middle of the first points `[n 3]` of all features on the earth."""
    import pyproj

    x, y = 0.5 * (firsts[:, :2].min(axis=0) + firsts[:, :2].max(axis=0))
    try:
        lon, lat = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(x, y)
    except pyproj.exceptions.CRSError as error:
        raise SemlocError(f"grid '{crs[:80]}': unknown; expected one that pyproj knows") from error
    heights = firsts[np.isfinite(firsts[:, 2]) & (firsts[:, 2] != 0.0), 2]
    height = float(np.median(heights)) if len(heights) else 0.0
    return GeoOrigin(round(float(lat), 5), round(float(lon), 5), round(height, 1))
