"""Where a vehicle may be, from one sign or post and what then fits: the start in a compact map (room: alignment; host).

In: landmarks, shapes of one frame, a wide prior. Out: ExplicitFrame list, the one with the least error first.
Signs come first, the largest ones (Xiao 2018): size and bearing of one give the place, with the heading of the prior.
Lanes and lamp posts join after that.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from semloc_jax.alignment.explicit.frame import ExplicitConfig, ExplicitFrame, SeenShapes, explicit_frame
from semloc_jax.alignment.explicit.landmarks import Landmark
from semloc_jax.alignment.explicit.pairs import Match, are_of_one_shape, half_px, sign_match
from semloc_jax.alignment.explicit.pose import solved
from semloc_jax.alignment.explicit.sights import ShapeSight
from semloc_jax.geometry import rigid
from semloc_jax.structs import ElementClass

_MOST_SIGHTS = 3
"""So many of the largest signs, or posts where there are none, are tried."""
_MOST_REFINED = 8
"""So many of the most probable single pairs are taken further."""
_GATE = float(chdtri(3, 0.003))
"""Of a place and heading against the prior."""
_PLANAR = [0, 1, 5]


class _Pair(NamedTuple):
    match: Match
    T_start: Float[np.ndarray, "4 4"]
    chi2: float
    """Of its place against the prior."""


def explicit_starts(
    seen: SeenShapes,
    landmarks: Sequence[Landmark],
    T_prior: Float[np.ndarray, "4 4"],
    sigma: Float[np.ndarray, "6"],
    config: ExplicitConfig,
) -> list[ExplicitFrame]:
    """Poses that explain the shapes, best first; none where no sign and no whole post is in view.

    Args:
        seen: Shapes in the masks.
        landmarks: Of the map around, in the local frame.
        T_prior: Mean of the prior.
        sigma: Its standard deviations (right tangent): metres in the plane, some degrees of heading.
        config: How shapes are used.
    """
    pairs = [pair for sight in _first(seen.sights) for pair in _pairs(sight, landmarks, T_prior, sigma)]
    pairs.sort(key=lambda pair: pair.chi2)
    everything, found = np.ones(len(landmarks), bool), []
    for pair in pairs[:_MOST_REFINED]:
        alone = solved([pair.match], landmarks, T_prior, sigma, pair.T_start, config.association)
        found.append(explicit_frame(seen, landmarks, everything, T_prior, sigma, config, alone))
    return sorted((frame for frame in found if frame.matches), key=lambda frame: frame.nats)


def _first(sights: Sequence[ShapeSight]) -> list[ShapeSight]:
    """The largest signs, else the highest posts whose ends are both seen."""
    signs = [sight for sight in sights if sight.label == ElementClass.SIGN]
    if signs:
        return sorted(signs, key=lambda sight: -sight.shape.area_px)[:_MOST_SIGHTS]
    posts = [sight for sight in sights if sight.label == ElementClass.POLE and all(sight.shape.has_end)]
    return sorted(posts, key=lambda sight: sight.shape.axis.first - sight.shape.axis.last)[:_MOST_SIGHTS]


def _pairs(sight: ShapeSight, landmarks: Sequence[Landmark], T_prior: np.ndarray, sigma: np.ndarray) -> Iterator[_Pair]:
    """What a shape may be, and where the vehicle would then be."""
    for k, landmark in enumerate(landmarks):
        if landmark.label != sight.label:
            continue
        is_sign = landmark.label == ElementClass.SIGN
        if is_sign and not are_of_one_shape(landmark, sight.shape):
            continue
        T = _placed(sight, landmark, T_prior)
        off = rigid.log(rigid.inverse(T_prior) @ T)[_PLANAR] / sigma[_PLANAR]
        chi2 = float(off @ off)
        if chi2 < _GATE:
            match = sign_match(T, k, landmark, sight) if is_sign else _whole_post(k, landmark, sight)
            yield _Pair(match, T, chi2)


def _placed(sight: ShapeSight, landmark: Landmark, T_prior: np.ndarray) -> np.ndarray:
    """The pose with the heading of the prior from which a landmark is seen in that direction in that size."""
    if landmark.label == ElementClass.SIGN:
        distance_m = landmark.radius_m * sight.px_per_rad / half_px(sight.shape)
        ray = sight.sights.ray_cam[0]
    else:
        high_m = float(np.linalg.norm(landmark.points[1] - landmark.points[0]))
        low, high = sight.sights.ray_cam
        distance_m = high_m / max(float(np.arccos(np.clip(low @ high, -1.0, 1.0))), 1e-3)
        ray = (low + high) / np.linalg.norm(low + high)
    T_base_cam = sight.sights.T_base_cam[0]
    p_base = T_base_cam[:3, :3] @ (ray * distance_m) + T_base_cam[:3, 3]
    T = T_prior.copy()
    T[:2, 3] = (landmark.middle - T_prior[:3, :3] @ p_base)[:2]
    return T


def _whole_post(k: int, landmark: Landmark, sight: ShapeSight) -> Match:
    return Match(k, sight, landmark.points, (0, 1), (True, True))
