"""Beliefs of a map survive its files, and a map of today opens with beliefs."""

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.maps import Belief, BeliefMap, GeoOrigin, MapElement, SemanticMap, read_map, write_map
from semloc_jax.maps.losses import compare
from semloc_jax.structs import ElementClass

DASH = MapElement("dash", ElementClass.LANE_MARKING, [[0, 0, 0.1], [3, 0, 0.1]], width_m=0.15, style="dashed")
BAR = MapElement("bar", ElementClass.CROSSWALK, [[5, 0, 0], [8, 0, 0], [8, 0.5, 0], [5, 0.5, 0]], closed=True)
POLE = MapElement("pole", ElementClass.POLE, [[9, 4, 0], [9, 4, 6]], radius_m=0.1, attributes={"kind": "lamp_post"})


def belief_map(origin=None):
    beliefs = {
        "dash": Belief(0.0123456789012345, 0.03, 3.25, 17, 2, 0.5, 12.25, "drive a"),
        "bar": Belief(1 / 3, 0.1, -1.5, 3, 40, provenance="drive a"),
        "pole": Belief(0.07, 0.07, 2.0, 9),
    }
    return BeliefMap(SemanticMap((DASH, BAR, POLE), origin, "made"), beliefs)


@pytest.mark.parametrize("suffix", [".gpkg", ".geojson"])
@pytest.mark.parametrize("origin", [None, GeoOrigin(48.1, 11.5, 500.0)])
def test_a_file_keeps_every_belief(tmp_path, suffix, origin):
    before = belief_map(origin)
    write_map(before.as_map(), tmp_path / f"map{suffix}")
    stored = read_map(tmp_path / f"map{suffix}")
    after = BeliefMap.of(stored)
    assert dict(after.beliefs) == dict(before.beliefs)
    assert compare(before.as_map(), stored).is_lossless
    assert all("sigma_across_m" not in element.attributes for element in after.map.elements)


def test_a_belief_map_is_searched_like_any_map(tmp_path):
    write_map(belief_map().as_map(), tmp_path / "map.gpkg")
    found = read_map(tmp_path / "map.gpkg").query((0.0, 0.0), 4.0)
    assert [element.id for element in found.elements] == ["dash"]


def test_a_map_of_today_opens_with_the_sigma_asked_for():
    opened = BeliefMap.of(SemanticMap((DASH, POLE), name="town"), map_sigma_m=0.2)
    assert opened.beliefs["pole"].sigma_across_m == 0.2
    assert opened.beliefs["pole"].provenance == "town"
    assert opened.beliefs["pole"].existence == pytest.approx(0.9975, abs=1e-4)
    np.testing.assert_allclose(opened.beliefs["dash"].information, 25.0 * np.eye(2))
    assert opened.map.elements[1].attributes == {"kind": "lamp_post"}


def test_every_element_has_exactly_one_belief():
    with pytest.raises(SemlocError, match="1 beliefs for 2 elements, none for 'pole'"):
        BeliefMap(SemanticMap((DASH, POLE)), {"dash": Belief(0.1, 0.1, 0.0)})


@pytest.mark.parametrize("bad", [{"sigma_across_m": 0.0}, {"num_seen": -1}, {"existence_logit": "much"}])
def test_a_belief_that_cannot_be_meant_is_refused(bad):
    good = {"sigma_across_m": 0.1, "sigma_along_m": 0.1, "existence_logit": 1.0, "num_seen": 1, "num_missed": 0}
    element = MapElement("odd", "pole", POLE.points, attributes=good | bad)
    with pytest.raises(SemlocError, match="map element 'odd': its belief cannot be read"):
        BeliefMap.of(SemanticMap((element,)))
