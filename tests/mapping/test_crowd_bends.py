"""A drive whose gyroscope is off bends its whole way; the others say so, and a world that has changed does not."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.evaluation import compare_maps
from semloc_jax.mapping.crowd import bends
from semloc_jax.mapping.crowd.correction import Correction
from semloc_jax.mapping.crowd.merged import merged
from semloc_jax.mapping.crowd.sights import sights_of
from tests.mapping.crowd_world import DriveNoise, Road, drive

ROAD = Road.of(300.0)
CURLS = 1e-4 * np.array([-4.1, 1.0, 2.7, 1.9, -3.4])
"""By how much the headings of five drives go in ten metres: about what the drives of crowd_seed3 do."""
BENT = 9e-4


def crowd(*curls, road=ROAD):
    return [drive(road, k, DriveNoise(bend_rad=3e-4, curl_rad=c, detected=0.7)) for k, c in enumerate(curls)]


def aside_m(found):
    """How far dashes and lines lie off across, after one motion in the plane."""
    classes = compare_maps(found.beliefs.map.elements, ROAD.elements, "se2").classes
    return [float(np.sqrt(np.mean(classes[kind].across_m ** 2))) for kind in ("dash", "line")]


def test_one_bent_drive_of_six_is_found_and_the_map_hardly_bends_with_it(monkeypatch):
    six = crowd(*CURLS, BENT)
    found = merged(None, six)
    bent = [each.bent for each in found.fused.drives]
    assert bent[:-1] == [1.0] * 5 and bent[-1] > 2.0 and not found.distrusted
    monkeypatch.setattr(bends, "_MOST", 1.0)
    before = merged(None, six)
    # Of the heading that it has too much, a sixth would be in the map: 3 cm at the ends.
    assert aside_m(found)[1] < 0.7 * aside_m(before)[1] and aside_m(found)[0] < 0.9 * aside_m(before)[0]


def test_a_world_that_has_changed_bends_no_drive():
    """One drive that comes after works: dashes of 60 m lie 0.6 m farther, poles and dashes are gone."""
    changed = ROAD.without("pole_1", "pole_3", "pole_8", "dash_15", "dash_16", "dash_17")
    for k in range(6, 13):
        changed = changed.shifted(f"dash_{k}", 0.6)
    after = replace(crowd(*CURLS, 3e-4, road=changed)[-1], name="after")
    found = merged(None, [*crowd(*CURLS), after])
    assert [each.bent for each in found.fused.drives] == [1.0] * 6


@pytest.mark.parametrize(
    ("turns_deg", "bent"),
    [((0.1, 0.15, 0.2, 0.2, 0.25), [1.0] * 5), ((0.1, 0.15, 0.2, 0.2, 2.0), [1, 1, 1, 1, 4]), ((0.1, 2.0), [1, 1])],
)
def test_what_is_bent_as_the_others_are_is_no_exception_and_two_drives_do_not_say_which(turns_deg, bent):
    """Headings that go by so much over a whole way."""
    packed = drive(Road.of(70.0), 0)
    drives = [Correction(sights_of(packed, None)) for _ in turns_deg]
    for each, turn_deg in zip(drives, turns_deg, strict=True):
        each.value[6::3] = np.radians(np.linspace(0.0, turn_deg, each.num_nodes))
    bends.judge_bends(drives)
    assert [each.bent for each in drives] == bent
