"""Groups of points: the numbers of all groups at once are those of each group alone."""

import numpy as np
import pytest

from semloc_jax.perception.point_groups import PointGroups, extremes

SIZES = (1, 2, 7, 30, 4)


@pytest.fixture
def points():
    rng = np.random.default_rng(0)
    values = np.round(rng.normal(size=sum(SIZES)), 1)  # with ties
    return PointGroups(SIZES), values, np.split(values, np.cumsum(SIZES)[:-1])


def test_sums_and_extremes(points):
    groups, values, parts = points
    np.testing.assert_allclose(groups.total(values), [part.sum() for part in parts])
    np.testing.assert_allclose(
        groups.mean(np.stack([values, -values], axis=-1))[:, 1], [-part.mean() for part in parts]
    )
    assert groups.least(values).tolist() == [part.min() for part in parts]
    assert groups.most(values).tolist() == [part.max() for part in parts]
    assert groups.rank.tolist() == [i for size in SIZES for i in range(size)]


def test_medians_and_quantiles(points):
    groups, values, parts = points
    everywhere = np.ones(len(values), bool)
    assert groups.median(values, everywhere).tolist() == [np.median(part) for part in parts]
    expected = [[np.quantile(part, share) for part in parts] for share in (0.05, 0.7)]
    np.testing.assert_allclose(groups.quantiles(values, 0.05, 0.7), expected, atol=1e-12)


def test_the_median_of_some_points_is_infinite_where_none_counts(points):
    groups, values, parts = points
    some = (groups.rank % 2 == 1) & (groups.number != 2)
    expected = [np.median(part[1::2]) if len(part) > 1 and i != 2 else np.inf for i, part in enumerate(parts)]
    assert groups.median(values, some).tolist() == expected


def test_extremes_of_points_in_any_order(points):
    groups, values, parts = points
    order = np.random.default_rng(1).permutation(len(values))
    least, most = extremes(values[order], groups.number[order])
    assert list(zip(least, most, strict=True)) == [(part.min(), part.max()) for part in parts]
    assert [len(side) for side in extremes(np.zeros(0), np.zeros(0, int))] == [0, 0]
