"""A map in cells is the map of one solve: each thing once, lines that meet, only what changed is solved again."""

import hashlib
import shutil
from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import compare_maps
from semloc_jax.mapping.crowd.cell_map import CellMap
from semloc_jax.mapping.crowd.cells import CELL_M, Cell, cell_of
from semloc_jax.mapping.crowd.kept_cells import KeptCells
from semloc_jax.mapping.crowd.ledger import Ledger
from semloc_jax.mapping.crowd.merged import MergeConfig
from semloc_jax.mapping.crowd.whole import Crew, merge_whole
from semloc_jax.maps import SemanticMap
from semloc_jax.maps.io.packed_drive import packed_bytes
from semloc_jax.maps.versions.records import record_of
from semloc_jax.maps.versions.state import MapState
from tests.mapping.crowd_world import DriveNoise, Road, drive

ROAD = Road.of(150.0)
ACROSS = np.array([0.5 * CELL_M - 70.0, 0.0, 0.0])
"""So moved, the middle of the road lies on the border of two cells."""
MOVED = [replace(e, points=e.points + ACROSS) for e in ROAD.elements]
SHORT = Road.of(45.0)
FEW = MergeConfig(block=2)


def moved_drive(k, road=ROAD, noise=None):
    made = drive(road, k, noise)
    return replace(made, place=made.place + np.append(ACROSS, 0.0))


def ledger(*drives, root=None):
    contents = [packed_bytes(each) for each in drives]
    return Ledger(root, {hashlib.sha256(c).hexdigest(): c for c in contents})


@pytest.fixture(scope="module")
def three():
    return ledger(*(moved_drive(k) for k in range(3)))


@pytest.fixture(scope="module")
def made(three):
    return merge_whole(three)


@pytest.fixture(scope="module")
def stored(three, made, tmp_path_factory):
    """The folder of that map with its cells, to be copied."""
    folder = tmp_path_factory.mktemp("stored")
    assert same(merge_whole(three, kept=KeptCells(folder / "m.gpkg")), made)
    return folder


def same(a, b):
    return [(e.id, record_of(e)) for e in a.beliefs.map.elements] == [
        (e.id, record_of(e)) for e in b.beliefs.map.elements
    ] and a.beliefs.beliefs == b.beliefs.beliefs


def test_each_thing_is_there_once_and_lines_meet_at_the_border(made):
    assert made.num_solved == 2 and not made.distrusted
    elements = made.beliefs.map.elements
    assert {cell_of(e) for e in elements} == {Cell(0, 0), Cell(1, 0)}
    theirs = compare_maps(elements, MOVED, "se2").classes
    assert not theirs["dash"].added and len(theirs["dash"].missing) <= 1  # the last dash was seen once
    assert theirs["line"].f1 > 0.98
    lines = [e for e in elements if e.style == "solid"]
    assert len(lines) == 4
    for side in (0, 1):  # the right line, the left line
        low, high = (
            sorted((e.points for e in lines if cell_of(e) == cell), key=lambda points: points[:, 1].mean())[side]
            for cell in (Cell(0, 0), Cell(1, 0))
        )
        assert 0.0 <= np.linalg.norm((low[-1] - high[0])[:2]) < 1.1  # the last station of one, the first of the other
        ahead = (low[-1] - low[-2])[:2] / np.linalg.norm((low[-1] - low[-2])[:2])
        step = (high[0] - low[-1])[:2]
        assert abs(ahead[0] * step[1] - ahead[1] * step[0]) < 0.06


def test_a_cell_whose_drives_are_the_same_is_not_solved_again(three, made, stored, tmp_path):
    shutil.copytree(stored, tmp_path, dirs_exist_ok=True)
    assert merge_whole(three, kept=KeptCells(tmp_path / "m.gpkg")).num_solved == 0
    more = Ledger(None, three.drives | ledger(moved_drive(7, SHORT)).drives)
    again = KeptCells(tmp_path / "m.gpkg")
    after = merge_whole(more, kept=again)
    assert after.num_solved == 1  # it ends before the border
    fresh = merge_whole(more)
    assert same(after, fresh) and fresh.num_solved == 2
    right = [e for e in after.beliefs.map.elements if cell_of(e) == Cell(1, 0)]
    assert [record_of(e) for e in right] == [
        record_of(e) for e in made.beliefs.map.elements if cell_of(e) == Cell(1, 0)
    ]
    again.drop_others()
    assert len(list((tmp_path / "m.gpkg.history" / "cells").iterdir())) == 2


def test_a_damaged_cell_is_refused(three, stored, tmp_path):
    shutil.copytree(stored, tmp_path, dirs_exist_ok=True)
    for path in (tmp_path / "m.gpkg.history" / "cells").iterdir():
        path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(SemlocError, match="delete it"):
        merge_whole(three, kept=KeptCells(tmp_path / "m.gpkg"))
    with pytest.raises(SemlocError, match="not what was written"):
        CellMap.from_bytes(b"junk", "cell 0,0")


@pytest.mark.slow
def test_blocks_in_time_make_one_map_that_keeps_its_ids(tmp_path):
    """The cost of a drive is that of its block; the map goes on to be better."""
    drives = [replace(drive(ROAD, k), when_s=3.6e6 * k) for k in range(6)]
    config, kept = MergeConfig(block=3), KeptCells(tmp_path / "m.gpkg")
    first = merge_whole(ledger(*drives[:3]), config, kept=kept)
    blocks = merge_whole(ledger(*drives), config, kept=kept)
    bias = np.mean([np.random.default_rng([0, k]).normal(0.0, 1.0, 2) for k in range(6)], axis=0)
    theirs = compare_maps(blocks.beliefs.map.elements, ROAD.elements, "se2")
    assert theirs.classes["dash"].f1 > 0.95 and not blocks.distrusted
    assert np.abs(shift_of(theirs, blocks) - bias).max() < 0.15
    names = {e.id for e in first.beliefs.map.elements}
    assert len(names & {e.id for e in blocks.beliefs.map.elements}) >= 0.95 * len(names)
    dashes = sum(e.style == "dashed" for e in ROAD.elements)
    assert blocks.rates["dash"].visible >= 5 * dashes  # the looks of both blocks count


def shift_of(comparison, made):
    """How far the middle of a map is off."""
    middle = np.array([e.points[:, :2].mean(axis=0) for e in made.beliefs.map.elements]).mean(axis=0)
    T = comparison.T_reference_made
    return middle - (T[:2, :2] @ middle + T[:2, 3])


def test_blocks_are_kept_and_any_order_makes_the_same_map(tmp_path):
    drives = [replace(drive(SHORT, k), when_s=3.6e6 * k) for k in range(4)]
    expected = merge_whole(ledger(*drives), FEW)
    for order in ((0, 1, 2, 3), (3, 0, 2, 1)):
        kept = KeptCells(tmp_path / f"m{order[0]}.gpkg")
        found = None
        for k in range(1, 5):
            found = merge_whole(ledger(*(drives[i] for i in order[:k])), FEW, kept=kept)
        assert same(found, expected)
    name = f"m{0}.gpkg.history"
    assert len(list((tmp_path / name / "cells").iterdir())) == 4  # one for each drive, as they came


def test_what_no_drive_passed_stays_to_the_bit():
    far = [replace(e, id=f"far_{e.id}", points=e.points + [2.0 * CELL_M, 0.0, 0.0]) for e in ROAD.elements]
    root = MapState(SemanticMap((*ROAD.elements, *far), None, "base"))
    made = merge_whole(ledger(*(drive(ROAD, k, DriveNoise(gnss_m=0.5)) for k in range(2)), root=root))
    found = {e.id: e for e in made.beliefs.map.elements}
    assert all(np.array_equal(found[e.id].points, e.points) for e in far)
    assert sum(name.startswith("far_") for name in found) == len(far)
    assert {e.id for e in ROAD.elements} <= found.keys()


@pytest.mark.slow
def test_any_number_of_workers_makes_the_same_map(three, made):
    assert same(merge_whole(three, crew=Crew(2)), made)
