"""Small masks get more pixels: nothing moves, and what knows its borders itself stays as it is."""

import numpy as np

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.cameras.other_lenses import longer
from semloc_jax.perception.border_mask import BorderMask, SeenBorders
from semloc_jax.perception.finer_masks import finer, times_finer
from semloc_jax.simulation.cameras import front_rig


def test_only_small_masks_are_made_finer():
    assert [times_finer([shape]) for shape in ((120, 400), (250, 400), (300, 480), (600, 960))] == [2, 2, 1, 1]
    # Masks of one frame have one scale: that of the largest.
    assert times_finer([(120, 400), (600, 960)]) == 1


def test_a_pixel_stays_where_it_is():
    mask = np.arange(120 * 400, dtype=np.uint64).reshape(120, 400).astype(np.uint8)
    (drawn,) = finer([mask])
    camera = PinholeCamera(232.0, 233.0, 196.3, 54.1, 400, 120)
    rig = Rig([camera], np.eye(4)[None], ["front"]).with_pixels(2)
    p_cam = np.random.default_rng(0).normal((0.0, 0.5, 12.0), (3.0, 1.0, 3.0), (200, 3))
    before, after = (np.asarray(c.project(p_cam)[0]) for c in (camera, rig.cameras[0]))
    inside = (before > 0.0).all(axis=1) & (before < [398.0, 118.0]).all(axis=1)
    (u, v), (u2, v2) = (np.rint(uv[inside]).astype(int).T for uv in (before, after))
    # At most one pixel of the finer mask from the border of one of the others.
    near = np.abs((before[inside] + 0.5) % 1.0 - 0.5).max(axis=1) > 0.49
    assert inside.sum() > 100 and np.array_equal(mask[v, u][~near], drawn[v2, u2][~near])


def test_borders_that_a_network_tells_stay_as_they_are():
    borders = SeenBorders(np.zeros((1, 30, 100)), np.ones((1, 30, 100)), 4.0, ("lane_marking",), 40.0)
    mask = BorderMask.of(np.zeros((120, 400), np.uint8), borders)
    assert finer([mask])[0] is mask


def test_a_rig_remembers_its_own_pixels():
    rig = front_rig(400, 250).with_pixels(2)
    for changed in (rig.select(["front"]), longer(rig, 0.02), rig.with_places(np.eye(4)[None])):
        assert changed.finer == 2 and changed.cameras[0].resolution == (800, 500)
