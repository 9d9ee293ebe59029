"""Random streets and garages: what views of them hold."""

from itertools import pairwise

import numpy as np
import pytest

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.simulation.looks.materials import CLASS_MASK, DARK_PATCH, TAR, variant_id
from semloc_jax.simulation.streets.hall import random_hall
from semloc_jax.simulation.streets.street import random_street
from semloc_jax.simulation.streets.views import FINER, _pinhole, street_views


@pytest.mark.parametrize("is_garage", [False, True])
def test_views_follow_from_their_seed(is_garage):
    one, again = (street_views(np.random.default_rng(2), 1, (96, 64), 2, is_garage)[0] for _ in range(2))
    assert one.class_id.shape == (FINER * 64, FINER * 96) and one.class_id.max() <= CLASS_MASK
    assert len(one.pictures) == 2 and all(picture.shape == (64, 96, 3) for picture in one.pictures)
    np.testing.assert_array_equal(one.class_id, again.class_id)
    np.testing.assert_array_equal(one.pictures[1], again.pictures[1])
    assert np.abs(one.pictures[0].astype(float) - one.pictures[1]).mean() > 1.0


def test_streets_show_what_is_to_be_learned():
    """Posts, signs and vehicles stand there, lines and dashes of several paints are on the ground."""
    standing, painted = set(), set()
    for seed in range(3):
        street = random_street(np.random.default_rng(seed))
        standing |= {solid.class_id & CLASS_MASK for solid in street.solids}
        s, d = np.meshgrid(np.arange(0.0, 60.0, 0.05), np.arange(-8.0, 12.0, 0.05))
        painted |= set(np.unique(street.ground.class_at(street.path.at(s.ravel(), d.ravel()))).tolist())
    assert {CLASS_IDS[name] for name in ("pole", "sign", "vehicle", "vegetation")} <= standing
    assert {CLASS_IDS["lane_solid"], CLASS_IDS["lane_dashed"]} <= {kind & CLASS_MASK for kind in painted}
    assert {variant_id("road", kind) for kind in (DARK_PATCH, TAR)} & painted


def test_halls_show_what_is_to_be_learned():
    """Pillars and cars stand there, slots are painted, and the own path is free of all that stands."""
    hall = random_hall(np.random.default_rng(0))
    standing = {solid.class_id & CLASS_MASK for solid in hall.solids}
    s, d = np.meshgrid(np.arange(0.0, 12.0, 0.3), np.arange(-6.0, 6.0, 0.05))
    kinds = np.unique(hall.ground.class_at(hall.path.at(s.ravel(), d.ravel())))
    painted = {kind & CLASS_MASK for kind in kinds.tolist()}
    way = hall.surface.drape(hall.path.at(np.arange(0.0, 30.0, 3.0), 0.0)) + [0.0, 0.0, 1.0]
    for start, end in pairwise(way):
        length = np.linalg.norm(end - start)
        assert all(solid.hit(start, (end - start)[None] / length)[0] > length for solid in hall.solids)
    assert {CLASS_IDS[name] for name in ("pillar", "vehicle", "wall")} <= standing
    assert CLASS_IDS["slot_line"] in painted


def test_a_part_of_the_cameras_looks_aside_and_back():
    """As those around a vehicle do: a tenth more than 90 degrees away from ahead; most look ahead."""
    rng = np.random.default_rng(0)
    ahead = np.array([_pinhole(rng, (64, 64), 1)[1][0, 2] for _ in range(400)])
    assert 0.08 < np.mean(ahead < 0.0) < 0.22 and np.mean(ahead > 0.9) > 0.65


def test_signs_of_halls_hang_and_stand():
    """Some below the ceiling, some as high as a camera looks: above the floor by 0.4 to 2.2 m."""
    heights = []
    for seed in range(3):
        hall = random_hall(np.random.default_rng(seed))
        for solid in hall.solids:
            if solid.class_id & CLASS_MASK == CLASS_IDS["sign"]:
                middle = solid.outline.mean(axis=0)
                heights.append(middle[2] - float(hall.surface.height(*middle[:2, None])[0]))
    assert np.mean(np.array(heights) < 2.1) > 0.3 and np.mean(np.array(heights) > 2.1) > 0.2
