"""The chain of looks at a thing: it vanishes and appears at a small rate, looks show it or not (room: mapping; host).

In: Looks, P_D and P_F, how often things come and go. Out: presence at each drive and at the last one.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

_TINY = 1e-12


@dataclass(frozen=True)
class PresenceConfig:
    """How things come and go. All values are ours.

    Args:
        vanish: probability that a thing is gone when the next drive comes, before any look.
        steps: so many things watched over a step that belief is worth.
        appear: probability that one has come where there was none.
        works_m: works change what lies so near together at once.
        works_things: before any look, what lies near by says as much as so many things that are as everywhere.
        most_go, most_come: no works are taken to change a larger share: two drives that miss what stands there, behind
            one parked lorry, say, do not yet take it away.
        days: drives so many days apart count as one step; closer ones as less, down to a tenth.
        surely: what was more probable than that was there.
        gone: it goes once it is less probable than that, and not at one half: a gap in a map costs more than something
            that stays in it for one drive more.
        born: probability before any look that something is where the first drive shows it.
        unmapped: the same where somebody surveyed all that is there and has it not.
        based: the same of a thing of the base map.
        hidden: that no drive can see a thing of the base map that hangs higher than any vehicle and that none has seen:
            above the road it soon leaves the picture.
        detected, false: P_D and P_F before any look.
        looks: so many looks that belief is worth.
        least_false, most_false: no class is taken to show things that are not there less or more often.
        most_detected: no drive is taken to show more of what is there: what hides one thing is not always known.
    """

    vanish: float = 0.005
    steps: float = 500.0
    appear: float = 0.005
    works_m: float = 20.0
    works_things: float = 5.0
    most_go: float = 0.05
    most_come: float = 0.2
    days: float = 30.0
    surely: float = 0.8
    gone: float = 0.3
    born: float = 0.3
    unmapped: float = 0.03
    based: float = 0.99
    hidden: float = 0.3
    detected: float = 0.7
    false: float = 0.03
    looks: float = 8.0
    least_false: float = 0.02
    most_false: float = 0.15
    most_detected: float = 0.85


@dataclass(frozen=True)
class Looks:
    """Who looked at what; drives in the order of time.

    Attributes:
        visible: `bool[n d]` whether a drive would have seen a thing.
        seen: `bool[n d]` whether it did.
        group: `int[n d]` class and distance from the way: what shares a P_D.
        kind: `int[n]` class: what shares a P_F.
        is_based: `bool[n]` whether it is a thing of the base map.
        steps: `float[d]` time before each drive, in steps.
        before: `float[n]` probability that it was there before any of these drives.
        counted: `int[n 2]` how many drives before saw and missed it.
        hidden: `float[n]` probability that no drive can see it, however often one passes.
        place: `float[n 2]` where it lies [m]; None where what lies near by says nothing of it.
    """

    visible: Bool[np.ndarray, "n d"]
    seen: Bool[np.ndarray, "n d"]
    group: Int[np.ndarray, "n d"]
    kind: Int[np.ndarray, " n"]
    is_based: Bool[np.ndarray, " n"]
    steps: Float[np.ndarray, " d"]
    before: Float[np.ndarray, " n"]
    counted: Int[np.ndarray, "n 2"]
    hidden: Float[np.ndarray, " n"]
    place: Float[np.ndarray, "n 2"] | None = None

    @property
    def counts(self) -> Int[np.ndarray, "n 2"]:
        """How many drives saw each thing, and how many looked and did not."""
        missed = self.visible & ~self.seen
        return self.counted + np.stack([self.seen.sum(axis=1), missed.sum(axis=1)], axis=1)


def likelihood(
    looks: Looks, visible: np.ndarray, detected: np.ndarray, false: np.ndarray, good: np.ndarray, c: PresenceConfig
) -> Float[np.ndarray, "n d 2"]:
    """How likely what each drive shows of each thing is, without the thing and with it."""
    p_d = np.clip(detected[looks.group] * good, 0.05, c.most_detected)
    p_f = np.minimum(false[looks.kind][:, None], 0.5 * p_d)
    like = np.stack([np.where(looks.seen, p_f, 1.0 - p_f), np.where(looks.seen, p_d, 1.0 - p_d)], axis=2)
    return np.where(visible[:, :, None], like, 1.0)


class ChangeRates(NamedTuple):
    """How likely things change in the step before each drive."""

    go: Float[np.ndarray, "n d"]
    """That what was there is gone."""
    come: Float[np.ndarray, "n d"]
    """That what was not there has come."""


class PresenceChain(NamedTuple):
    """What all looks at things say together."""

    present: Float[np.ndarray, "n d"]
    """Probability that each was there at each drive."""
    now: Float[np.ndarray, " n"]
    """The same at the last drive, by the looks up to it."""
    went: Float[np.ndarray, "n d"]
    """Probability that it went in the step before each drive."""
    came: Float[np.ndarray, "n d"]
    """The same, that it came; 0 before the first drive."""
    evidence: Float[np.ndarray, " n"]
    """How likely all looks at it are together."""


def smoothed(looks: Looks, like: Float[np.ndarray, "n d 2"], rates: ChangeRates) -> PresenceChain:
    """The chain of each thing, by all looks before and after each drive."""
    n, d = looks.seen.shape
    stay = np.array([[1.0 - rates.come, rates.come], [rates.go, 1.0 - rates.go]]).transpose(2, 3, 0, 1)
    ahead, evidence = np.zeros((n, d, 2)), np.ones(n)
    state = looks.before
    state = np.stack([1.0 - state, state], axis=1)
    for k in range(d):
        # What a drive is the first to look at was not there longer than anybody knows.
        state = (np.einsum("na,nab->nb", state, stay[:, k]) if k else state) * like[:, k]
        total = np.maximum(state.sum(axis=1, keepdims=True), _TINY)
        state, evidence = state / total, evidence * total[:, 0]
        ahead[:, k] = state
    now, behind = ahead[:, -1, 1].copy() if d else state[:, 1], np.ones((n, 2))
    both, went, came = ahead.copy(), np.zeros((n, d)), np.zeros((n, d))
    for k in range(d - 2, -1, -1):
        after = behind * like[:, k + 1]
        pairs = ahead[:, k, :, None] * stay[:, k + 1] * after[:, None]
        pairs /= np.maximum(pairs.sum(axis=(1, 2), keepdims=True), _TINY)
        went[:, k + 1], came[:, k + 1] = pairs[:, 1, 0], pairs[:, 0, 1]
        behind = np.einsum("nab,nb->na", stay[:, k + 1], after)
        behind /= np.maximum(behind.sum(axis=1, keepdims=True), _TINY)
        both[:, k] = ahead[:, k] * behind
    present = both[:, :, 1] / np.maximum(both.sum(axis=2), _TINY)
    return PresenceChain(present, now, went, came, evidence)


def smoothed_or_hidden(
    looks: Looks, like: Float[np.ndarray, "n d 2"], rates: ChangeRates
) -> tuple[np.ndarray, np.ndarray]:
    """Presence at each drive and at the last, when looks may say nothing of what nobody has ever seen."""
    chain, blind = smoothed(looks, like, rates), smoothed(looks, np.ones_like(like), rates)
    is_unseen = ~looks.seen.any(axis=1) & (looks.counted[:, 0] == 0)
    hidden = np.where(is_unseen, looks.hidden, 0.0)
    hidden = hidden / np.maximum(hidden + (1.0 - hidden) * chain.evidence, _TINY)
    present = chain.present + hidden[:, None] * (blind.present - chain.present)
    return present, chain.now + hidden * (blind.now - chain.now)
