"""Is it still there? What is seen and missed drive after drive says, in the order of time (room: mapping; host).

In: who looked at each thing and who saw it. Out: probability that each is there after the last drive.
A chain of two states: things vanish and appear at a small rate between drives, so every certainty fades; a look that
shows the thing has probability P_D if it is there and P_F if not. They, and how many things go, are learned from the
drives themselves, P_D by class, distance from the way and drive (rain shows less), by expectation maximisation.
Things do not change one by one: works lay a whole crosswalk elsewhere. What goes and comes near by says how likely a
thing itself has, see `works`.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.mapping.crowd.looks_chain import Looks, PresenceConfig, likelihood, smoothed, smoothed_or_hidden
from semloc_jax.mapping.crowd.works import change_rates, things_near

_ROUNDS = 5


@dataclass(frozen=True)
class Presence:
    """What the looks say.

    Attributes:
        now: `float64[n]` probability that each thing is there after the last drive.
        then: `float64[n d]` that it was there at each drive, by all looks before and after.
        was: `bool[n]` whether it surely was there once.
        stays: `bool[n]` whether it belongs into the map after the last drive.
        detected: P_D of each group.
        false: P_F of each class.
        vanish: probability that a thing goes within a step.
    """

    now: Float[np.ndarray, " n"]
    then: Float[np.ndarray, "n d"]
    was: Bool[np.ndarray, " n"]
    stays: Bool[np.ndarray, " n"]
    detected: Float[np.ndarray, " g"]
    false: Float[np.ndarray, " k"]
    vanish: float


def presence(looks: Looks, config: PresenceConfig | None = None) -> Presence:
    """Probability that each thing is there, with P_D and P_F learned from the same looks."""
    c = config or PresenceConfig()
    num_groups = int(looks.group.max(initial=0)) + 1
    num_kinds = int(looks.kind.max(initial=0)) + 1
    detected, false = np.full(num_groups, c.detected), np.full(num_kinds, c.false)
    # A look that shows a thing is one, whatever the outline of the area says.
    visible = looks.visible | looks.seen
    good, vanish = np.ones(visible.shape[1]), c.vanish
    near = things_near(looks, c)
    rates = change_rates(looks, near, None, vanish, c)
    # A thing that never was is known by one false sight at least: that one says nothing about how frequent they are.
    spare = np.where(looks.is_based, 0.0, 1.0)
    for _ in range(_ROUNDS):
        like = likelihood(looks, visible, detected, false, good, c)
        chain = smoothed(looks, like, rates)
        present = chain.present
        watched = float((present[:, :-1] * looks.steps[1:]).sum())
        vanish = (float(chain.went.sum()) + c.steps * c.vanish) / (watched + c.steps)
        rates = change_rates(looks, near, chain, vanish, c)
        there = np.where(visible, present, 0.0)
        gone = np.where(visible, 1.0 - present, 0.0)
        hits = np.bincount(looks.group.ravel(), (there * looks.seen).ravel(), num_groups) + c.looks * c.detected
        total = np.bincount(looks.group.ravel(), there.ravel(), num_groups) + c.looks
        detected = np.clip(hits / total, 0.05, 0.99)
        expected = (there * np.minimum(detected[looks.group], 0.99)).sum(axis=0)
        good = (there * looks.seen).sum(axis=0) + c.looks * c.detected
        good = np.clip(good / (expected + c.looks * c.detected), 0.3, 1.1)
        kinds = np.repeat(looks.kind[:, None], visible.shape[1], axis=1)
        never = spare * (1.0 - present.max(axis=1, initial=0.0))
        first = np.bincount(looks.kind, never, num_kinds)
        shown = np.bincount(kinds.ravel(), (gone * looks.seen).ravel(), num_kinds) - first
        looked = np.bincount(kinds.ravel(), gone.ravel(), num_kinds) - first
        prior = 4.0 * c.looks
        shown, looked = np.maximum(shown, 0.0) + prior * c.false, np.maximum(looked, 0.0) + prior
        false = np.clip(shown / looked, c.least_false, c.most_false)
    present, now = smoothed_or_hidden(looks, like, rates)
    was = looks.is_based | (present.max(axis=1, initial=0.0) > c.surely)
    return Presence(now, present, was, belongs(now, was, c), detected, false, vanish)


def belongs(now: Float[np.ndarray, " n"], was: Bool[np.ndarray, " n"], c: PresenceConfig) -> Bool[np.ndarray, " n"]:
    """What belongs into the map: what is there rather than not, and what surely was and is not surely gone."""
    return now > np.where(was, c.gone, 0.5)
