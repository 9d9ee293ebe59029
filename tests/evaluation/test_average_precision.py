"""Average precision against areas that are worked out by hand."""

import numpy as np
import pytest

from semloc_jax.evaluation.average_precision import BoxSet, box_overlap, box_score

A, B, C = [0.0, 0.0, 10.0, 10.0], [20.0, 0.0, 30.0, 10.0], [0.0, 20.0, 10.0, 30.0]
FAR = [80.0, 80.0, 90.0, 90.0]


def picture(found, confidence, true, asked=None):
    true = np.array(true, float).reshape(-1, 4)
    asked = np.ones(len(true), bool) if asked is None else np.array(asked)
    return BoxSet(np.array(found, float).reshape(-1, 4), np.array(confidence, float), true, asked)


def test_overlap_is_the_shared_part_of_the_union():
    shifted = [5.0, 0.0, 15.0, 10.0]
    np.testing.assert_allclose(box_overlap(np.array(A), np.array([A, shifted, B])), [1.0, 1.0 / 3.0, 0.0])


def test_all_found_and_nothing_else_is_one():
    own = box_score([picture([A, B], [0.9, 0.6], [B, A]), picture([C], [0.8], [C])])
    assert own == (1.0, 3, 1.0, 1.0)


def test_a_false_box_costs_by_its_rank():
    """Right, false, right of four true ones: precision 1 at recall 1/4, 2/3 at 2/4, nothing beyond."""
    own = box_score([picture([A, FAR, B], [0.9, 0.8, 0.7], [A, B, C]), picture([], [], [A])])
    assert own.average_precision == pytest.approx(0.25 * (1.0 + 2.0 / 3.0))
    assert (own.recall, own.precision) == (0.5, pytest.approx(2.0 / 3.0))
    # Below all right ones it costs nothing.
    assert box_score([picture([A, FAR], [0.9, 0.1], [A])]).average_precision == 1.0


def test_precision_is_made_falling():
    """False, right, right of two: 1/2 then 2/3; the first counts as the better one that follows."""
    own = box_score([picture([FAR, A, B], [0.9, 0.8, 0.7], [A, B])])
    assert own.average_precision == pytest.approx(2.0 / 3.0)


def test_a_second_box_of_one_thing_is_false():
    own = box_score([picture([A, A, B], [0.9, 0.8, 0.7], [A, B])])
    assert own.average_precision == pytest.approx(0.5 * (1.0 + 2.0 / 3.0))


def test_what_is_not_asked_for_counts_for_nothing():
    """Found or not, whole or in part: but what is asked for is taken first."""
    part = [20.0, 0.0, 24.0, 10.0]
    own = box_score([picture([B, part, A], [0.9, 0.8, 0.7], [A, B], [True, False])])
    assert own == (1.0, 1, 1.0, 1.0)
    missed = box_score([picture([], [], [A, B], [True, False])])
    assert (missed.average_precision, missed.num_true, missed.recall) == (0.0, 1, 0.0)


def test_nothing_to_find_is_no_number():
    own = box_score([picture([A], [0.9], [])])
    assert np.isnan(own.average_precision) and own.num_true == 0 and own.precision == 0.0
