"""Half of a dash is half of a dash, wherever a drive saw its ends."""

from dataclasses import replace

import numpy as np

from semloc_jax.mapping.crowd.fragments import are_fragments
from semloc_jax.mapping.crowd.fusion import fused
from semloc_jax.mapping.crowd.shapes import are_placed
from semloc_jax.mapping.crowd.sights import sights_of
from tests.mapping.crowd_world import DriveNoise, Road, drive

EXACT = DriveNoise(detected=1.0, phantoms=0.0)


def row(*lengths_m, kind="dash"):
    n = len(lengths_m)
    centre = np.column_stack([9.0 * np.arange(n), np.zeros(n)])
    half_m = 0.5 * np.column_stack([lengths_m, np.full(n, 0.15)])
    return are_fragments(np.array([kind] * n, dtype=object), centre, np.tile([1.0, 0.0], (n, 1)), half_m).tolist()


def test_what_is_shorter_than_a_length_that_others_share_is_a_part():
    assert row(4.0, 3.9, 4.05, 2.4, 4.0) == [False, False, False, True, False]
    assert row(4.0, 1.5, 4.0, 1.52, 4.0, 1.49) == [False] * 6  # two rows of paint
    assert row(4.0, 2.4) == [False] * 2 and row() == [] and row(4.0, 4.0, 4.0, 2.4, kind="arrow") == [False] * 4
    assert row(4.0, 4.0, 4.0, 3.75) == [False] * 4  # masks are no sharper


def worn(road, *names):
    """The road with dashes of which the second half has worn off."""
    cut = [
        replace(e, points=np.vstack([e.points[0], e.points.mean(axis=0)])) if e.id in names else e
        for e in road.elements
    ]
    return replace(road, elements=tuple(cut))


def test_a_part_is_of_what_another_drive_sees_whole_and_alone_it_is_not_placed():
    road = Road.of(120.0)
    drives = [drive(worn(road, "dash_3", "dash_7"), 0, EXACT), drive(worn(road, "dash_7"), 1, EXACT)]
    found = fused([sights_of(d, None) for d in drives])
    placed, is_dash = are_placed(found), found.world.kind == "dash"
    num = sum(e.style == "dashed" for e in road.elements)
    assert is_dash.sum() == num and placed[is_dash].sum() == num - 1 and placed[~is_dash].all()
    unplaced = found.world.half_m[~placed]
    assert unplaced.shape == (1, 2) and abs(2.0 * unplaced[0, 0] - 1.5) < 0.05


def test_what_three_drives_show_as_short_as_each_other_is_short_and_what_they_cut_off_differently_is_not():
    """A dash of 1.5 m among such of 3 m, and one of which each drive sees another part."""
    road, drives = Road.of(120.0), []
    for k, share in enumerate((0.45, 0.6, 0.75)):
        cut = []
        for e in worn(road, "dash_5").elements:
            end = e.points[0] + share * (e.points[-1] - e.points[0])
            cut.append(replace(e, points=np.vstack([e.points[0], end])) if e.id == "dash_8" else e)
        drives.append(drive(replace(road, elements=tuple(cut)), k, EXACT))
    found = fused([sights_of(d, None) for d in drives])
    placed, is_dash = are_placed(found), found.world.kind == "dash"
    short = is_dash & (found.world.half_m[:, 0] < 1.2)
    assert placed[is_dash & ~short].all() and placed[short].sum() == 1
    assert abs(found.world.half_m[short & placed][0, 0] - 0.75) < 0.05
    two = fused([sights_of(d, None) for d in drives[:2]])
    assert not are_placed(two)[(two.world.kind == "dash") & (two.world.half_m[:, 0] < 1.2)].any()
