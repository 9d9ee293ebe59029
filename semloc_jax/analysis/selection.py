"""Which elements a small map should keep (room: analysis; host).

In: a map, cameras, places, a budget of bytes. Out: the small map, and what accuracy it promises.
What counts is how much larger the expected variances along, across and about the road are than with the whole map. The
log-determinant of the information, for which greedy choices have a bound, is no measure of that: it also pays for
height, roll and pitch, and lets one direction or place suffer for another. Chosen by it, a fifth of the map of a road
gave errors 35 % larger along, 45 % across, 10 % in heading (RMS over draws of a network's noise); chosen by this, with
coordinates of 1 cm, 4 %, 12 % and 0 %. Exchanging elements afterwards gained nothing more.
"""

import heapq
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.analysis.expected import TANGENT_OF_DIRECTION, ExpectedConfig, view_information
from semloc_jax.analysis.survey import PlaceViewer, SurveyConfig
from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.maps import MapElement, SemanticMap, write_drive_geojson
from semloc_jax.maps.curves import simplify
from semloc_jax.maps.elements import UPRIGHT_CLASSES
from semloc_jax.perception import ClassTable
from semloc_jax.residuals.view import view
from semloc_jax.structs import MapSamples

THINNING_M = 0.01
"""How far the middle of a line may move when its vertices are thinned; the compact form takes as much."""


@dataclass(frozen=True)
class ElementInformation:
    """What each element tells at each place.

    Attributes:
        whitened: information of the image about the right tangent in units of the prior's sigmas.
        prior_sigma: those sigmas [m, rad].
    """

    whitened: Float[np.ndarray, "place element 6 6"]
    prior_sigma: Float[np.ndarray, "6"]

    def sigma(self, chosen: Sequence[int]) -> Float[np.ndarray, "place 3"]:
        """Expected longitudinal [m], lateral [m] and heading [rad] sigma at each place with these elements only."""
        total = self.whitened[:, list(chosen)].sum(axis=1) + np.eye(6)
        variance = np.linalg.inv(total)[:, TANGENT_OF_DIRECTION, TANGENT_OF_DIRECTION]
        return np.sqrt(variance) * self.prior_sigma[TANGENT_OF_DIRECTION]


def element_information(
    semantic_map: SemanticMap,
    rig: Rig,
    table: ClassTable,
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    config: SurveyConfig | None = None,
    shared_error: float | None = None,
) -> ElementInformation:
    """The information of every element of a map, in its order, at every place; `shared_error` as in `ViewConfig`."""
    config = config or SurveyConfig()
    expected = replace(config.expected, shared_error=shared_error)
    viewer = PlaceViewer(semantic_map, table, config)
    row_of_id = {element.id: row for row, element in enumerate(semantic_map.elements)}
    sigma = expected.prior_sigma
    total = np.zeros((len(Ts_map_base), len(semantic_map.elements), 6, 6))
    for place, T_map_base in enumerate(Ts_map_base):
        local_map = viewer.local_map(T_map_base)
        samples, T = viewer.samples(local_map, T_map_base)
        parts = jax.device_get(_by_sample(samples, T, viewer.rig(rig), viewer.channel_of_label, expected))
        rows, weights, element = (part.reshape(-1, *part.shape[2:]) for part in parts)
        row_of_local = np.array([row_of_id[e.id] for e in local_map.elements])
        used = weights > 0
        outer = np.einsum("p,pi,pj->pij", weights[used], rows[used] * sigma, rows[used] * sigma)
        np.add.at(total[place], row_of_local[element[used]], outer)
    return ElementInformation(total, sigma)


@partial(jax.jit, static_argnames="config")
def _by_sample(
    samples: MapSamples, T_local_base: Array, rig: Rig, channel_of_label: Int[Array, " label"], config: ExpectedConfig
) -> tuple[Array, Array, Array]:
    seen = view(samples, T_local_base, rig, channel_of_label, config.view)
    return *view_information(T_local_base, rig, seen, config.align), seen.element


def relative_variance(total: Float[np.ndarray, "place 6 6"], whole: Float[np.ndarray, "place 3"]) -> float:
    """Mean over places and directions of the expected variance over that of the whole map.

    Args:
        total: Whitened information of a choice of elements, with that of the prior.
        whole: Expected sigma of the whole map, whitened.
    """
    variance = np.linalg.inv(total)[:, TANGENT_OF_DIRECTION, TANGENT_OF_DIRECTION]
    return float(np.mean(variance / whole**2))


def greedy_order(
    information: ElementInformation, cost_bytes: Sequence[float] | np.ndarray, budget_bytes: float
) -> tuple[list[int], list[float]]:
    """Elements in the order in which they are taken, and the relative variance after each.

    Lazy: what an element gains nearly always falls as others are taken, so only the head of the queue is computed anew.

    Args:
        information: Of every element at every place.
        cost_bytes: What each element costs.
        budget_bytes: What all that are taken may cost.
    """
    total = np.broadcast_to(np.eye(6), (len(information.whitened), 6, 6)).copy()
    everything = range(information.whitened.shape[1])
    whole = information.sigma(everything) / information.prior_sigma[TANGENT_OF_DIRECTION]
    is_seen = information.whitened[..., 0, 0] + information.whitened[..., 1, 1] > 0
    queue = [(-np.inf, element) for element in np.flatnonzero(is_seen.any(axis=0)).tolist()]
    taken: list[int] = []
    values: list[float] = []
    left, now = budget_bytes, relative_variance(total, whole)
    while queue:
        _, element = heapq.heappop(queue)
        if cost_bytes[element] > left:
            continue
        after = relative_variance(total + information.whitened[:, element], whole)
        ratio = (after - now) / cost_bytes[element]
        if queue and ratio > queue[0][0]:
            heapq.heappush(queue, (ratio, element))
            continue
        taken.append(element)
        total += information.whitened[:, element]
        left, now = left - cost_bytes[element], after
        values.append(now)
    return taken, values


@dataclass(frozen=True)
class SmallMap:
    """A map with the elements that are worth their bytes.

    Attributes:
        map: the small map.
        share: its bytes over those of the whole map, both written in one format.
        sigma: expected longitudinal [m], lateral [m], heading [deg] sigma of the small map, root mean square of places,
            if what is in the map is where the map says.
        sigma_whole: the same of the whole map.
    """

    map: SemanticMap
    share: float
    sigma: Float[np.ndarray, "3"]
    sigma_whole: Float[np.ndarray, "3"]

    def __str__(self) -> str:
        """One line for the report."""
        parts = [
            f"{name} {scale * small:.2f} {unit} (whole map {scale * whole:.2f})"
            for name, scale, unit, small, whole in zip(
                ("longitudinal", "lateral", "heading"),
                (100, 100, 1),
                ("cm", "cm", "deg"),
                self.sigma,
                self.sigma_whole,
                strict=True,
            )
        ]
        size = f"{len(self.map.elements)} elements, {100 * self.share:.1f} % of the bytes"
        return f"{size}; expected sigma {', '.join(parts)}"


Write = Callable[[SemanticMap, Path], None]
"""Writes a map to a file: the format in which bytes are counted."""


def small_map(
    semantic_map: SemanticMap,
    rig: Rig,
    table: ClassTable,
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    keep_share: float,
    write: Write = write_drive_geojson,
    whole_bytes: int | None = None,
    config: SurveyConfig | None = None,
) -> SmallMap:
    """The elements of a map that hold the pose best in a share of its bytes.

    The vertices of lines are thinned first (`THINNING_M`); both maps are counted in the same format.

    Args:
        semantic_map: The whole map.
        rig: Cameras.
        table: What masks will show.
        Ts_map_base: Places where the pose is to be held.
        keep_share: Share of the bytes, in (0, 1].
        write: Format that bytes are counted in.
        whole_bytes: Size of the whole map; None for that of the whole map written in this format.
        config: None for the defaults.

    Raises:
        SemlocError: a share outside (0, 1], or so small that no element fits.
    """
    if not 0 < keep_share <= 1:
        raise SemlocError(f"small map: share {keep_share}; expected more than 0 and at most 1, such as 0.2")
    thin = semantic_map.with_elements(thinned(element) for element in semantic_map.elements)
    cost, overhead = element_bytes(thin, write)
    whole_bytes = whole_bytes or map_bytes(semantic_map, write)
    # What is long is a sharper measure of the pose than many small things, unless its place in the map is doubted.
    config = config or SurveyConfig()
    information = element_information(thin, rig, table, Ts_map_base, config, shared_error=0.0)
    budget = limit = keep_share * whole_bytes
    # What a packed format needs for many elements is not the sum of what it needs for each: what is over is given back.
    for _ in range(20):
        taken, _ = greedy_order(information, cost, budget - overhead)
        small = thin.with_elements(thin.elements[index] for index in sorted(taken))
        size = map_bytes(small, write) if taken else 0
        if size <= limit:
            break
        budget -= 0.7 * (size - limit) + 0.002 * limit
    if not 0 < size <= limit:
        raise SemlocError(f"small map: {keep_share:g} of {whole_bytes} bytes holds no element; give a larger share")
    everything = range(len(thin.elements))
    sigma, whole = (rms_sigma(information.sigma(chosen)) for chosen in (taken, everything))
    return SmallMap(small, size / whole_bytes, sigma, whole)


def thinned(element: MapElement) -> MapElement:
    """The element with fewer vertices where it is smooth, and coordinates of two decimals."""
    points = element.points
    if not (element.closed or element.label in UPRIGHT_CLASSES or len(points) < 3):
        points = simplify(points, THINNING_M)
    return replace(element, points=np.round(points / THINNING_M) * THINNING_M)


def map_bytes(semantic_map: SemanticMap, write: Write) -> int:
    """Size of the map's file in a format."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map"
        write(semantic_map, path)
        return path.stat().st_size


def element_bytes(semantic_map: SemanticMap, write: Write) -> tuple[Float[np.ndarray, " element"], int]:
    """What each element adds to the size of a file, and the size of a file without elements.

    In a packed format an element needs less beside others than alone: the costs are scaled to the size of the whole.
    """
    overhead = map_bytes(semantic_map.with_elements(()), write)
    alone = [map_bytes(semantic_map.with_elements((element,)), write) for element in semantic_map.elements]
    cost = np.maximum(np.array(alone, dtype=np.float64) - overhead, 1.0)
    return cost * (map_bytes(semantic_map, write) - overhead) / cost.sum(), overhead


def rms_sigma(sigma: Float[np.ndarray, "place 3"]) -> Float[np.ndarray, "3"]:
    """Root mean square over places of longitudinal, lateral [m] and heading [rad] sigmas; the heading in degrees."""
    return np.sqrt(np.mean(sigma**2, axis=0)) * [1.0, 1.0, np.rad2deg(1.0)]
