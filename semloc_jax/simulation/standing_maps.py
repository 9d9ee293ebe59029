"""Maps that are wrong for a whole drive (room: simulation; host).

In: Maker, the size of a fault. Out: FaultyDrive. What is drawn at random is seeded.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from semloc_jax.maps import MapElement
from semloc_jax.simulation.faulty_drive import FaultyDrive, Maker
from semloc_jax.structs import ElementClass

_LINES = (ElementClass.LANE_MARKING, ElementClass.STOP_LINE, ElementClass.ROAD_MARK, ElementClass.SLOT_LINE)
_UPRIGHT = (ElementClass.POLE, ElementClass.SIGN, ElementClass.TRAFFIC_LIGHT, ElementClass.PILLAR, ElementClass.CONE)


def map_of(maker: Maker, change: Callable[[MapElement], MapElement | None]) -> FaultyDrive:
    """The map with every element changed; None takes it out."""
    kept = [new for element in maker.semantic_map.elements if (new := change(element)) is not None]
    return maker.whole(semantic_map=maker.semantic_map.with_elements(kept))


def moved(element: MapElement, shift_m: np.ndarray) -> MapElement:
    """The element moved on the ground [m]."""
    return element.with_points(element.points + np.append(shift_m, 0.0))


def map_missing(maker: Maker, share: float) -> FaultyDrive:
    """A share of the elements is missing."""
    return map_of(maker, lambda element: None if maker.rng.random() < share else element)


def map_worn(maker: Maker, size_m: float) -> FaultyDrive:
    """Two fifths of the elements are missing, three tenths moved."""

    def worn(element: MapElement) -> MapElement | None:
        fate, shift_m = maker.rng.random(), size_m * maker.rng.normal(size=2)
        return None if fate < 0.4 else moved(element, shift_m) if fate < 0.7 else element

    return map_of(maker, worn)


def map_scattered(maker: Maker, size_m: float) -> FaultyDrive:
    """Every element has a place error of its own."""
    return map_of(maker, lambda element: moved(element, size_m * maker.rng.normal(size=2)))


def _way_at(maker: Maker, p_map: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the way where it comes nearest to a place, and the unit vector to its left, float64[4 4], [2]."""
    way = maker.truth.T_map_base
    T = way[int(np.argmin(np.hypot(*(way[:, :2, 3] - p_map[:2]).T)))]
    return T, T[:2, 1] / np.linalg.norm(T[:2, 1])


def across(maker: Maker, element: MapElement) -> np.ndarray:
    """Unit vector to the left of the way where it comes nearest to an element, float64[2]."""
    return _way_at(maker, element.points.mean(axis=0))[1]


def along(maker: Maker, element: MapElement) -> np.ndarray:
    """Unit vector along the way where it comes nearest to an element, float64[2]."""
    left = across(maker, element)
    return np.array([left[1], -left[0]])


def _moved_where(
    maker: Maker,
    is_moved: Callable[[MapElement], bool],
    size_m: float,
    towards: Callable[[Maker, MapElement], np.ndarray] = across,
) -> FaultyDrive:
    """Some elements moved across or along the way."""
    return map_of(maker, lambda e: moved(e, size_m * towards(maker, e)) if is_moved(e) else e)


def lines_repainted(maker: Maker, size_m: float) -> FaultyDrive:
    """All lines lie aside of where the map has them; what stands is where it was."""
    return _moved_where(maker, lambda e: e.label in _LINES, size_m)


def posts_aside(maker: Maker, size_m: float) -> FaultyDrive:
    """All that stands is aside of where the map has it."""
    return _moved_where(maker, lambda e: e.label in _UPRIGHT, size_m)


def posts_along(maker: Maker, size_m: float) -> FaultyDrive:
    """All that stands is ahead of where the map has it."""
    return _moved_where(maker, lambda e: e.label in _UPRIGHT, -size_m, along)


def dashes_along(maker: Maker, size_m: float) -> FaultyDrive:
    """The dashes lie ahead of where the map has them."""
    return _moved_where(maker, lambda e: e.style == "dashed", size_m, along)


def map_mirrored(maker: Maker, share: float) -> FaultyDrive:
    """The map as in a mirror along the way; `share` of its elements, the others are missing."""

    def mirrored(element: MapElement) -> MapElement | None:
        if maker.rng.random() > share:
            return None
        near, left = _way_at(maker, element.points.mean(axis=0))
        offset_m = (element.points[:, :2] - near[:2, 3]) @ left
        points = element.points.copy()
        points[:, :2] -= 2.0 * offset_m[:, None] * left
        # Mirrored outlines run the other way round.
        return element.with_points(points[::-1] if element.closed else points)

    return map_of(maker, mirrored)


def map_scaled(maker: Maker, share: float) -> FaultyDrive:
    """The map is larger than the world, from the start of the way on."""
    middle = np.append(maker.semantic_map.extent[:, :2].mean(axis=0), 0.0)
    middle[:2] = maker.drive.truth_at(maker.drive.frames[0])[:2, 3] if maker.drive.truth is not None else middle[:2]
    scale = np.array([1.0 + share, 1.0 + share, 1.0])
    return map_of(maker, lambda element: element.with_points(middle + scale * (element.points - middle)))


def _middle(maker: Maker) -> np.ndarray:
    """Where the vehicle is in the middle frame, float64[4 4]."""
    frames = maker.drive.frames
    return maker.drive.truth_at(frames[len(frames) // 2])


def stretch_repainted(maker: Maker, size_m: float) -> FaultyDrive:
    """The lines of the second half of the way lie aside: the map is right until then."""
    T = _middle(maker)

    def is_ahead(element: MapElement) -> bool:
        return element.label in _LINES and bool((element.points.mean(axis=0) - T[:3, 3]) @ T[:3, 0] >= 0.0)

    return _moved_where(maker, is_ahead, size_m)


def one_side_moved(maker: Maker, size_m: float) -> FaultyDrive:
    """The road was made wider: all that lies to the left of the way is farther to the left."""

    def is_left(element: MapElement) -> bool:
        place = element.points.mean(axis=0)
        near, left = _way_at(maker, place)
        return bool((place[:2] - near[:2, 3]) @ left > 0.0)

    return _moved_where(maker, is_left, size_m)


def posts_missing(maker: Maker, share: float) -> FaultyDrive:
    """The map lacks a share of all that stands."""
    return map_of(maker, lambda element: None if element.label in _UPRIGHT and maker.rng.random() < share else element)


def phantoms(maker: Maker, share: float) -> FaultyDrive:
    """A share of the elements stands a second time some metres aside."""
    elements = list(maker.semantic_map.elements)
    for element in maker.semantic_map.elements:
        if maker.rng.random() < share:
            left = _way_at(maker, element.points[0])[1]
            shift_m = maker.rng.uniform(1.5, 4.0) * maker.rng.choice([-1.0, 1.0]) * left
            elements.append(replace(moved(element, shift_m), id=f"{element.id}-phantom"))
    return maker.whole(semantic_map=maker.semantic_map.with_elements(elements))


def widths(maker: Maker, factor: float) -> FaultyDrive:
    """The map states all lines wider than they are."""
    return map_of(
        maker, lambda e: replace(e, width_m=factor * e.width_m) if e.label in _LINES and e.width_m > 0.0 else e
    )


def heights(maker: Maker, size_m: float) -> FaultyDrive:
    """Every element has a height error of its own, as in a map from mixed sources."""

    def lifted(element: MapElement) -> MapElement:
        return element.with_points(element.points + np.array([0.0, 0.0, size_m * maker.rng.normal()]))

    return map_of(maker, lifted)


def old_lanes(maker: Maker, size_m: float) -> FaultyDrive:
    """Lane markings of the map are joined by those of an older state, which lie aside."""
    elements = list(maker.semantic_map.elements)
    for element in maker.semantic_map.elements:
        if element.label == ElementClass.LANE_MARKING:
            old = moved(element, size_m * across(maker, element))
            elements.append(replace(old, id=f"{element.id}-old"))
    return maker.whole(semantic_map=maker.semantic_map.with_elements(elements))


def map_shifted(maker: Maker, size_m: float) -> FaultyDrive:
    """The whole map lies to the left of the world."""
    left = _middle(maker)[:2, 1]
    return map_of(maker, lambda element: moved(element, size_m * left))


def map_turned(maker: Maker, size_deg: float) -> FaultyDrive:
    """The whole map is turned about the middle of the way."""
    centre, angle = _middle(maker)[:3, 3], np.deg2rad(size_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])

    def turned(element: MapElement) -> MapElement:
        normal = None if element.normal is None else turn @ element.normal
        return replace(element, points=centre + (element.points - centre) @ turn.T, normal=normal)

    return map_of(maker, turned)
