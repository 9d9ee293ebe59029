"""Elements out of the picture of the road from above: dashes, lines, curbs, bars, outlines (room: mapping; host).

In: EvidenceGrid, what its layers mean, height of the road. Out: MapElements.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_filter

from semloc_jax.geometry import polyline
from semloc_jax.mapping.crossing_curbs import uncrossed
from semloc_jax.mapping.evidence_grid import TILE, EvidenceGrid
from semloc_jax.mapping.line_pieces import cut_to, joined
from semloc_jax.mapping.outlines import find_outlines, find_rectangles
from semloc_jax.mapping.short_dashes import SpotLimits, rows_of_spots
from semloc_jax.mapping.stroke_profiles import TraceLimits
from semloc_jax.mapping.strokes import PaintTrace, find_strokes
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

HeightOf = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
"""Height of the road at places [m]."""

STROKES = (ElementClass.LANE_MARKING, ElementClass.SLOT_LINE, ElementClass.CURB, ElementClass.STOP_LINE)
RECTANGLES = (ElementClass.CROSSWALK, ElementClass.SPEED_BUMP)
_BLOCK_TILES = 4
"""Tiles along the side of a block: 51 m at 2.5 cm."""
_MARGIN_M = 8.5
"""Seen around a block: an element that is no longer is seen whole by the block that holds its middle."""
_BORDER = 3.0
"""Cells by which the middles of one element may differ as two blocks see it."""
_CUT_GAP_M = 0.3
"""Between the pieces of a line that was cut at the border of a block."""
_ALONG_M = 0.6
"""A line that runs along another for longer than this is the same line from there on."""
_LINE_REACH_M, _STOP_REACH_M = 0.3, 0.5
"""Paint is looked at so far to either side of the middle of a line, and of a stop line, which is broader."""
_SLENDER = 3.0
"""A stop line is longer than so many times its width."""
_KNOT_M = 1.0
_SMOOTHED_M = 2.0
_SOLID_VOTE = 0.5


@dataclass(frozen=True)
class VectorConfig:
    """What becomes an element. All values are ours.

    Args:
        min_looks: frames that must have looked at a cell.
        blur_cells: standard deviation of the blur before paint is followed.
        min_area_m2: smaller patches are noise.
        widest_line_m: wider paint is no line.
        widest_stop_line_m: wider paint is no stop line.
        shortest_stop_line_m: a shorter one is a piece of one, or noise.
        line_share: share of the looks at a cell that must show a lane marking.
        slot_line_share: the same of a slot line, which is thin and seen from the side.
        longest_dash_m: a longer stroke is a solid line.
        shortest_line_m: a shorter solid line is noise.
        spot_share: share of the looks that must show a spot of a row: small and seen from the side.
        shortest_spot_m: side of the square that is as large as the smallest one.
        spot_gap_m: farthest from one of a row to the next.
        joined_gap_m: pieces of one solid line with a longer gap stay apart.
        joined_off_m: pieces farther off each other's direction stay apart.
    """

    min_looks: int = 3
    blur_cells: float = 1.0
    min_area_m2: float = 0.03
    widest_line_m: float = 0.35
    widest_stop_line_m: float = 0.7
    shortest_stop_line_m: float = 1.0
    line_share: float = 0.5
    slot_line_share: float = 0.35
    longest_dash_m: float = 7.0
    shortest_line_m: float = 0.6
    spot_share: float = 0.3
    shortest_spot_m: float = 0.12
    spot_gap_m: float = 3.0
    joined_gap_m: float = 6.0
    joined_off_m: float = 0.12


@dataclass(frozen=True)
class Layer:
    """What one layer of the grid shows.

    Args:
        label: class of the elements.
        planes: layers of the grid that are added up.
        dashed: those of them whose masks say that the line is broken.
        says_style: whether the masks tell broken lines from solid ones.
    """

    label: ElementClass
    planes: tuple[int, ...]
    dashed: tuple[int, ...] = ()
    says_style: bool = False


@dataclass
class _Found:
    """What the blocks of a map show of one layer, in cells of the whole map."""

    dashes: list[PaintTrace] = field(default_factory=list)
    lines: list[PaintTrace] = field(default_factory=list)
    """Cut at the borders of the blocks."""
    rims: list[Float[np.ndarray, "k 2"]] = field(default_factory=list)


def elements_of(
    grid: EvidenceGrid, layers: Sequence[Layer], height_of: HeightOf, config: VectorConfig | None = None
) -> list[MapElement]:
    """Every element that the grid shows, with ids that count within each class.

    It goes from block to block, so that memory does not grow with the map. What is short is taken from the block that
    holds its middle; long lines are cut where the block ends and joined again.

    Args:
        grid: looks at the road.
        layers: what its layers mean.
        height_of: height of the road.
        config: None for the defaults.
    """
    config = config or VectorConfig()
    found = [_Found() for _ in layers]
    margin = round(_MARGIN_M / grid.cell_m)
    tiles = grid.tiles * TILE
    for block in np.unique(grid.tiles // _BLOCK_TILES, axis=0):
        core = block * _BLOCK_TILES * TILE
        low, high = core - margin, core + _BLOCK_TILES * TILE + margin
        # Where no tile is nothing was seen.
        near = tiles[((tiles < high) & (tiles + TILE > low)).all(axis=1)]
        low, high = np.maximum(low, near.min(axis=0)), np.minimum(high, near.max(axis=0) + TILE)
        window = _Window(grid, low, high - low, config)
        for layer, own in zip(layers, found, strict=True):
            _look_at(window, layer, own, core, config)
    to_map = _ToMap(grid.cell_m, height_of)
    return [
        _named(element, k)
        for layer, own in zip(layers, found, strict=True)
        for k, element in enumerate(_elements(layer, own, to_map, config))
    ]


class _Window:
    """Part of a grid: share of paint and what was looked at."""

    def __init__(self, grid: EvidenceGrid, low: np.ndarray, size: np.ndarray, config: VectorConfig):
        self.low, self.cell_m, self._grid, self._size = low, grid.cell_m, grid, size
        # A look says something at places as far apart as cells are, but not in line with them: it misses cells between
        # those that it hits.
        num_looks = cv2.morphologyEx(grid.plane(1, low, size), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        self.looked = num_looks >= config.min_looks

    def share(self, planes: Sequence[int]) -> np.ndarray:
        """Share of the looks that show any of some layers."""
        whole = np.zeros((int(self._size[1]), int(self._size[0])), np.float32)
        for plane in planes:
            whole += self._grid.share(plane, self.low, self._size)
        return whole


def _look_at(window: _Window, layer: Layer, found: _Found, core: np.ndarray, config: VectorConfig) -> None:
    """Adds what one block shows of a layer."""
    cell_m = window.cell_m
    share = window.share(layer.planes)
    if not share.any():
        return
    share = cv2.GaussianBlur(share, (0, 0), config.blur_cells)
    smallest = config.min_area_m2 / cell_m**2
    if layer.label not in STROKES:
        find = find_rectangles if layer.label in RECTANGLES else find_outlines
        _take(found.rims, [rim + window.low for rim in find(share, window.looked, smallest)], core, _centre)
        return
    is_stop = layer.label == ElementClass.STOP_LINE
    limits = TraceLimits(
        widest=(config.widest_stop_line_m if is_stop else config.widest_line_m) / cell_m,
        reach=(_STOP_REACH_M if is_stop else _LINE_REACH_M) / cell_m,
        smallest=smallest,
        least_share=config.slot_line_share if layer.label == ElementClass.SLOT_LINE else config.line_share,
        along=_ALONG_M / cell_m,
    )
    strokes = find_strokes(share, window.looked, limits)
    dashed = window.share(layer.dashed) if layer.dashed else None
    short = [s for s in strokes if _is_short(s, layer, dashed, share, cell_m, config)]
    shortest_m = config.shortest_stop_line_m if is_stop else config.shortest_line_m
    kept = [s for s in short if s.length * cell_m >= shortest_m]
    if is_stop:
        kept = [s for s in kept if s.length > _SLENDER * s.width]
    if layer.label == ElementClass.LANE_MARKING or is_stop:
        kept = [s for s in kept if all(s.is_end)]
    if layer.label == ElementClass.LANE_MARKING:
        long = [s for s in strokes if s.length * cell_m >= shortest_m]
        kept += rows_of_spots(share, window.looked, long, _spot_limits(cell_m, config))
    _take(found.dashes, [_moved(s, window.low) for s in kept], core, lambda s: _centre(s.middle))
    taken = {id(s) for s in short}
    for stroke in strokes:
        if id(stroke) not in taken:
            found.lines += cut_to(_moved(stroke, window.low), core, core + _BLOCK_TILES * TILE)


def _spot_limits(cell_m: float, config: VectorConfig) -> SpotLimits:
    return SpotLimits(
        config.spot_share,
        config.shortest_spot_m / cell_m,
        config.shortest_line_m / cell_m,
        config.widest_line_m / cell_m,
        config.spot_gap_m / cell_m,
    )


def _is_short(
    stroke: PaintTrace, layer: Layer, dashed: np.ndarray | None, share: np.ndarray, cell_m: float, config: VectorConfig
) -> bool:
    """Whether a stroke is a dash, a stop line or a line beside a slot, which one block shows whole."""
    length_m = stroke.length * cell_m
    if layer.label == ElementClass.STOP_LINE:
        return True
    if layer.label == ElementClass.SLOT_LINE:
        return length_m <= _MARGIN_M
    if layer.label == ElementClass.CURB:
        return False
    return length_m <= config.longest_dash_m and (not layer.says_style or _vote(dashed, share, stroke) > _SOLID_VOTE)


def _moved(stroke: PaintTrace, by: np.ndarray) -> PaintTrace:
    return replace(stroke, middle=stroke.middle + by)


def _centre(points: np.ndarray) -> np.ndarray:
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def _take(found: list, new: list, core: np.ndarray, middle_of: Callable) -> None:
    """Adds what has its middle in a block; near its border either block takes it, and one of them stays."""
    low, high = core - _BORDER, core + _BLOCK_TILES * TILE + _BORDER
    known = np.array([middle_of(item) for item in found]).reshape(-1, 2)
    for item in new:
        middle = middle_of(item)
        if ((middle >= low) & (middle < high)).all() and not (
            np.linalg.norm(known - middle, axis=1) < 2 * _BORDER
        ).any():
            found.append(item)


def _elements(layer: Layer, found: _Found, to_map: "_ToMap", config: VectorConfig) -> list[MapElement]:
    """The elements of one layer."""
    cell_m = to_map.cell_m
    if layer.label not in STROKES:
        return [_polygon(layer.label, to_map(rim)) for rim in found.rims]
    if layer.label == ElementClass.STOP_LINE:
        return [_polygon(layer.label, to_map(_bar(stroke, cell_m))) for stroke in found.dashes]
    is_slot = layer.label == ElementClass.SLOT_LINE
    style, whole_style = ("dashed", "solid") if layer.label == ElementClass.LANE_MARKING else ("", "")
    elements = [_line(layer.label, _straightened(s, cell_m), s, style, to_map) for s in found.dashes]
    # Pieces of one line by a slot that were not cut were followed to the end: only what was cut is joined.
    longest_m, off_m = (_CUT_GAP_M, _CUT_GAP_M) if is_slot else (config.joined_gap_m, config.joined_off_m)
    for stroke in joined(found.lines, cell_m, longest_m, off_m):
        if stroke.length * cell_m >= 2.0 * config.shortest_line_m:
            shape = _straightened if is_slot else _smoothed
            elements.append(_line(layer.label, shape(stroke, cell_m), stroke, whole_style, to_map))
    return uncrossed(elements) if layer.label == ElementClass.CURB else elements


@dataclass(frozen=True)
class _ToMap:
    cell_m: float
    height_of: HeightOf

    def __call__(self, xy_cells: np.ndarray) -> np.ndarray:
        xy = (np.asarray(xy_cells, dtype=np.float64) + 0.5) * self.cell_m
        return np.column_stack([xy, self.height_of(xy)])


def _polygon(label: ElementClass, points: np.ndarray) -> MapElement:
    return MapElement("", label, points, closed=True)


def _named(element: MapElement, index: int) -> MapElement:
    name = element.label.name.lower()
    if element.label == ElementClass.LANE_MARKING:
        name = "dash" if element.style == "dashed" else "line"
    return MapElement(**{**element.__dict__, "id": f"{name}_{index}"})


def _line(label: ElementClass, middle: np.ndarray, stroke: PaintTrace, style: str, to_map: _ToMap) -> MapElement:
    return MapElement(
        "", label, to_map(middle), width_m=stroke.width * to_map.cell_m, style=style, true_ends=stroke.is_end
    )


def _vote(dashed: np.ndarray | None, share: np.ndarray, stroke: PaintTrace) -> float:
    """Share of the paint along a stroke that the masks call broken."""
    if dashed is None:
        return 0.0
    # A line that goes on past the picture has its end there.
    x, y = np.clip(np.rint(stroke.middle).astype(int), 0, np.array(share.shape[::-1]) - 1).T
    return float(dashed[y, x].sum() / max(share[y, x].sum(), 1e-6))


def _straightened(stroke: PaintTrace, cell_m: float) -> np.ndarray:
    """The middle of a short stroke as a gentle arc, a point every metre."""
    inner = stroke.middle[1:-1] if len(stroke.middle) > 4 else stroke.middle
    start, end = stroke.middle[0], stroke.middle[-1]
    axis = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    normal = np.array([-axis[1], axis[0]])
    along, across = (inner - start) @ axis, (inner - start) @ normal
    length = float((end - start) @ axis)
    degree = 2 if length * cell_m > 2.5 and len(inner) > 8 else min(1, len(inner) - 1)
    keep = np.ones(len(inner), dtype=bool)
    for _ in range(3):
        fit = np.polynomial.Polynomial.fit(along[keep], across[keep], degree)
        off = np.abs(across - fit(along))
        keep = off <= max(2.5 * float(np.median(off)), 0.5)
    s = np.linspace(0.0, length, max(round(length * cell_m / _KNOT_M), 1) + 1)
    return start + s[:, None] * axis + fit(s)[:, None] * normal


def _bar(stroke: PaintTrace, cell_m: float) -> np.ndarray:
    """Corners of a straight stroke, in cells."""
    middle = _straightened(stroke, cell_m)
    start, end = middle[0], middle[-1]
    along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    side = 0.5 * stroke.width * np.array([-along[1], along[0]])
    return np.stack([start - side, end - side, end + side, start + side])


def _smoothed(stroke: PaintTrace, cell_m: float) -> np.ndarray:
    """The middle of a long stroke, smoothed over two metres, a point every metre."""
    length = stroke.length
    num = max(round(length * cell_m / 0.1), 2)
    even = polyline.interpolate(stroke.middle, np.linspace(0.0, length, num + 1))
    window = min(2 * round(0.5 * _SMOOTHED_M / 0.1) + 1, 2 * (len(even) // 2) - 1)
    if window >= 5:
        even = savgol_filter(even, window, 2, axis=0, mode="interp")
    step = max(round(_KNOT_M / 0.1), 1)
    return np.vstack([even[:-1:step], even[-1:]]) if len(even) > 2 else even
