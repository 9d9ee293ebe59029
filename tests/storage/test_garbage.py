"""Garbage is collected rarely within a block, as before behind it."""

import gc

import numpy as np
import pytest

from semloc_jax.maps import MapElement, SemanticMap, read_map, write_map
from semloc_jax.storage import rare_collection
from semloc_jax.structs import ElementClass


@pytest.fixture
def usual():
    before = gc.get_threshold()
    gc.set_threshold(700, 10, 10)
    yield gc.get_threshold()
    gc.set_threshold(*before)


def test_the_usual_rate_comes_back_even_after_an_error(usual):
    with pytest.raises(ValueError, match="broken"), rare_collection():
        assert gc.get_threshold() > usual
        raise ValueError("broken")
    assert gc.get_threshold() == usual


def test_a_map_is_read_with_few_collections(usual, tmp_path):
    """2,000 elements at the usual rate would be nine collections."""
    posts = (np.array([[k, 1.0, 0.0], [k, 1.0, 3.0]]) for k in range(2000))
    poles = tuple(MapElement(f"pole {k}", ElementClass.POLE, post) for k, post in enumerate(posts))
    write_map(SemanticMap(poles), tmp_path / "map.geojson")
    seen = []

    def count(phase, _):
        seen.append(phase)

    gc.callbacks.append(count)
    semantic_map = read_map(tmp_path / "map.geojson")
    gc.callbacks.remove(count)
    assert semantic_map.num_elements == 2000
    assert seen.count("start") < 5
