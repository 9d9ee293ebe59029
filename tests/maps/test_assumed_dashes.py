"""Bars that a reader laid out are one line without ends; bars of a file stay bars."""

import numpy as np
import pytest

from semloc_jax.maps import MapElement, SemanticMap, sample
from semloc_jax.maps.assumed_dashes import joined_dashes
from semloc_jax.structs import ElementClass


def bar(name, start_m, y_m=0.0, assumed=("dashes",), length_m=3.0):
    points = np.array([[start_m, y_m, 0.0], [start_m + length_m, y_m, 0.0]])
    attributes = {"assumed": list(assumed)} if assumed else {}
    return MapElement(
        name,
        ElementClass.LANE_MARKING,
        points,
        width_m=0.12,
        style="dashed",
        true_ends=(False, False),
        attributes=attributes,
    )


def test_the_bars_of_a_line_become_one_line_without_ends():
    line = joined_dashes([bar(f"r1_{k}", 9.0 * k) for k in range(5)])
    assert [element.id for element in line] == ["r1_0"]
    assert line[0].true_ends == (False, False)
    assert line[0].length_m == pytest.approx(39.0)


def test_lines_gaps_and_known_bars_stay_apart():
    elements = [
        bar("r1_0", 0.0),
        bar("r1_1", 9.0),
        bar("r2_0", 0.0, y_m=3.5),
        bar("known_0", 0.0, y_m=7.0, assumed=()),
        bar("known_1", 9.0, y_m=7.0, assumed=("width",)),
        bar("r3_0", 0.0, y_m=10.5),
        bar("r3_1", 60.0, y_m=10.5),
    ]
    assert [e.id for e in joined_dashes(elements)] == ["r1_0", "r2_0", "known_0", "known_1", "r3_0", "r3_1"]


def test_no_bars_no_change():
    assert joined_dashes([]) == []


def test_samples_of_a_queried_map_do_not_know_the_phase():
    """Bars shifted by half a period give the same samples along the line, away from its ends."""
    along = []
    for phase_m in (0.0, 4.5):
        bars = tuple(bar(f"r1_{k}", 9.0 * k - 90.0 + phase_m) for k in range(21))
        local = SemanticMap(bars).query([0.0, 0.0], 40.0)
        samples = sample(local, 0.25)
        x = np.asarray(samples.p_map)[np.asarray(samples.valid), 0] + local.origin_map[0]
        along.append(np.histogram(x, bins=np.arange(-30.0, 31.0, 1.0))[0])
    assert (along[0] > 0).all()
    assert np.abs(along[0] - along[1]).max() <= 2
