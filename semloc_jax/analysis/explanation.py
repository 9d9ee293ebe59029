"""What holds the pose of a frame, as an answer (room: analysis; host).

In: nothing. Out: Holder, Explanation. Directions are longitudinal, lateral and heading of the vehicle, in this order.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from semloc_jax.structs import ElementClass


@dataclass(frozen=True)
class Holder:
    """Something that holds the pose: a map element, a class of them, a part of the prior.

    Directions are longitudinal, lateral, heading of the vehicle [m, m, rad], in this order.

    Attributes:
        id: of the element, or the name of the class or part.
        label: class; None for parts of the prior.
        middle_map: where it is [m].
        num_samples: points of its contour in view.
        observations: number of independent observations they are worth, after the limit for one element.
        pull: what the robust loss leaves of them, 0 .. 1.
        residual_px: mean distance of the mask boundary from what pulls.
        share: of the variance of each direction that comes from it; all elements and parts of the prior sum to 1.
        sigma_without: standard deviation of each direction if it were not there.
        by_shift: d(direction) / d(shift along x, y, z of the map), metres or radians for each metre.
        by_turn: d(direction) / d(turn about the vertical through its middle), metres or radians for each radian.
        worst_map: unit direction of the map along which a shift moves the vehicle farthest: horizontal, upward for the
            road.
        linear_to_m: a shift along it up to which the loss holds on to what it pulls.
        linear: what a shift by `shift_m` along it does to each direction by the derivative.
        shifted: the same by the solver, whose robust loss rejects what is too far off.
        removed: what leaving it out does, as the solver answers it.
    """

    id: str
    label: ElementClass | None
    middle_map: Float[np.ndarray, "3"]
    num_samples: int
    observations: float
    pull: float
    residual_px: float
    share: Float[np.ndarray, "3"]
    sigma_without: Float[np.ndarray, "3"]
    by_shift: Float[np.ndarray, "3 3"]
    by_turn: Float[np.ndarray, "3"]
    worst_map: Float[np.ndarray, "3"]
    linear_to_m: float
    linear: Float[np.ndarray, "3"]
    shifted: Float[np.ndarray, "3"]
    removed: Float[np.ndarray, "3"]

    @property
    def is_element(self) -> bool:
        """Whether it is an element of the map, or a class of them."""
        return self.label is not None

    @property
    def strength(self) -> float:
        """Mean share of the three directions."""
        return float(np.mean(self.share))


@dataclass(frozen=True)
class Explanation:
    """What holds the pose of one frame.

    Attributes:
        T_map_base: the pose that is explained, the optimum nearest to that of the frame.
        offset: how far it lies from the pose of the frame: longitudinal, lateral [m], heading [rad].
        is_exact: whether it is an optimum to the last digit, so that derivatives are those of a solution.
        ramp_px: width of the ramp of the level that holds it.
        sigma: standard deviation of each direction [m, m, rad].
        shift_m: how far elements were taken to be wrong.
        holders: elements and parts of the prior, those with the largest share of the three directions first.
        classes: the same for all elements of a class together.
    """

    T_map_base: Float[np.ndarray, "4 4"]
    offset: Float[np.ndarray, "3"]
    is_exact: bool
    ramp_px: float
    sigma: Float[np.ndarray, "3"]
    shift_m: float
    holders: tuple[Holder, ...]
    classes: tuple[Holder, ...]

    @property
    def elements(self) -> tuple[Holder, ...]:
        """The holders that are map elements."""
        return tuple(holder for holder in self.holders if holder.is_element)

    @property
    def most_missed(self) -> Holder:
        """The element whose removal moves the vehicle farthest over the ground."""
        return max(self.elements, key=lambda holder: np.hypot(*holder.removed[:2]))
