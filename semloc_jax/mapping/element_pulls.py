"""What the masks of one frame say of each element of a map, on its own (room: mapping; host around JAX).

In: a map, masks, cameras, the pose of the vehicle. Out: Pulls: for each element in view, and each of its sides, its
force on the pose and how firmly it holds it. No element counts for another one here: which of them is wrong is found
over all frames together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig, sample_within
from semloc_jax.alignment.implicit import smooth_scene
from semloc_jax.alignment.pose import AlignConfig
from semloc_jax.alignment.single_frame import evidence_from, frame_input
from semloc_jax.cameras import Rig
from semloc_jax.geometry import polyline
from semloc_jax.mapping.sides import NUM_SIDES, side_at, sides_of
from semloc_jax.mapping.sightings import UPRIGHT
from semloc_jax.maps import LocalMap, MapElement, SemanticMap
from semloc_jax.perception import ClassTable
from semloc_jax.perception.cost_maps import CostMapConfig, cost_maps
from semloc_jax.residuals.contour_pulls import ContourPulls, contour_pulls
from semloc_jax.residuals.holder_terms import holder_terms
from semloc_jax.residuals.smooth import SmoothScene
from semloc_jax.residuals.view import ViewConfig, view
from semloc_jax.structs import ViewSamples

_LEAST_CAPACITY = 64
_PIECE_M = 4.0
"""Length of the pieces of a long line; ours."""
_view = jax.jit(view, static_argnames="config")
_by_contours = jax.jit(contour_pulls)


@jax.jit
def _by_slopes(T_local_base: Array, scene: SmoothScene, holder: tuple[Array, ...], none: Array) -> ContourPulls:
    """The same by all slopes of the masks: without the curvature nothing of it is compiled."""
    terms = holder_terms(T_local_base, scene, holder, none)
    return ContourPulls(terms.force, terms.information, terms.pulling)


@dataclass(frozen=True)
class PullConfig:
    """How a frame is held against the elements around it. All values are ours.

    Args:
        range_m: elements farther from the camera do not count.
        min_px_per_m: nor what lies on the ground at a coarser scale along the line of sight.
        reach_px: borders of masks farther from where an element is do not pull.
        stride: pixels of the mask in one of its distance map.
        spacing_m: between places on the outline of an element.
        min_observations: elements with less border in view say nothing.
        excess: how many times more the borders of masks scatter than the noise model says, and together.
        by_contours: whether information is that of displacements across contours alone. The slopes of rough masks also
            rise and fall along a contour, and as information they hold a vehicle along solid lines: half of all that
            holds it along a road. In a map that is there already this is wrong, and places stayed 7 cm behind. In the
            map that a drive draws itself the size of the way is nearly free (camera heights, where masks lie in
            images), and what is too firm keeps it near what odometer, fixes and loops say: by contours a road of 260 m
            came out 21 cm off after one motion, by slopes 4 cm.
    """

    range_m: float = 14.0
    min_px_per_m: float = 4.0
    reach_px: float = 8.0
    stride: int = 1
    spacing_m: float = 0.1
    min_observations: float = 0.5
    excess: float = 2.0
    by_contours: bool = False

    @property
    def view(self) -> ViewConfig:
        """Each element on its own: none shares the error of its place with others, it is an unknown."""
        return ViewConfig(
            max_range_m=self.range_m, min_ground_px_per_m=self.min_px_per_m, shared_error=0.0, most_alone=3.0
        )


class Pulls(NamedTuple):
    """What one frame says of the sides of elements, by the right tangent of the pose of the vehicle [m, rad]."""

    ids: tuple[str, ...]
    side_force: Float[np.ndarray, "k s 6"]
    """Gradient of the cost of each side [nats]; what has no sides has all of it in the first."""
    side_information: Float[np.ndarray, "k s 6 6"]
    """Their Gauss-Newton information."""

    @property
    def force(self) -> Float[np.ndarray, "k 6"]:
        """Of whole elements [nats]."""
        return self.side_force.sum(axis=1)

    @property
    def information(self) -> Float[np.ndarray, "k 6 6"]:
        """Of whole elements."""
        return self.side_information.sum(axis=1)

    @classmethod
    def of_wholes(
        cls, ids: Sequence[str], force: Float[np.ndarray, "k 6"], information: Float[np.ndarray, "k 6 6"]
    ) -> "Pulls":
        """Those of elements without sides."""
        none = ((0, 0), (0, NUM_SIDES - 1), (0, 0))
        force, information = np.reshape(force, (-1, 1, 6)), np.reshape(information, (-1, 1, 6, 6))
        return cls(tuple(ids), np.pad(force, none), np.pad(information, (*none, (0, 0))))


class ElementPulls:
    """Holds frames against the elements of one map."""

    def __init__(self, semantic_map: SemanticMap, table: ClassTable, config: PullConfig | None = None):
        """Prepare a map.

        Raises:
            SemlocError: no class of the map is visible in masks of this table.
        """
        self.config = config or PullConfig()
        self._localizer = FrameLocalizer(semantic_map, table, LocalizeConfig())
        self._cost_maps = CostMapConfig(ramp_px=(self.config.reach_px,), stride=(self.config.stride,))

    def of(self, masks: Sequence[np.ndarray], rig: Rig, T_map_base: Float[np.ndarray, "4 4"]) -> Pulls:
        """What one frame says.

        Args:
            masks: class ids, one mask for each camera.
            rig: cameras of the masks.
            T_map_base: the pose, right within the reach of the distances.
        """
        config, localizer = self.config, self._localizer
        local_map = localizer.map.query(T_map_base[:3, 3], config.range_m + 5.0)
        samples = sample_within(local_map, config.spacing_m, localizer.config.sample_capacity)
        maps = cost_maps(masks, localizer.shown, self._cost_maps, quantised=True)
        inputs = frame_input(samples, maps, rig, localizer.channel_of_label)
        T_local = local_map.frame.from_map(T_map_base, np.float32)
        evidence = evidence_from(T_local, inputs, config.view)
        seen = _view(samples, jnp.asarray(T_local), rig, inputs.channel_of_label, config.view)
        scene = smooth_scene(evidence, maps, AlignConfig())
        rows = np.asarray(seen.element)
        # A line that was cut at the radius of the query is one element in several parts.
        shown = np.unique(rows[(rows >= 0) & (np.asarray(seen.weight) > 0)])
        ids = tuple(dict.fromkeys(local_map.elements[row].id for row in shown))
        if not ids:
            return Pulls.of_wholes((), np.zeros((0, 6)), np.zeros((0, 6, 6)))
        number = np.full(len(local_map.elements) + 1, -1)
        number[shown] = [NUM_SIDES * ids.index(local_map.elements[row].id) for row in shown]
        side = number[rows] + _sides(seen, local_map, shown)
        holder = tuple(jnp.asarray(side[np.asarray(part.index)]) for part in evidence.views)
        capacity = max(_LEAST_CAPACITY, 1 << (len(ids) - 1).bit_length())
        none = jnp.zeros(NUM_SIDES * capacity, scene.nats_per_px.dtype)
        pulls_of = _by_contours if config.by_contours else _by_slopes
        terms = jax.device_get(pulls_of(jnp.asarray(T_local), scene, holder, none))
        force, information, pulling = (_by_side(part, len(ids)) for part in terms)
        held = np.flatnonzero(pulling.sum(axis=1) >= config.min_observations)
        force, information = (part[held] / config.excess**2 for part in (force, information))
        return Pulls(tuple(ids[k] for k in held), force, information)


def _by_side(values: np.ndarray, num: int) -> np.ndarray:
    values = np.asarray(values, np.float64)
    return values.reshape(-1, NUM_SIDES, *values.shape[1:])[:num]


def _sides(seen: ViewSamples, local_map: LocalMap, shown: np.ndarray) -> Int[np.ndarray, "cam p"]:
    """Side of its element of every sample in view; 0 where it has none, or nothing is in view."""
    rows, tangent = np.asarray(seen.element), np.asarray(seen.tangent_map)
    # The outside lies to the right of the direction of a contour.
    outward = np.stack([tangent[:, 1], -tangent[:, 0]], axis=-1)
    xy = np.moveaxis(np.asarray(seen.p_map)[:, :2], 1, -1)
    found = np.zeros(rows.shape, int)
    for row in shown:
        sides = sides_of(local_map.elements[row])
        if sides is not None:
            own = rows == row
            middle = local_map.frame.from_map(np.pad(sides.middle, ((0, 0), (0, 1))))[:, :2]
            found[own] = side_at(sides._replace(middle=middle), xy[own], outward[own])
    return found


def pieces_of(element: MapElement) -> list[MapElement]:
    """A long line in pieces that move each on its own: it was drawn as bent as the way was."""
    if element.closed or len(element.points) < 2 or element.label in UPRIGHT:
        return [element]
    length_m = float(polyline.arc_length(element.points)[-1])
    if length_m <= 1.5 * _PIECE_M:
        return [element]
    num = int(np.ceil(length_m / _PIECE_M))
    cuts_m = np.linspace(0.0, length_m, num + 1)
    found = []
    for k, (low, high) in enumerate(pairwise(cuts_m)):
        places_m = np.linspace(low, high, max(round(high - low), 1) + 1)
        ends = element.true_ends[0] and k == 0, element.true_ends[1] and k == num - 1
        points = polyline.interpolate(element.points, places_m)
        found.append(replace(element, id=f"{element.id}.{k}", points=points, true_ends=ends))
    return found
