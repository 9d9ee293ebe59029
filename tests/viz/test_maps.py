"""A map from above shows its posts too: from there they are points."""

import numpy as np

from semloc_jax.maps import Belief, MapElement
from semloc_jax.viz import maps_over_each_other, sigmas_from_above


def elements():
    pole = MapElement("pole", "pole", np.array([[3.0, 4.0, 0.0], [3.0, 4.0, 5.0]]), radius_m=0.1)
    dash = MapElement(
        "dash", "lane_marking", np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]]), width_m=0.15, style="dashed"
    )
    return [pole, dash]


def posts_in(figure):
    found = [np.asarray(part.get_offsets()) for part in figure.axes[0].collections]
    return [offsets.tolist() for offsets in found if offsets.shape[0] and offsets.any()]


def test_a_pole_is_a_ring_in_both_pictures():
    beliefs = {element.id: Belief(0.05, 0.05, 3.0) for element in elements()}
    assert posts_in(sigmas_from_above(elements(), beliefs, np.eye(4)[None])) == [[[3.0, 4.0]]]
    assert posts_in(maps_over_each_other(elements(), elements())) == [[[3.0, 4.0]], [[3.0, 4.0]]]
    assert posts_in(sigmas_from_above(elements()[1:], beliefs, np.eye(4)[None])) == []
