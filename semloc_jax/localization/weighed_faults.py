"""Faults of calibration and map that the drive has neither told nor excluded, weighed by Bayes (room: localization;
host).

In: WatchState. Out: Causes: where the right pose would be under each fault, how sure, and how probable the fault is.
What a drive speaks for is no yes or no: a lens of which it says -1.6 % with 1 % of doubt may be exact, and one of which
it says nothing may be 5 % off. So each fault is what it is before the drive, one vehicle or map in two hundred, times
what the frames say of it; its sizes are left as open as the frames leave them.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import expit, logit, stdtr

from semloc_jax.alignment.frame_levels import AS_LEVELS
from semloc_jax.evaluation.mixture_bounds import Causes
from semloc_jax.localization import lens_way
from semloc_jax.localization.integrity import LEVEL_UNITS
from semloc_jax.localization.moved_elements import CLASSES, near, profile_of
from semloc_jax.localization.other_calibrations import ASIDE, FOCAL, STEPS, WIDTH, alternatives
from semloc_jax.localization.watch import HEADING_HELD_RAD
from semloc_jax.localization.watch_config import WatchConfig
from semloc_jax.localization.watch_sums import WatchState, means_of

PROBABILITY = 0.005
"""Of each fault before the drive: one in two hundred. Ours."""
_WIDE_STEPS = 1.0
"""How far such a lens is off, one standard deviation, in the steps of the watch. Ours."""
_EXACT_STEPS = 0.05
"""How far one is that is as it should be: 0.125 % of a focal length. Ours."""
_LEAST_BEND_NATS = 0.05
"""What a step off must cost a frame at least for a frame to tell. Country roads with lines, dashes and posts alone have
0.1 to 0.6, streets 1 to 5: with less a lens may be anything that lenses are before the drive."""
_LEAST_BEND_OF_SMALL_NATS = 0.8
"""The same of small masks (`perception.finer_masks`): there what they like is told by their pixels and by how much of
the map is in view. A real drive of 400 x 120 px with exact masks likes a lens that is 2.5 to 5 % longer by 0.6 nats a
frame; the same masks held against contours that are chosen once for all lenses like one that is 4 % shorter by 1."""
_OPEN_STEPS = 10.0
"""Standard deviation of a size that frames do not tell. Ours."""
_ASIDE_ROW = alternatives(2).index(ASIDE)
"""Its place among `alternatives` of rigs of several cameras."""
_FOCAL_ROW = alternatives(1).index(FOCAL)
"""The same for any rig."""
_HALVINGS = 24
_FAR = 32.0
"""Bounds are no larger [m, deg]; they are found to micrometres."""
_NEGLIGIBLE = 0.01
"""Places that together have less than this share of the risk are left out: most of them."""
_MOST_NATS = 50.0
"""More is certainty."""


Rows = tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]
"""Probability, mean and sigma of places: left [m], ahead [m], heading [rad]."""
_NOTHING: Rows = np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))


def weighed(
    watch: WatchState,
    names: tuple[str, ...],
    own_sigma: Float[np.ndarray, "3"],
    freedom: Float[np.ndarray, "3"],
    config: WatchConfig,
    is_small: bool = False,
    is_stated: bool = False,
) -> Causes:
    """Every fault with the places that it leaves to the right pose: left [m], ahead [m], heading [deg].

    Args:
        watch: Sums over the last frames.
        names: The `alternatives` of the rig.
        own_sigma: Standard deviations of the pose without faults, in the same order and units.
        freedom: Degrees of freedom that these stand on.
        config: Steps of the watch.
        is_small: Whether masks are small: what they say of lenses is told by their pixels.
        is_stated: Whether the map states how far all that is near may be off alike (`integrity.map_sigmas`).
    """
    rows = [_NOTHING]
    if len(watch.num):
        rows += [_of_calibration(watch, k, config, is_small) for k in _lenses(names)]
        rows += [_of_class(watch, name, config, is_stated) for name in CLASSES]
    return as_causes(tuple(np.concatenate(parts) for parts in zip(*rows, strict=True)), own_sigma, freedom)


def as_causes(rows: Rows, own_sigma: Float[np.ndarray, "3"], freedom: Float[np.ndarray, "3"]) -> Causes:
    """The same places with what the pose without faults is unsure of; further arguments as `weighed`."""
    probability, mean, sigma = rows
    total = np.hypot(sigma * LEVEL_UNITS, own_sigma)
    # What costs leave open has the tails of a Gaussian (Welch and Satterthwaite).
    return Causes(probability, mean * LEVEL_UNITS, total, freedom * (total / own_sigma) ** 4)


def _lenses(names: tuple[str, ...]) -> list[int]:
    """Which of `alternatives` are weighed.

    A road of another width is told with the height of the vehicle: a real drive with exact masks likes one that is
    0.1 m wider, from 0.35 m behind, and stands as high as its mounts say.
    """
    return [k for k, name in enumerate(names) if name != WIDTH]


class SizeTold(NamedTuple):
    """What the frames say of the size of one of `alternatives`, in steps, and how far the pose moves for each."""

    at: float
    variance: float
    moved: Float[np.ndarray, "3"]
    """Left [m], ahead [m], heading [rad]."""


def _told(watch: WatchState, k: int, config: WatchConfig, is_small: bool) -> SizeTold | None:
    """A Gaussian about what a parabola through the costs says, wide open where they say nothing; None where nothing was
    asked.

    A frame says so much of a size as its costs bend; of the frames, `WatchConfig.share` is new.
    """
    num, gain, moves = means_of(watch, k)
    if (num[:2] < 0.5).any():
        return None
    # Cameras that look aside by a step show a slope between the near steps and no bend. Lenses that are a step off are
    # told by `suspicions`.
    is_small_focal = is_small and k == _FOCAL_ROW
    far_too = k == _ASIDE_ROW or is_small_focal
    asked = num * (np.arange(len(num)) < (len(num) if far_too else 2))
    terms = np.sqrt(asked)[:, None] * np.stack([STEPS, -(STEPS**2)], axis=1)
    slope, bend = np.linalg.lstsq(terms, np.sqrt(asked) * gain, rcond=None)[0]
    moved = (0.5 * (moves[0] - moves[1]))[AS_LEVELS]
    # Masks that no lens bends at all are blurred: what solves with other lenses differ is then no distance either.
    by_way = lens_way.told(watch.lens) if is_small_focal and bend >= _LEAST_BEND_NATS else None
    if by_way is not None:
        return SizeTold(*by_way, moved)
    if bend < (_LEAST_BEND_OF_SMALL_NATS if is_small else _LEAST_BEND_NATS):
        return SizeTold(0.0, _OPEN_STEPS**2, moved)
    variance = 0.5 / (bend * config.share * float(num[:2].mean()))
    return SizeTold(0.5 * slope / bend, variance, moved)


def _of_calibration(watch: WatchState, k: int, config: WatchConfig, is_small: bool = False) -> Rows:
    """One of `alternatives` that is off by far more than calibrations are."""
    told = _told(watch, k, config, is_small)
    return _NOTHING if told is None else off_by_far(told, PROBABILITY)


def off_by_far(told: SizeTold, before: float) -> Rows:
    """A calibration that is off by far more than they are, as probable as `before` until the drive says more."""
    exact, aside = told.variance + _EXACT_STEPS**2, told.variance + _WIDE_STEPS**2
    nats = 0.5 * (told.at**2 * (1.0 / exact - 1.0 / aside) - np.log(aside / exact))
    probability = float(expit(logit(before) + nats))
    kept = _WIDE_STEPS**2 / aside
    size, spread = told.at * kept, np.sqrt(told.variance * kept)
    return np.array([probability]), (size * told.moved)[None], np.abs(spread * told.moved)[None]


def aside(watch: WatchState, names: tuple[str, ...], config: WatchConfig) -> float:
    """Probability that all cameras look aside alike, by the masks; arguments as `weighed`."""
    if ASIDE not in names or not len(watch.num):
        return PROBABILITY
    told, _, _ = _of_calibration(watch, _ASIDE_ROW, config)
    return float(told[0]) if len(told) else PROBABILITY


def heading_if_aside(watch: WatchState, names: tuple[str, ...], config: WatchConfig) -> tuple[float, float] | None:
    """Where the heading of the right pose is as seen from that of the pose if all cameras look aside, by the masks, and
    its standard deviation [rad]; None where they say nothing; arguments as `weighed`."""
    told = _told(watch, _ASIDE_ROW, config, False) if ASIDE in names and len(watch.num) else None
    if told is None or told.moved[2] == 0.0:
        return None
    num_new = config.share * float(means_of(watch, _ASIDE_ROW)[0][:2].mean())
    by_solve = num_new * (told.moved[2] / HEADING_HELD_RAD) ** 2
    by_masks = 1.0 / told.variance - by_solve
    if by_masks <= 0.0:
        return None
    at = told.at / (told.variance * by_masks)
    return float(at * told.moved[2]), float(abs(told.moved[2]) / np.sqrt(by_masks))


def of_sound_ones(
    watch: WatchState, names: tuple[str, ...], config: WatchConfig, is_small: bool = False
) -> Float[np.ndarray, "3"]:
    """Variance of a pose, left [m], ahead [m], heading [deg], by what calibrations that are as they should be are off
    all the same; arguments as `weighed`."""
    variance = np.zeros(3)
    for k in _lenses(names) if len(watch.num) else ():
        told = _told(watch, k, config, is_small)
        if told is not None:
            variance += told.moved**2 / (1.0 / told.variance + 1.0 / _EXACT_STEPS**2)
    return variance * LEVEL_UNITS**2


def _of_class(watch: WatchState, name: str, config: WatchConfig, is_stated: bool) -> Rows:
    """Elements of one kind that were moved: any of the places where they are looked at may be theirs.

    The pose that was found is that of all others; if it is these that are right, it is where they fit. Where nothing of
    them was in view all that was seen would have been moved alike. That is the map as a whole, of which no drive tells
    anything: who states how far it may be off answers for it, and it counts as far as they could tell by now.

    Args:
        is_stated: See `weighed`; other arguments there.
    """
    places, costs = profile_of(watch, name, config)
    nats = -config.share * costs
    here = float(np.max(nats[near(places)]))
    tells = -np.expm1(-np.ptp(nats)) if is_stated else 1.0
    odds = tells * PROBABILITY / (1.0 - PROBABILITY) * np.exp(np.minimum(nats - here, _MOST_NATS)) / len(places)
    mean = np.zeros((len(places), 3))
    mean[:, int(name.endswith("ahead"))] = places
    return odds / (1.0 + odds.sum()), mean, np.zeros_like(mean)


def is_alone(watch: WatchState, config: WatchConfig) -> bool:
    """Whether nothing of some kind of elements was in view, so that all others may have been moved alike."""
    return bool(len(watch.num)) and not all(profile_of(watch, name, config)[1].any() for name in CLASSES)


def reach(causes: Causes, share: float) -> Float[np.ndarray, "2 3"]:
    """Between which left [m], ahead [m], heading [deg] the right pose is but for a risk on either side.

    Where faults are less probable than the risk the least lies beyond the most: anywhere holds.

    Args:
        causes: From `weighed`.
        share: The risk.
    """
    rising = np.argsort(causes.probability)
    kept = rising[np.cumsum(causes.probability[rising]) > _NEGLIGIBLE * share]
    if not len(kept):
        return np.array([np.full(3, _FAR), np.full(3, -_FAR)])
    causes = Causes(*(column[kept] for column in causes))

    def most(side: float) -> np.ndarray:
        low, high = np.full(3, -_FAR), np.full(3, _FAR)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            beyond = causes.probability @ stdtr(causes.freedom, (side * causes.mean - middle) / causes.sigma)
            low, high = np.where(beyond > share, middle, low), np.where(beyond > share, high, middle)
        return high

    return np.array([-most(-1.0), most(1.0)])
