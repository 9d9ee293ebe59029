"""Elements out of the picture of the road from above: dashes, lines, bars, outlines (room: mapping; host).

In: EvidenceGrid, what its layers mean, height of the road. Out: MapElements.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_filter
from scipy.spatial import cKDTree

from semloc_jax.geometry import polyline
from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.mapping.outlines import find_outlines, find_rectangles
from semloc_jax.mapping.strokes import PaintTrace, TraceLimits, find_strokes
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

HeightOf = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
"""Height of the road at places [m]."""

STROKES = (ElementClass.LANE_MARKING, ElementClass.SLOT_LINE)
RECTANGLES = (ElementClass.CROSSWALK, ElementClass.STOP_LINE, ElementClass.SPEED_BUMP)
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
        line_share: share of the looks at a cell that must show a lane marking.
        slot_line_share: the same of a slot line, which is thin and seen from the side.
        longest_dash_m: a longer stroke is a solid line.
        shortest_line_m: a shorter solid line is noise.
        joined_gap_m: pieces of one solid line with a longer gap stay apart.
        joined_off_m: pieces farther off each other's direction stay apart.
    """

    min_looks: int = 3
    blur_cells: float = 1.0
    min_area_m2: float = 0.03
    widest_line_m: float = 0.35
    line_share: float = 0.5
    slot_line_share: float = 0.35
    longest_dash_m: float = 7.0
    shortest_line_m: float = 0.6
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


def elements_of(
    grid: EvidenceGrid, layers: Sequence[Layer], height_of: HeightOf, config: VectorConfig | None = None
) -> list[MapElement]:
    """Every element that the grid shows, with ids that count within each class.

    Args:
        grid: looks at the road.
        layers: what its layers mean.
        height_of: height of the road.
        config: None for the defaults.
    """
    config = config or VectorConfig()
    found: list[MapElement] = []
    looked = grid.plane(1) >= config.min_looks
    low, _ = grid.bounds
    for layer in layers:
        share = sum(grid.share(plane) for plane in layer.planes)
        share = cv2.GaussianBlur(share, (0, 0), config.blur_cells)
        to_map = _ToMap(low, grid.cell_m, height_of)
        if layer.label in STROKES:
            dashed = sum((grid.share(plane) for plane in layer.dashed), np.zeros_like(share)) if layer.dashed else None
            new = _lines(share, looked, dashed, layer, to_map, config)
        elif layer.label in RECTANGLES:
            new = [_polygon(layer.label, to_map(box)) for box in find_rectangles(share, looked, _cells(config, grid))]
        else:
            new = [_polygon(layer.label, to_map(rim)) for rim in find_outlines(share, looked, _cells(config, grid))]
        found += [_named(element, k) for k, element in enumerate(new)]
    return found


@dataclass(frozen=True)
class _ToMap:
    low: np.ndarray
    cell_m: float
    height_of: HeightOf

    def __call__(self, xy_cells: np.ndarray) -> np.ndarray:
        xy = (np.asarray(xy_cells, dtype=np.float64) + self.low + 0.5) * self.cell_m
        return np.column_stack([xy, self.height_of(xy)])


def _cells(config: VectorConfig, grid: EvidenceGrid) -> float:
    return config.min_area_m2 / grid.cell_m**2


def _polygon(label: ElementClass, points: np.ndarray) -> MapElement:
    return MapElement("", label, points, closed=True)


def _named(element: MapElement, index: int) -> MapElement:
    name = element.label.name.lower()
    if element.label == ElementClass.LANE_MARKING:
        name = "dash" if element.style == "dashed" else "line"
    return MapElement(**{**element.__dict__, "id": f"{name}_{index}"})


def _lines(
    share: np.ndarray,
    looked: np.ndarray,
    dashed: np.ndarray | None,
    layer: Layer,
    to_map: _ToMap,
    config: VectorConfig,
) -> list[MapElement]:
    cell_m = to_map.cell_m
    limits = TraceLimits(
        widest=config.widest_line_m / cell_m,
        smallest=config.min_area_m2 / cell_m**2,
        least_share=config.slot_line_share if layer.label == ElementClass.SLOT_LINE else config.line_share,
    )
    strokes = find_strokes(share, looked, limits)
    if layer.label == ElementClass.SLOT_LINE:
        long = [s for s in strokes if s.length * cell_m >= config.shortest_line_m]
        return [_line(ElementClass.SLOT_LINE, _straightened(s, cell_m), s, "", to_map) for s in long]
    found, solid = [], []
    for stroke in strokes:
        length_m = stroke.length * cell_m
        vote = _vote(dashed, share, stroke)
        is_dash = length_m <= config.longest_dash_m and (vote > _SOLID_VOTE if layer.says_style else True)
        if is_dash and length_m >= config.shortest_line_m and all(stroke.is_end):
            found.append(_line(layer.label, _straightened(stroke, cell_m), stroke, "dashed", to_map))
        elif not is_dash:
            solid.append(stroke)
    for stroke in _joined(solid, cell_m, config):
        if stroke.length * cell_m >= 2.0 * config.shortest_line_m:
            found.append(_line(layer.label, _smoothed(stroke, cell_m), stroke, "solid", to_map))
    return found


def _line(label: ElementClass, middle: np.ndarray, stroke: PaintTrace, style: str, to_map: _ToMap) -> MapElement:
    return MapElement(
        "", label, to_map(middle), width_m=stroke.width * to_map.cell_m, style=style, true_ends=stroke.is_end
    )


def _vote(dashed: np.ndarray | None, share: np.ndarray, stroke: PaintTrace) -> float:
    """Share of the paint along a stroke that the masks call broken."""
    if dashed is None:
        return 0.0
    x, y = np.rint(stroke.middle).astype(int).T
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


def _joined(strokes: list[PaintTrace], cell_m: float, config: VectorConfig) -> list[PaintTrace]:
    """Pieces of one solid line put together, shortest gaps first: each end of a piece is joined once at most."""
    ends = [(k, end) for k in range(len(strokes)) for end in (0, 1)]
    joins: dict[tuple[int, int], tuple[int, int]] = {}
    group = list(range(len(strokes)))
    for _, one, other in sorted(_gaps(strokes, ends, cell_m, config)):
        if one in joins or other in joins or group[one[0]] == group[other[0]]:
            continue
        joins[one], joins[other] = other, one
        kept, gone = group[one[0]], group[other[0]]
        group = [kept if name == gone else name for name in group]
    found, used = [], set()
    # No group is a ring, so that each has an end where nothing joins it.
    for start in ends:
        if start not in joins and start[0] not in used:
            found.append(_chained(strokes, start, joins, used))
    return found


def _chained(
    strokes: list[PaintTrace],
    start: tuple[int, int],
    joins: dict[tuple[int, int], tuple[int, int]],
    used: set[int],
) -> PaintTrace:
    """The pieces that hang together, from a free end on."""
    pieces, lengths, widths = [], [], []
    entry: tuple[int, int] | None = start
    while entry is not None:
        index, end = entry
        used.add(index)
        stroke = strokes[index]
        pieces.append(stroke.middle[::-1] if end else stroke.middle)
        lengths.append(stroke.length)
        widths.append(stroke.width)
        last = (index, 1 - end)
        entry = joins.get(last)
    # The ends at a gap are where the masks are least sure of the middle.
    trimmed = [
        piece[k > 0 : len(piece) - (k < len(pieces) - 1)] if len(piece) > 3 else piece for k, piece in enumerate(pieces)
    ]
    middle = np.vstack(trimmed)
    middle = middle[np.append(True, np.linalg.norm(np.diff(middle, axis=0), axis=1) > 1e-3)]
    is_end = strokes[start[0]].is_end[start[1]], strokes[last[0]].is_end[last[1]]
    return PaintTrace(middle, float(np.average(widths, weights=lengths)), is_end)


def _gaps(
    strokes: list[PaintTrace], ends: list[tuple[int, int]], cell_m: float, config: VectorConfig
) -> list[tuple[float, tuple[int, int], tuple[int, int]]]:
    """Pairs of ends that may belong to one line, with the gap between them [m]."""
    if not ends:
        return []
    ways = [_end_of(strokes[k], end) for k, end in ends]
    near = cKDTree(np.array([place for place, _ in ways])).query_pairs(config.joined_gap_m / cell_m)
    found = []
    for a, b in sorted(near):
        gap = _gap_m(*ways[a], *ways[b], cell_m, config)
        if gap is not None and ends[a][0] != ends[b][0]:
            found.append((gap, ends[a], ends[b]))
    return found


def _end_of(stroke: PaintTrace, end: int) -> tuple[np.ndarray, np.ndarray]:
    """The place of an end and the direction in which the stroke leaves it."""
    line = stroke.middle if end else stroke.middle[::-1]
    back = line[-min(len(line), 20)]
    step = line[-1] - back
    return line[-1], step / max(float(np.linalg.norm(step)), 1e-9)


def _gap_m(
    place: np.ndarray, out: np.ndarray, other: np.ndarray, other_out: np.ndarray, cell_m: float, config: VectorConfig
) -> float | None:
    step = other - place
    gap_m = float(np.linalg.norm(step)) * cell_m
    if gap_m > config.joined_gap_m or out @ other_out > -0.97:
        return None
    off = max(abs(out[0] * step[1] - out[1] * step[0]), abs(other_out[0] * step[1] - other_out[1] * step[0]))
    ahead = min(float(out @ step), float(-other_out @ step)) * cell_m
    if ahead < -0.5 or off * cell_m > config.joined_off_m + 0.03 * gap_m:
        return None
    return gap_m
