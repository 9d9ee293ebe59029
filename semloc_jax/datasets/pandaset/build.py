"""A vector map of a PandaSet sequence, sharp enough for its images (room: datasets; host).

In: labelled points and front images of some sweeps. Out: SemanticMap, and where the front camera really looks.

The labels reach some centimetres beyond the paint, and the published pose of the front camera is off by about 0.1 deg
(3 px). So lines are traced in the labels and then drawn to the paint that the images of the same sweeps show. Localize
on OTHER sweeps to keep map and test apart.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from semloc_jax.datasets.base import Frame
from semloc_jax.datasets.pandaset.reader import (
    FRONT,
    LANE_LINE,
    OTHER_MARK,
    ROAD,
    SIGN,
    PandaSetDrive,
    read_pandaset,
)
from semloc_jax.datasets.pandaset.strips import Sighting, look_for
from semloc_jax.datasets.pandaset.surface import road_profiles
from semloc_jax.datasets.pandaset.vectorize import TracedLine, trace_lines, trace_signs
from semloc_jax.datasets.pandaset.worn_lines import trace_paint
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.polyline import arc_length
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.structs import ElementClass

_PIECE_M = 1.5
_MIN_LOOKS = 4
_LOOK_EVERY_M = 0.4
"""Frames nearer to each other than this show the same."""
_DEFAULT_WIDTH_M = 0.10
"""Width of lane lines in California: 4 inches."""
_SIGMA_LEFT_M, _SIGMA_TURN_RAD = 0.02, np.radians(0.2)
_SIGMA_AHEAD_PX = 1.0
_AWAY = 0.9
"""Cosine between a stroke and the line of sight below which an image does not tell where it is: across the sight one
pixel is a decimetre of road at 20 m."""
_SIGMA_LABEL_LEFT_M, _SIGMA_LABEL_AHEAD_M = 0.05, 0.15


@dataclass(frozen=True)
class _Piece:
    """A straight part of a traced line: which line, which place in it, its ends [2 3]."""

    line: int
    order: int
    ends: np.ndarray


def calibrated(drive: PandaSetDrive, sweeps: slice = slice(None)) -> PandaSetDrive:
    """The sequence with the direction of its front camera corrected by the paint in the images of `sweeps`.

    A camera that looks down by theta more than stated shows paint theta (r^2 + h^2) / h too far ahead at range r; one
    that looks left by psi more shows it psi r too far to the right. Errors of the labels are
    constant for each dash; the change with the range separates them.

    Raises:
        SemlocError: fewer than two dashes are seen at different ranges.
    """
    dashes = [line for line in trace_lines(drive.points.of(LANE_LINE, sweeps)) if line.is_isolated]
    ends = [line.points for line in dashes]
    sightings = look_for(ends, [True] * len(ends), _looks(drive, sweeps), FRONT)
    sightings = [s for s in sightings if np.isfinite(s.left_m) and abs(s.away) > _AWAY]
    lines = sorted({s.line for s in sightings})
    if len(lines) < 2 or len(sightings) < 6:
        raise SemlocError(
            f"PandaSet {drive.name}: {len(lines)} dashes are seen by {FRONT} in the sweeps given; expected two or "
            "more; use more sweeps"
        )
    index = drive.rig.index(FRONT)
    height_m, focal_px = float(drive.rig.T_base_cam[index, 2, 3]), float(drive.rig.cameras[index].fy)
    theta, psi = _turn_of_camera(sightings, lines, height_m, focal_px)
    correction = np.eye(4)
    correction[:3, :3] = Rotation.from_rotvec([-theta, -psi, 0.0]).as_matrix()
    return read_pandaset(drive.path, correction)


def _turn_of_camera(
    sightings: list[Sighting], lines: list[int], height_m: float, focal_px: float
) -> tuple[float, float]:
    """Downward and leftward turn [rad] beside a shift of each dash, by robust least squares with priors."""
    slot = np.array([lines.index(s.line) for s in sightings])
    range_m = np.array([s.range_m for s in sightings])
    left = np.array([s.left_m for s in sightings])
    ahead = np.array([s.ahead_m for s in sightings])
    count = len(lines)
    stretch_m = (range_m**2 + height_m**2) / height_m
    sigma_ahead_m = 0.02 + stretch_m * _SIGMA_AHEAD_PX / focal_px

    def residual(x: np.ndarray) -> np.ndarray:
        theta, psi, shift_left, shift_ahead = x[0], x[1], x[2 : 2 + count], x[2 + count :]
        r_left = (left - shift_left[slot] + psi * range_m) / _SIGMA_LEFT_M
        r_ahead = (ahead - shift_ahead[slot] - theta * stretch_m) / sigma_ahead_m
        priors = [x[:2] / _SIGMA_TURN_RAD, shift_left / _SIGMA_LABEL_LEFT_M, shift_ahead / _SIGMA_LABEL_AHEAD_M]
        return np.concatenate([r_left, r_ahead[np.isfinite(ahead)], *priors])

    from scipy.optimize import least_squares  # readers of other drives do without

    found = least_squares(residual, np.zeros(2 + 2 * count), loss="soft_l1").x
    return float(found[0]), float(found[1])


def build_map(drive: PandaSetDrive, sweeps: slice = slice(None)) -> SemanticMap:
    """Lane lines, other marks and signs of the given sweeps.

    Dashes have real ends; pieces of long lines have none, because labels end where the lidar does. Paint that at least
    four images should show and none does is worn off and left out.

    Args:
        sequence: best after `calibrated`.
        sweeps: frames whose points and front images make the map.
    """
    elements = []
    for class_id, label, name in (
        (LANE_LINE, ElementClass.LANE_MARKING, "lane"),
        (OTHER_MARK, ElementClass.ROAD_MARK, "mark"),
    ):
        lines = trace_paint(drive.points, class_id, sweeps)
        elements += [_as_traced(line, label, f"{name}_paint_{k}") for k, line in enumerate(lines) if line.width_m]
        lines = [line for line in lines if not line.width_m]
        pieces = [piece for index, line in enumerate(lines) for piece in _pieces(index, line)]
        dashes = [line.points for line in lines if line.is_isolated]
        strokes = [piece.ends for piece in pieces] + dashes
        has_ends = [False] * len(pieces) + [True] * len(dashes)
        looks: list[list[Sighting]] = [[] for _ in strokes]
        for sighting in look_for(strokes, has_ends, _looks(drive, sweeps), FRONT):
            looks[sighting.line].append(sighting)
        whole = iter(looks[len(pieces) :])
        for number, line in enumerate(lines):
            own = [k for k, piece in enumerate(pieces) if piece.line == number]
            drawn = _drawn_to_paint([pieces[k] for k in own], [looks[k] for k in own])
            elements += _elements_of(drawn, line, label, f"{name}_{number}", next(whole) if line.is_isolated else [])
    for number, (outline, normal) in enumerate(trace_signs(drive.points.of(SIGN, sweeps))):
        attributes = {"class": "sign", "shape": "rectangle"}
        elements.append(
            MapElement(
                f"sign_{number}",
                ElementClass.SIGN,
                outline,
                closed=True,
                shape="rectangle",
                normal=normal,
                attributes=attributes,
            )
        )
    elements += road_profiles(drive.points.of(ROAD, sweeps), drive.truth.T_map_base[sweeps])
    return SemanticMap(tuple(elements), drive.origin, f"{drive.name} from labelled points")


def _looks(drive: PandaSetDrive, sweeps: slice) -> Iterator[tuple[Frame, object, np.ndarray]]:
    """Frames of the sweeps that differ in place, with the front camera and its pose."""
    last = None
    for frame in drive.frames[sweeps]:
        place = drive.truth_at(frame)
        if last is not None and np.linalg.norm(place[:3, 3] - last) < _LOOK_EVERY_M:
            continue
        last = place[:3, 3]
        index = frame.rig.index(FRONT)
        yield frame, frame.rig.cameras[index], place @ np.asarray(frame.rig.T_base_cam)[index]


def _pieces(index: int, line: TracedLine) -> list[_Piece]:
    """Straight pieces of a line, each about 1.5 m; a dash has two halves."""
    knots = arc_length(line.points)
    count = 2 if line.is_isolated else max(1, round(knots[-1] / _PIECE_M))
    at = np.linspace(0.0, knots[-1], count + 1)
    points = np.column_stack([np.interp(at, knots, line.points[:, axis]) for axis in range(3)])
    return [_Piece(index, k, points[k : k + 2]) for k in range(count)]


def _drawn_to_paint(pieces: list[_Piece], looks: list[list[Sighting]]) -> list[tuple[_Piece, float]]:
    """The pieces of one line that images show or cannot show, moved sideways onto the paint, with their width [m]."""
    seen = [[s for s in own if np.isfinite(s.left_m)] for own in looks]
    is_seen = [len(own) >= 2 and 2 * len(own) >= len(all_looks) for own, all_looks in zip(seen, looks, strict=True)]
    is_gone = [not found and len(own) >= _MIN_LOOKS for found, own in zip(is_seen, looks, strict=True)]
    shift = np.array([_shift_m(own) if ok else np.nan for own, ok in zip(seen, is_seen, strict=True)])
    drawn = []
    for k, piece in enumerate(pieces):
        if is_gone[k]:
            continue
        if not is_seen[k]:
            drawn.append((piece, _DEFAULT_WIDTH_M))
            continue
        # The median of neighbours keeps one wrong sighting from bending a long line.
        near = shift[k : k + 1] if len(pieces) == 2 else shift[max(k - 1, 0) : k + 2]
        ends = piece.ends + float(np.nanmedian(near)) * _left(piece.ends)
        drawn.append((replace(piece, ends=ends), float(np.median([s.width_m for s in seen[k]]))))
    return drawn


def _shift_m(seen: list[Sighting]) -> float:
    """How far to its left the paint of a piece is seen [m]; 0 where it lies across the line of sight in every image."""
    along = [s.left_m for s in seen if abs(s.away) > _AWAY]
    return float(np.median(along)) if along else 0.0


def _drawn_dash(ends: np.ndarray, halves: list[_Piece], looks: list[Sighting]) -> np.ndarray:
    """A dash through the middles of its two drawn halves, moved along itself to where images show its ends."""
    start, end = (half.ends.mean(axis=0) for half in halves)
    dash = np.array([1.5 * start - 0.5 * end, 1.5 * end - 0.5 * start])
    ahead = [s.ahead_m for s in looks if np.isfinite(s.ahead_m) and abs(s.away) > _AWAY]
    axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    return dash + (float(np.median(ahead)) * axis if ahead else 0.0)


def _left(ends: np.ndarray) -> np.ndarray:
    """Unit vector to the left of a straight piece."""
    left = np.cross([0.0, 0.0, 1.0], ends[1] - ends[0])
    return left / np.linalg.norm(left)


def _elements_of(
    drawn: list[tuple[_Piece, float]], line: TracedLine, label: ElementClass, name: str, looks: list[Sighting]
) -> list[MapElement]:
    """Elements of one line: each run of pieces without a gap is one polyline."""
    runs: list[list[tuple[_Piece, float]]] = []
    for piece, width in drawn:
        if runs and runs[-1][-1][0].order == piece.order - 1:
            runs[-1].append((piece, width))
        else:
            runs.append([(piece, width)])
    is_dash = line.is_isolated and label == ElementClass.LANE_MARKING
    kind = "road_mark" if label == ElementClass.ROAD_MARK else "lane_dashed" if is_dash else "lane_solid"
    elements = []
    for number, run in enumerate(runs):
        width = round(float(np.median([width for _, width in run])), 3)
        pieces = [piece for piece, _ in run]
        is_whole = line.is_isolated and len(run) == 2
        points = _drawn_dash(line.points, pieces, looks) if is_whole else _joined([piece.ends for piece in pieces])
        elements.append(
            MapElement(
                id=f"{name}_{number}",
                label=label,
                points=points,
                width_m=width,
                style="dashed" if is_dash else "solid",
                true_ends=(is_whole, is_whole),
                attributes={"class": kind, "width": width},
            )
        )
    return elements


def _as_traced(line: TracedLine, label: ElementClass, name: str) -> MapElement:
    """A stroke whose own light shows where it is."""
    kind = "road_mark" if label == ElementClass.ROAD_MARK else "lane_dashed" if line.is_isolated else "lane_solid"
    width_m = round(line.width_m, 3)
    return MapElement(
        id=name,
        label=label,
        points=line.points,
        width_m=width_m,
        style="dashed" if kind == "lane_dashed" else "solid",
        true_ends=(line.is_isolated, line.is_isolated),
        attributes={"class": kind, "width": width_m},
    )


def _joined(pieces: list[Float[np.ndarray, "2 3"]]) -> np.ndarray:
    """One polyline through straight pieces that follow each other; where two meet, the mean of their ends."""
    inner = [0.5 * (before[1] + after[0]) for before, after in pairwise(pieces)]
    return np.array([pieces[0][0], *inner, pieces[-1][1]])
