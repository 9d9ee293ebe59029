"""The true shape of what was drawn on the road, by all of its sides in the same frames (room: mapping; host).

In: elements as they were drawn, what frames say of their sides. Out: the elements with the shapes that masks show.
Seen from above paint is as wide as it is smeared over, by cells, by looks from afar and by errors of the way. A line
that is drawn 2 cm too wide is as far away as it looks only where the vehicle is half a percent farther from it, and
what was smeared along a way that is too short asks for just that way. In one frame the sides of an element tell its
shape whatever the pose is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.geometry import rigid
from semloc_jax.mapping.element_pulls import Pulls
from semloc_jax.mapping.joint import place_of
from semloc_jax.mapping.sides import moved_out, sides_of
from semloc_jax.maps import MapElement

_REWEIGHTED = 4


@dataclass(frozen=True)
class SizeConfig:
    """How shapes are found. All values are ours.

    Args:
        sigma_m: how far out each side may lie from where it was drawn.
        sigma_xy_m: how far the place of an element may be off in one frame: so far that one side alone says nothing.
        sigma_z_m: how far above or below the road.
        sigma_tilt_deg: how far from lying in it.
        sigma_turn_deg: how far it may be turned.
        threshold: a frame whose shape is off by so many of its own sigmas counts half.
        min_frames: an element that fewer frames show keeps its shape.
    """

    sigma_m: float = 0.1
    sigma_xy_m: float = 10.0
    sigma_z_m: float = 0.02
    sigma_tilt_deg: float = 0.3
    sigma_turn_deg: float = 20.0
    threshold: float = 2.0
    min_frames: int = 3

    @property
    def information(self) -> Float[np.ndarray, "6 6"]:
        """Of the right tangent of an element in one frame."""
        tilt, turn = np.deg2rad([self.sigma_tilt_deg, self.sigma_turn_deg])
        sigma = np.array([self.sigma_xy_m, self.sigma_xy_m, self.sigma_z_m, tilt, tilt, turn])
        return np.diag(sigma**-2.0)


class Sized(NamedTuple):
    """Elements with the shapes that masks show, and what the same frames say of these."""

    elements: list[MapElement]
    pulls: list[Pulls]


def sized(
    elements: Sequence[MapElement],
    pulls: Sequence[Pulls],
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    config: SizeConfig | None = None,
) -> Sized:
    """What lies on the road as long, as wide and of the outline that masks show.

    Args:
        elements: as they were drawn.
        pulls: of every frame.
        Ts_map_base: poses at which they were measured.
        config: None for the defaults.
    """
    config = config or SizeConfig()
    rows: dict[str, list[tuple[int, int]]] = {}
    for frame, each in enumerate(pulls):
        for k, name in enumerate(each.ids):
            rows.setdefault(name, []).append((frame, k))
    found, force = [], [each.side_force.copy() for each in pulls]
    for element in elements:
        seen, sides = rows.get(element.id, []), sides_of(element)
        if sides is None or len(seen) < config.min_frames:
            found.append(element)
            continue
        num = len(sides.outward)
        H = np.array([pulls[f].side_information[k, :num] for f, k in seen])
        own = np.array([force[f][k, :num] for f, k in seen])
        Ad = rigid.adjoint(rigid.inverse(Ts_map_base[[f for f, _ in seen]]) @ place_of(element))
        shapes = sides.shapes
        moves = -np.einsum("fij,sj,sx->fsix", Ad[:, :, :2], sides.outward, shapes)
        shape = _shape(H, own, moves, Ad, config)
        found.append(moved_out(element, shapes @ shape))
        change = np.einsum("fsij,fsjx,x->fsi", H, moves, shape)
        for (f, k), more in zip(seen, change, strict=True):
            force[f][k, :num] += more
    changed = [each._replace(side_force=own) for each, own in zip(pulls, force, strict=True)]
    return Sized(found, changed)


def _shape(
    H: Float[np.ndarray, "f s 6 6"],
    force: Float[np.ndarray, "f s 6"],
    moves: Float[np.ndarray, "f s 6 q"],
    Ad: Float[np.ndarray, "f 6 6"],
    config: SizeConfig,
) -> Float[np.ndarray, " q"]:
    """How much of each shape [m] is to be added: in each frame the place of the element is left open.

    Args:
        H, force: of the sides, by the right tangent of the vehicle.
        moves: motion of the vehicle that does to a side what 1 m of a shape does.
        Ad: from the right tangent of the element to that of the vehicle.
        config: how sure what is.
    """
    H_moves = H @ moves
    by_place = np.einsum("fai,fsab,fbj->fij", Ad, H, Ad) + config.information
    cross = -np.einsum("fai,fsax->fix", Ad, H_moves)
    by_shape = np.einsum("fsax,fsay->fxy", moves, H_moves)
    place, shape = -np.einsum("fai,fsa->fi", Ad, force), np.einsum("fsax,fsa->fx", moves, force)
    left = np.linalg.solve(by_place, np.concatenate([cross, place[:, :, None]], axis=2))
    S = by_shape - np.einsum("fix,fiy->fxy", cross, left[:, :, :-1])
    g = shape - np.einsum("fix,fi->fx", cross, left[:, :, -1])
    prior, found = config.sigma_m**-2 * np.eye(S.shape[1]), np.zeros(S.shape[1])
    alone = -np.linalg.solve(S + prior, g[:, :, None])[:, :, 0]
    for _ in range(_REWEIGHTED):
        off = alone - found
        square = np.einsum("fx,fxy,fy->f", off, S, off)
        weight = 1.0 / (1.0 + square / config.threshold**2)
        found = -np.linalg.solve(np.einsum("f,fxy->xy", weight, S) + prior, weight @ g)
    return found
