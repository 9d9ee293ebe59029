"""How far a drive lies off the map, along its way (room: mapping; host).

In: Sights, points. Out: displacement of each point by the unknowns of the drive, and what is known of these.
Unknowns: a shift, a turn and a scale of the whole drive, and for a node every 25 m a shift and a turn: odometry bends.
All is small, so that the displacement is linear. Elements hang on the place of the way that is nearest to them: a wrong
scale of the odometer stretches the way, not the road beside it.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from semloc_jax.evaluation.map_shapes import kind_of
from semloc_jax.geometry import polyline
from semloc_jax.mapping.crowd.sights import LEAST_DRIVEN_M, Sights
from semloc_jax.mapping.crowd.stations import stations
from semloc_jax.mapping.crowd.world_lines import Piece
from semloc_jax.maps import MapElement

_NODE_M = 25.0
_HELD_RAD = 1e-5
TURN, SCALE = 2, 3
"""Places of the turn and the scale among the unknowns, after a shift; of the three of a node, which stand behind the
scale, the turn is the last as well."""


@dataclass(frozen=True)
class CorrectionConfig:
    """What is known of a drive's error before it is compared. All values are ours, one standard deviation.

    Args:
        turn_rad: of the whole drive.
        scale: of the odometer.
        bend_rad: by which the heading walks from node to node.
        slip_m: by which the place walks from node to node, besides the heading.
        node_m: shift of a node against the whole.
        node_rad: turn of a node against the whole.
    """

    turn_rad: float = 0.02
    scale: float = 0.01
    bend_rad: float = 0.002
    slip_m: float = 0.03
    node_m: float = 1.0
    node_rad: float = 0.01


class PlacedLine(NamedTuple):
    """A line as a drive places it."""

    element: MapElement
    placed: Float[np.ndarray, "k 3"]
    """Places about a metre apart [m]."""
    rows: Float[np.ndarray, "k 2 p"]
    """Displacement of these by each unknown."""
    sigma_m: float
    """Of the line, across."""


class Correction:
    """The unknowns of one drive."""

    def __init__(self, sights: Sights, config: CorrectionConfig | None = None):
        """Nothing is corrected yet."""
        self.sights = sights
        self.config = config or CorrectionConfig()
        self.num_nodes, self.length_m = 0, 0.0
        points = sights.things.centre
        if not sights.is_base:
            self.length_m = float(polyline.arc_length(sights.way)[-1])
            self.num_nodes = max(round(self.length_m / _NODE_M), 1) + 1
            points = sights.way
        self.centre = points.mean(axis=0) if len(points) else np.zeros(2)
        self.size = 4 + 3 * self.num_nodes
        self.value = np.zeros(self.size)
        self.bent = 1.0
        """How many times as much its way may bend as is usual; see `bends`."""

    @property
    def is_held(self) -> bool:
        """Whether it is a surveyed map, which lies where it lies."""
        return self.sights.is_base and self.sights.sigma_place_m < LEAST_DRIVEN_M

    def rows(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2 p"]:
        """Displacement of points by each unknown."""
        s_m, foot = self.sights.feet(xy)
        rows = np.zeros((len(xy), 2, self.size))
        rows[:, :, :2] = np.eye(2)
        rows[:, :, 2] = turned(xy - self.centre)
        rows[:, :, SCALE] = foot - self.centre
        if self.num_nodes:
            step_m = self.length_m / (self.num_nodes - 1)
            at = np.clip(s_m / step_m, 0.0, self.num_nodes - 1 - 1e-9)
            low, share = at.astype(int), (at % 1.0)[:, None]
            lever, row = turned(xy - foot), np.arange(len(xy))
            for node, weight in ((low, 1.0 - share), (low + 1, share)):
                rows[row, 0, 4 + 3 * node] += weight[:, 0]
                rows[row, 1, 5 + 3 * node] += weight[:, 0]
                rows[row[:, None], [[0, 1]], (6 + 3 * node)[:, None]] += weight * lever
        return rows

    @cached_property
    def thing_rows(self) -> Float[np.ndarray, "n 2 p"]:
        """Displacement of the middles of its things by each unknown."""
        return self.rows(self.sights.things.centre)

    @cached_property
    def placed_lines(self) -> list[PlacedLine]:
        """Its lines as places a metre apart."""
        found = []
        for element, belief in self.sights.lines:
            placed = stations(element.points)
            if len(placed) > 1:
                found.append(PlacedLine(element, placed, self.rows(placed[:, :2]), belief.sigma_across_m))
        return found

    def moved_things(self) -> Float[np.ndarray, "n 2"]:
        """Middles of its things where they are in the map by now [m]."""
        return self.sights.things.centre + self.thing_rows @ self.value

    def moved_line(self, line: PlacedLine) -> Float[np.ndarray, "k 2"]:
        """Places of one of its lines where they are in the map by now [m]."""
        return line.placed[:, :2] + line.rows @ self.value

    def pieces(self) -> dict[str, list[tuple[MapElement, Piece]]]:
        """Its lines by kind, each with where it runs in the map by now."""
        found: dict[str, list[tuple[MapElement, Piece]]] = {}
        for line in self.placed_lines:
            piece = Piece.of(line.placed, self.moved_line(line), line.sigma_m)
            found.setdefault(kind_of(line.element), []).append((line.element, piece))
        return {kind: found[kind] for kind in sorted(found)}

    def moved(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Points of the drive where they are in the map."""
        return xy + self.rows(xy) @ self.value if len(xy) else xy

    def back(self, xy_map: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Where the drive would have placed points of the map."""
        return xy_map - self.rows(xy_map) @ self.value if len(xy_map) else xy_map

    def turn_rows(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n p"]:
        """Turn of directions at points by each unknown [rad]."""
        rows = np.zeros((len(xy), self.size))
        rows[:, 2] = 1.0
        if self.num_nodes and len(xy):
            at = self.sights.feet(xy)[0] * (self.num_nodes - 1) / self.length_m
            nearness = 1.0 - np.abs(at[:, None] - np.arange(self.num_nodes))
            rows[:, 6::3] = np.maximum(nearness, 0.0)
        return rows

    def turn(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """By how much directions of the drive turn at points [rad]."""
        return self.turn_rows(xy) @ self.value

    @property
    def bend(self) -> float:
        """How far its way is bent: mean square of its headings against their mean, in what such a walk gives; 0 where
        nothing can bend."""
        turns = self.value[4 + TURN :: 3]
        if len(turns) < 2:
            return 0.0
        return float(6.0 * np.var(turns) / (len(turns) * self.config.bend_rad**2))

    @property
    def strain(self) -> float:
        """How far its way is bent from node to node: mean square, in what a way may bend; 0 where nothing can bend."""
        walked = (self._walk(1.0) @ self.value) if self.num_nodes else np.zeros(0)
        return float((walked**2).mean()) if len(walked) else 0.0

    def known(self) -> tuple[csr_array, Float[np.ndarray, " k"]]:
        """Whitened rows of what is known of the unknowns, and what they should give."""
        c, place_m = self.config, self.sights.sigma_place_m
        share = self.sights.num_drives**-0.5
        whole = [_HELD_RAD, _HELD_RAD] if self.is_held else [share * c.turn_rad, share * c.scale]
        sigma = np.array([place_m, place_m, *whole] + [c.node_m, c.node_m, c.node_rad] * self.num_nodes)
        blocks = [np.diag(1.0 / sigma)]
        if self.num_nodes:
            blocks.append(self._walk(self.bent))
        rows = np.vstack(blocks)
        target = np.zeros(len(rows))
        target[SCALE] = (self.sights.scale - 1.0) / sigma[SCALE]
        return csr_array(rows), target

    def _walk(self, bent: float) -> Float[np.ndarray, "k p"]:
        """Whitened rows of how place and heading walk from node to node; a way may bend so many times as is usual."""
        c = self.config
        nodes_m = np.linspace(0.0, self.length_m, self.num_nodes)
        step = turned(np.diff(polyline.interpolate(self.sights.way, nodes_m), axis=0))
        walk = np.zeros((3 * (self.num_nodes - 1), self.size))
        for k in range(self.num_nodes - 1):
            here, there = 4 + 3 * k, 7 + 3 * k
            for axis in (0, 1):
                walk[3 * k + axis, [there + axis, here + axis]] = np.array([1.0, -1.0]) / c.slip_m
                walk[3 * k + axis, here + TURN] = -step[k, axis] / c.slip_m
            walk[3 * k + 2, [there + TURN, here + TURN]] = np.array([1.0, -1.0]) / (bent * c.bend_rad)
        return walk


def turned(xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Displacement of points by a turn about the origin of one radian, as far as it is linear."""
    return np.stack([-xy[:, 1], xy[:, 0]], axis=1)
