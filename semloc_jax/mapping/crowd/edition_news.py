"""What is news of an element that cars hold (room: mapping; host).

In: elements as they were published, the same as more drives place them. Out: News: which to tell again, and how.
It is news that an element lies farther off than what it may be off itself, that it is much surer, that it is rather
gone than there, or that it looks otherwise.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from jaxtyping import Float

from semloc_jax.evaluation.map_shapes import POSTS, is_line, thing_of
from semloc_jax.mapping.crowd.elements import stepped
from semloc_jax.mapping.crowd.merged import Known
from semloc_jax.maps import Belief, MapElement

_LIKELY = 11.8
"""Squared distance over variances in two directions that 99.7 % of what has not changed stay below: of some hundred
elements of a tile hardly one is told for nothing."""
_LEAST_SIGMA_M = np.array([0.02, 0.007])
"""Along and across; with the number above what is 7 cm along or 2.4 cm aside is news. Less moves no car by as much as
its own masks do."""
_STEP = 2.0
"""Standard deviations in a step: less than what is news."""
_HALF_M, _HEIGHT_M, _POST_HEIGHT_M = np.array([0.08, 0.03]), 0.1, 0.4
"""How much half the length and half the width of paint may differ, and heights, of paint and of posts: the borders of
masks and the heights of drives say no more of one thing; ours."""
_SIZE_M, _TURN = 0.01, 0.99
_SURER = 16.0
"""An element is told again once so many times, to twice that, as many drives have seen it, each at its own share: not
all at once. Their number is its information; how noisy drives are is guessed anew in every solve."""
_DOUBT, _TRUST = -1.0, 2.0
"""Log odds at which something that was there is told as rather gone, and that again as there: what lies between them is
as it was, so that one look to and fro tells nothing."""
_LOGIT_STEP = 2.0
"""How finely existence is told."""
_SHARED = ("sigma_place_m", "sigma_turn_rad")
_LEAST_TOLD = 8
"""Fewer elements do not tell how far all of them go."""
_MEDIAN_OF_NORMAL, _ROUNDING = 0.6745, 0.08


@dataclass(frozen=True)
class News:
    """What counts as news in one edition.

    Attributes:
        spread: `float64[2]` how far all elements have moved, in their sigmas, along and across; 1 or more. What all of
            them do, since drives bend and more of them know better, is no news of any: each is told again when it is
            much surer.
    """

    spread: Float[np.ndarray, "2"]

    @classmethod
    def of(cls, pairs: Sequence[tuple[Known, Known]]) -> "News":
        """By elements as they were published and as they are now, in one frame."""
        rows = [np.abs(_far_m(e, f)) / _sigmas(f, c) for (e, _), (f, c) in pairs if not is_line(e)]
        if len(rows) < _LEAST_TOLD:
            return cls(np.ones(2))
        return cls(np.maximum(np.median(rows, axis=0) / _MEDIAN_OF_NORMAL, 1.0))

    def aside_m(self, belief: Belief) -> float:
        """How far aside a place of a line may lie that still is on it; of many places the farthest counts."""
        sigma_m = max(belief.sigma_across_m, float(_LEAST_SIGMA_M[1]))
        return float(np.sqrt(_LIKELY) * self.spread[1] * sigma_m)

    def told(self, old: MapElement, new: Known) -> MapElement:
        """A thing where cars shall hold it: where they do, or moved from there by whole steps, or where it is now.

        A step is what the thing may be off itself: the next drives then hardly ever make it another number of them.
        """
        element, belief = new
        if not _is_as_large(old, element) or _up_m(old, element) >= _height_m(element):
            return element
        far_m, sigma_m = _far_m(old, element), self.spread * _sigmas(element, belief)
        if np.square(far_m / sigma_m).sum() < _LIKELY:
            return replace(element, points=old.points)
        step_m = stepped(_STEP * sigma_m)
        shift_m = _axes(element).T @ (np.rint(far_m / step_m) * step_m)
        return replace(element, points=old.points + np.append(shift_m, 0.0))

    def after(self, old: Known, new: Known) -> Known:
        """What cars hold of an element after an edition: the same, or the same elsewhere, or what it is now.

        Args:
            old: what they hold.
            new: what it is now, where cars shall hold it; see `told`.
        """
        (e, b), (f, c) = old, new
        looks = [(x.label, x.style, x.shape, x.closed, is_line(x) or x.true_ends) for x in (e, f)]
        sizes = [abs(getattr(e, n) - getattr(f, n)) for n in ("width_m", "radius_m", "radius_top_m", "height_m")]
        faces = (e.normal is None) == (f.normal is None) and (e.normal is None or float(e.normal @ f.normal) > _TURN)
        was, now = b.existence_logit, c.existence_logit
        # That an element is surer, its number of drives says in time.
        stays = now > _DOUBT if was > 0.0 else now < _TRUST
        if looks[0] != looks[1] or max(sizes) > _SIZE_M or not faces or not stays or _is_surer(e.id, b, c):
            return replace(f, id=e.id), _retold(b, c)
        # Whether a line was seen to end where it ends, is told with its places: one drive more says it now so, now so.
        return old if np.array_equal(e.points, f.points) else (replace(e, points=f.points, true_ends=f.true_ends), b)


def newcomer(belief: Belief, beside: Belief | None) -> Belief:
    """A belief as cars are told of an element that is new to them.

    Args:
        belief: in the element.
        beside: as cars hold it, in the nearest element: what lies around a place shares its sigma. Theirs is as good,
            unless it says too little.
    """
    told = coarse(belief)
    held = {} if beside is None else {name: getattr(beside, name) for name in _SHARED}
    return replace(told, **{n: v for n, v in held.items() if getattr(told, n) <= v < 2.0 * getattr(told, n)})


def coarse(belief: Belief) -> Belief:
    """A belief as cars are told of it: sigmas up to steps of the root of two, counts down to powers of two.

    No sigma is told more than 8 % too small; that much, so that what was rounded to millimetres goes no step up again.
    """
    names = ("sigma_across_m", "sigma_along_m", "sigma_place_m", "sigma_turn_rad")
    stated = np.array([getattr(belief, name) for name in names])
    told = [round(v, n) for v, n in zip(stepped(stated * (1.0 - _ROUNDING)).tolist(), (3, 3, 3, 5), strict=True)]
    sigmas = {name: v if s > 0.0 else 0.0 for name, v, s in zip(names, told, stated, strict=True)}
    seen, missed = (2 ** (n.bit_length() - 1) if n else 0 for n in (belief.num_seen, belief.num_missed))
    logit = _LOGIT_STEP * float(np.rint(belief.existence_logit / _LOGIT_STEP)) + 0.0
    return replace(belief, **sigmas, existence_logit=logit, num_seen=seen, num_missed=missed)


def _retold(before: Belief, now: Belief) -> Belief:
    """A belief that is told again: what has hardly changed of it stays as cars hold it."""
    told = asdict(coarse(now))
    for name, old in asdict(before).items():
        numbers = isinstance(told[name], float | int) and isinstance(old, float | int)
        if numbers and _is_close(name, old, told[name]):
            told[name] = old
    return Belief(**told)


def _is_close(name: str, old: float | int, new: float | int) -> bool:
    """Whether a number of a belief has hardly changed."""
    if name == "existence_logit":
        return (new > 0.0) == (old > 0.0)
    return 0.5 < (new + 1e-9) / (old + 1e-9) < 2.0


def _is_as_large(old: MapElement, new: MapElement) -> bool:
    """Whether paint is as long and as wide as it was; a post has no size from above."""
    low_m, high_m = _off_m(old, new)
    return old.label in POSTS or bool((0.5 * np.abs(high_m - low_m) < _HALF_M).all())


def _up_m(old: MapElement, new: MapElement) -> float:
    """How much lowest and highest points differ."""
    (a, b), (c, d) = ((e.points[:, 2].min(), e.points[:, 2].max()) for e in (old, new))
    return float(max(abs(a - c), abs(b - d)))


def _height_m(element: MapElement) -> float:
    return _POST_HEIGHT_M if element.label in POSTS else _HEIGHT_M


def _sigmas(element: MapElement, belief: Belief) -> Float[np.ndarray, "2"]:
    """Along and across; of a post either way the same."""
    across_m = belief.sigma_across_m
    along_m = across_m if element.label in POSTS else belief.sigma_along_m
    return np.maximum([along_m, across_m], _LEAST_SIGMA_M)


def _axes(element: MapElement) -> Float[np.ndarray, "2 2"]:
    """Along and across an element."""
    along = thing_of(element).along
    return np.array([along, [-along[1], along[0]]])


def _off_m(old: MapElement, new: MapElement) -> Float[np.ndarray, "2 2"]:
    """How far both ends of a thing have moved along it, and both sides across it."""
    before, now = (thing_of(e).corners @ _axes(new).T for e in (old, new))
    return np.stack([now.min(axis=0) - before.min(axis=0), now.max(axis=0) - before.max(axis=0)])


def _far_m(old: MapElement, new: MapElement) -> Float[np.ndarray, "2"]:
    """How far the middle of a thing has moved, along and across."""
    return _off_m(old, new).mean(axis=0)


def _is_surer(name: str, before: Belief, now: Belief) -> bool:
    """Whether so many more drives have seen an element that cars should know."""
    share = hashlib.sha256(name.encode("utf-8", "surrogatepass")).digest()[0] / 256.0
    return now.num_seen >= _SURER * (1.0 + share) * max(before.num_seen, 1)
