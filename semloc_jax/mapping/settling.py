"""Elements laid where the masks have them, along a way that stands (room: mapping; host).

In: elements as they were drawn, what frames say of each of them. Out: the same elements, sized and moved.
The road seen from above shows paint to a cell, and as far aside as the plane under the vehicle is off; the masks
themselves say better where it is and how large. Each element moves as a rigid body, a long line piece by piece.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Frame
from semloc_jax.geometry import polyline, rigid
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.element_pulls import ElementPulls, PullConfig, Pulls, pieces_of
from semloc_jax.mapping.joint import place_of, square_roots
from semloc_jax.mapping.sizing import sized
from semloc_jax.maps import MapElement, SemanticMap

Progress = Callable[[Iterable, str], Iterable]
"""Shows how far an iteration over frames has come; takes what it is about."""
PullsAt = Callable[[list[MapElement], float], list[Pulls]]
"""(elements, reach [px]) -> what every frame says of them."""
_LEAST_SHARE = 1e-7
_REWEIGHTED = 5


@dataclass(frozen=True)
class SettleConfig:
    """How elements are laid where masks have them. All values are ours.

    Args:
        rounds: how often frames and elements are compared; 0 leaves elements as they were drawn.
        every_m: way between the frames that are compared.
        reach_px: borders of masks farther from an element do not pull it.
        sigma_xy_m: how far an element may be from where it was drawn.
        sigma_z_m: how far above or below the road.
        sigma_tilt_deg: how far from lying in it.
        sigma_turn_deg: how far it may be turned.
        threshold: norm of a whitened pull (6 numbers) beyond which it grows no more.
        min_frames: an element that fewer frames pull stays where it is.
    """

    rounds: int = 2
    every_m: float = 1.0
    reach_px: float = 6.0
    sigma_xy_m: float = 0.1
    sigma_z_m: float = 0.01
    sigma_tilt_deg: float = 0.2
    sigma_turn_deg: float = 2.0
    threshold: float = 12.0
    min_frames: int = 3

    @property
    def sigma(self) -> Float[np.ndarray, " 6"]:
        """Of the right tangent of an element."""
        tilt, turn = np.deg2rad([self.sigma_tilt_deg, self.sigma_turn_deg])
        return np.array([self.sigma_xy_m, self.sigma_xy_m, self.sigma_z_m, tilt, tilt, turn])


def settled_in(
    elements: Sequence[MapElement],
    masks: MaskSource,
    frames: Sequence[Frame],
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    config: SettleConfig,
    progress: Progress,
) -> list[MapElement]:
    """The elements, each moved to where masks have it; arguments as `settled` and `make_map`."""
    step_m = np.linalg.norm(np.diff(Ts_map_base[:, :2, 3], axis=0), axis=1)
    way_m = np.concatenate([[0.0], np.cumsum(step_m)])
    rows = np.unique(np.floor(way_m / config.every_m), return_index=True)[1]

    def pulls_at(pieces: list[MapElement], reach_px: float) -> list[Pulls]:
        pulling = ElementPulls(SemanticMap(tuple(pieces)), masks.table, PullConfig(reach_px=reach_px))
        looked = ((frames[row], Ts_map_base[row]) for row in progress(rows, "settling"))
        return [pulling.of(masks.masks(frame), masks.seen_by(frame.rig), T) for frame, T in looked]

    return settled(elements, pulls_at, Ts_map_base[rows], config) if len(elements) else []


def settled(
    elements: Sequence[MapElement],
    pulls_at: PullsAt,
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    config: SettleConfig | None = None,
) -> list[MapElement]:
    """The elements, each moved to where the frames have it.

    Args:
        elements: as they were drawn.
        pulls_at: holds the frames against elements.
        Ts_map_base: poses of the frames.
        config: None for the defaults.
    """
    config, found = config or SettleConfig(), list(elements)
    for _ in range(config.rounds):
        pieces = [pieces_of(element) for element in found]
        flat = [piece for own in pieces for piece in own]
        flat, pulls = sized(flat, pulls_at(flat, config.reach_px), Ts_map_base)
        motions = motions_of(flat, pulls, Ts_map_base, config)
        of_size = {piece.id: piece for piece in flat}
        pieces = [[of_size[piece.id] for piece in own] for own in pieces]
        found = [_moved(_sized_as(e, own), own, motions) for e, own in zip(found, pieces, strict=True)]
    return found


def _sized_as(element: MapElement, pieces: Sequence[MapElement]) -> MapElement:
    """An element as long and wide as its pieces."""
    if len(pieces) == 1:
        return pieces[0]
    return replace(element, width_m=float(np.median([piece.width_m for piece in pieces])))


def motions_of(
    elements: Sequence[MapElement],
    pulls: Sequence[Pulls],
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    config: SettleConfig,
) -> dict[str, Float[np.ndarray, "4 4"]]:
    """T_new_old in the map of every element that enough frames pull.

    Moving an element is moving the vehicle the other way, for that element alone: with T_base_element, the vehicle
    moves by -Ad(T_base_element) eta where the element moves by its right tangent eta.
    """
    rows: dict[str, list[tuple[int, int]]] = {}
    for frame, each in enumerate(pulls):
        for k, name in enumerate(each.ids):
            rows.setdefault(name, []).append((frame, k))
    found = {}
    for element in elements:
        seen = rows.get(element.id, [])
        if len(seen) < config.min_frames:
            continue
        T_map_element = place_of(element)
        Ad = rigid.adjoint(rigid.inverse(Ts_map_base[[f for f, _ in seen]]) @ T_map_element)
        information = np.array([pulls[f].information[k] for f, k in seen])
        force = np.array([pulls[f].force[k] for f, k in seen])
        root, offset = square_roots(information, force, _LEAST_SHARE)
        eta = _least(-root @ Ad, offset, config)
        found[element.id] = T_map_element @ rigid.exp(eta) @ rigid.inverse(T_map_element)
    return found


def _least(
    root: Float[np.ndarray, "f 6 6"], offset: Float[np.ndarray, "f 6"], config: SettleConfig
) -> Float[np.ndarray, " 6"]:
    """The tangent at which the robust sum of squares of root @ tangent + offset is least."""
    eta, prior = np.zeros(6), np.diag(config.sigma**-2.0)
    for _ in range(_REWEIGHTED):
        r = root @ eta + offset
        weight = 1.0 / (1.0 + (np.linalg.norm(r, axis=1) / config.threshold) ** 2)
        H = np.einsum("fia,f,fib->ab", root, weight, root) + prior
        eta = -np.linalg.solve(H, np.einsum("fia,f,fi->a", root, weight, offset))
    return eta


def _moved(element: MapElement, pieces: Sequence[MapElement], motions: dict[str, np.ndarray]) -> MapElement:
    """An element after the motions of its pieces; between the middles of two pieces a line takes a share of each."""
    ids = [piece.id for piece in pieces if piece.id in motions]
    if not ids:
        return element
    by_piece = np.array([_by(element.points, motions[name]) for name in ids])
    if len(pieces) == 1:
        return element.with_points(element.points + by_piece[0])
    s_m = polyline.arc_length(element.points)
    length_m = s_m[-1] / len(pieces)
    middles_m = length_m * (0.5 + np.array([k for k, piece in enumerate(pieces) if piece.id in motions]))
    share = np.array([np.interp(s_m, middles_m, row) for row in np.eye(len(ids))])
    return element.with_points(element.points + np.einsum("kp,kpi->pi", share, by_piece))


def _by(points: np.ndarray, T_new_old: np.ndarray) -> np.ndarray:
    return points @ T_new_old[:3, :3].T + T_new_old[:3, 3] - points
