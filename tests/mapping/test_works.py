"""What changes near by says how likely a thing has changed with it."""

import numpy as np
import pytest

from semloc_jax.mapping.crowd.looks_chain import ChangeRates, PresenceConfig, likelihood, smoothed
from semloc_jax.mapping.crowd.presence import presence
from semloc_jax.mapping.crowd.works import change_rates, things_near
from tests.mapping.crowd_world import looks

CONFIG = PresenceConfig()
OLD, NEW, STAYS = [1] * 6 + [0] * 4, [0] * 6 + [1] * 4, [1] * 10


def row_of_bars(rarely_seen, step_m=1.0):
    """Ten drives: a crosswalk is laid elsewhere before the seventh, all else stays; one thing more beside it."""
    seen = np.array([OLD] * 5 + [NEW] * 5 + [STAYS] * 10 + [rarely_seen])
    return looks(seen, place=np.column_stack([step_m * np.arange(len(seen)), np.zeros(len(seen))]))


@pytest.mark.parametrize(
    ("sights", "is_there"), [([0] * 6 + [1, 0, 0, 1], True), ([0] * 2 + [1, 0, 1] + [0] * 5, False)]
)
def test_a_bar_of_a_new_crosswalk_is_believed_with_fewer_looks(sights, is_there):
    """Shown by two of four drives since the works it is there; two sights before them tell of no works."""
    assert not presence(row_of_bars(sights, step_m=1000.0), CONFIG).stays[-1]
    assert presence(row_of_bars(sights), CONFIG).stays[-1] == is_there


def test_what_is_missed_alone_has_not_gone_sooner():
    """Three drives miss one of twenty things that stay: all is as if nothing lay near it."""
    seen = np.array([STAYS] * 20)
    seen[7, -3:] = 0
    near = np.column_stack([np.arange(20.0), np.zeros(20)])
    alone, beside = presence(looks(seen), CONFIG), presence(looks(seen, place=near), CONFIG)
    assert beside.stays.all() and beside.now == pytest.approx(alone.now, abs=1e-4)


def test_rates_count_the_others_only_and_have_bounds():
    held = row_of_bars([1] * 10)
    like = likelihood(held, held.visible, np.array([0.8]), np.array([0.03]), np.ones(10), CONFIG)
    near = things_near(held, CONFIG)
    assert near.diagonal().max() == 0.0 and (near != near.T).nnz == 0
    flat = change_rates(held, near, None, CONFIG.vanish, CONFIG)
    assert flat.go == pytest.approx(CONFIG.vanish) and flat.come == pytest.approx(CONFIG.appear)
    found = change_rates(held, near, smoothed(held, like, flat), CONFIG.vanish, CONFIG)
    assert found.go[-1, 6] == CONFIG.most_go and found.come[-1, 6] == CONFIG.most_come
    assert found.go[-1, [3, 9]] == pytest.approx(CONFIG.vanish, rel=0.2)
    assert found.come[-1, [3, 9]] == pytest.approx(CONFIG.appear, rel=0.2)


def test_one_chain_by_hand():
    """Two drives, one thing, seen and then missed: Bayes by hand."""
    held = looks([[1, 0]])
    like = np.array([[[0.1, 0.6], [0.9, 0.4]]])
    chain = smoothed(held, like, ChangeRates(np.full((1, 2), 0.2), np.full((1, 2), 0.05)))
    # there, there; there, gone; not, not; not, come
    paths = np.array([0.3 * 0.6 * 0.8 * 0.4, 0.3 * 0.6 * 0.2 * 0.9, 0.7 * 0.1 * 0.95 * 0.9, 0.7 * 0.1 * 0.05 * 0.4])
    assert chain.evidence == pytest.approx(paths.sum())
    paths /= paths.sum()
    assert chain.present[0] == pytest.approx([paths[0] + paths[1], paths[0] + paths[3]])
    assert chain.now == pytest.approx(paths[0] + paths[3])
    assert (chain.went[0], chain.came[0]) == (pytest.approx([0.0, paths[1]]), pytest.approx([0.0, paths[3]]))
