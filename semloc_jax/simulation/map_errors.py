"""A map with the faults real maps have (room: simulation; host).

In: the true elements. Out: elements of which some are missing, moved or invented, and the list of changes.
"""

from dataclasses import dataclass, replace

import numpy as np

from semloc_jax.maps import MapElement
from semloc_jax.simulation.elements import shifted


@dataclass(frozen=True)
class MapErrors:
    """Shares of faulty elements, as in the rendered drives.

    Args:
        missing_share: elements left out.
        moved_share: elements moved.
        moved_sigma_m: standard deviation of that move in x and in y.
        phantom_share: copies of elements put where there is nothing.
    """

    missing_share: float = 0.08
    moved_share: float = 0.10
    moved_sigma_m: float = 0.35
    phantom_share: float = 0.015


def with_errors(
    elements: tuple[MapElement, ...], errors: MapErrors, rng: np.random.Generator
) -> tuple[tuple[MapElement, ...], list[dict]]:
    """The faulty map and its log: one entry {id, change, dx, dy} for each fault."""
    faulty, log = [], []
    for element in elements:
        fate = rng.random()
        if fate < errors.missing_share:
            log.append({"id": element.id, "change": "missing"})
            continue
        if fate < errors.missing_share + errors.moved_share:
            shift = np.append(errors.moved_sigma_m * rng.normal(size=2), 0.0)
            element = shifted(element, shift)
            log.append({"id": element.id, "change": "moved", "dx": float(shift[0]), "dy": float(shift[1])})
        faulty.append(element)
    for number in range(round(errors.phantom_share * len(elements))):
        source = elements[int(rng.integers(len(elements)))]
        shift = np.append(rng.uniform(1.0, 4.0, 2) * rng.choice([-1.0, 1.0], 2), 0.0)
        faulty.append(replace(shifted(source, shift), id=f"phantom_{number}"))
        log.append({"id": f"phantom_{number}", "change": "phantom", "dx": float(shift[0]), "dy": float(shift[1])})
    return tuple(faulty), log
