"""How long and wide strips of paint are, by both of their sides in the same frames (room: mapping; host).

In: elements as they were drawn, what frames say of their sides. Out: the elements with the sizes that masks show.
Seen from above paint is as wide as it is smeared over: a line that is drawn 2 cm too wide is as far away as it looks
only where the vehicle is half a percent farther from it. In one frame two sides of a strip tell its size whatever the
pose is, so that a way with errors does no harm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.geometry import rigid
from semloc_jax.mapping.element_pulls import Pulls
from semloc_jax.mapping.joint import place_of
from semloc_jax.mapping.sides import NUM_SIDES, Strip, resized, strip_of
from semloc_jax.maps import MapElement

_REWEIGHTED = 4


@dataclass(frozen=True)
class SizeConfig:
    """How sizes are found. All values are ours.

    Args:
        sigma_m: how far length and width may be off as they were drawn.
        sigma_xy_m: how far the place of an element may be off in one frame.
        sigma_z_m: how far above or below the road.
        sigma_tilt_deg: how far from lying in it.
        sigma_turn_deg: how far it may be turned.
        threshold: a frame whose size is off by so many of its own sigmas counts half.
        min_frames: an element that fewer frames show keeps its size.
    """

    sigma_m: float = 0.2
    sigma_xy_m: float = 0.2
    sigma_z_m: float = 0.02
    sigma_tilt_deg: float = 0.3
    sigma_turn_deg: float = 3.0
    threshold: float = 2.0
    min_frames: int = 3

    @property
    def information(self) -> Float[np.ndarray, "6 6"]:
        """Of the right tangent of an element in one frame."""
        tilt, turn = np.deg2rad([self.sigma_tilt_deg, self.sigma_turn_deg])
        sigma = np.array([self.sigma_xy_m, self.sigma_xy_m, self.sigma_z_m, tilt, tilt, turn])
        return np.diag(sigma**-2.0)


class Sized(NamedTuple):
    """Elements with the sizes that masks show, and what the same frames say of these."""

    elements: list[MapElement]
    pulls: list[Pulls]


def sized(
    elements: Sequence[MapElement],
    pulls: Sequence[Pulls],
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    config: SizeConfig | None = None,
) -> Sized:
    """The strips among elements as long and wide as masks show them.

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
        seen, strip = rows.get(element.id, []), strip_of(element)
        if strip is None or len(seen) < config.min_frames:
            found.append(element)
            continue
        T_base_element = rigid.inverse(Ts_map_base[[f for f, _ in seen]]) @ place_of(element)
        H = np.array([pulls[f].side_information[k] for f, k in seen])
        moves = _moves(T_base_element, strip) * _seen_whole(H)[:, None, None, :]
        moves[..., 0] *= all(element.true_ends) or element.closed
        size_m = _size(H, np.array([force[f][k] for f, k in seen]), moves, rigid.adjoint(T_base_element), config)
        found.append(resized(element, *size_m))
        change = np.einsum("fsij,fsjx,x->fsi", H, moves, size_m)
        for (f, k), own in zip(seen, change, strict=True):
            force[f][k] += own
    changed = [each._replace(side_force=own) for each, own in zip(pulls, force, strict=True)]
    return Sized(found, changed)


def _seen_whole(H: Float[np.ndarray, "f 4 6 6"]) -> Bool[np.ndarray, "f 2"]:
    """Whether a frame shows both ends of a strip, and whether both of its long sides."""
    held = np.trace(H, axis1=2, axis2=3) > 0.0
    return np.stack([held[:, :2].all(axis=1), held[:, 2:].all(axis=1)], axis=1)


def _moves(T_base_element: np.ndarray, strip: Strip) -> Float[np.ndarray, "f 4 6 2"]:
    """Motion of the vehicle that does to each side what a longer and a wider strip does, for 1 m of either."""
    out = np.zeros((NUM_SIDES, 6, 2))
    out[:, :2] = 0.5 * strip.normals[:, :, None] * np.repeat(np.eye(2), 2, axis=0)[:, None]
    return -np.einsum("fij,sjx->fsix", rigid.adjoint(T_base_element), out)


def _size(
    H: Float[np.ndarray, "f 4 6 6"],
    force: Float[np.ndarray, "f 4 6"],
    moves: Float[np.ndarray, "f 4 6 2"],
    Ad: Float[np.ndarray, "f 6 6"],
    config: SizeConfig,
) -> Float[np.ndarray, " 2"]:
    """Length and width [m] to be added: in each frame the place of the element is left open."""
    H_moves = H @ moves
    by_place = np.einsum("fai,fsab,fbj->fij", Ad, H, Ad) + config.information
    cross = -np.einsum("fai,fsax->fix", Ad, H_moves)
    by_size = np.einsum("fsax,fsay->fxy", moves, H_moves)
    place, size = -np.einsum("fai,fsa->fi", Ad, force), np.einsum("fsax,fsa->fx", moves, force)
    left = np.linalg.solve(by_place, np.concatenate([cross, place[:, :, None]], axis=2))
    S = by_size - np.einsum("fix,fiy->fxy", cross, left[:, :, :2])
    g = size - np.einsum("fix,fi->fx", cross, left[:, :, 2])
    prior, found = config.sigma_m**-2 * np.eye(2), np.zeros(2)
    alone = -np.linalg.solve(S + prior, g[:, :, None])[:, :, 0]
    for _ in range(_REWEIGHTED):
        off = alone - found
        square = np.einsum("fx,fxy,fy->f", off, S, off)
        weight = 1.0 / (1.0 + square / config.threshold**2)
        found = -np.linalg.solve(np.einsum("f,fxy->xy", weight, S) + prior, weight @ g)
    return found
