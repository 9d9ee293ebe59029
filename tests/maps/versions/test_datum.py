"""The frame of a map moves, its elements stay as they were published: every bit comes back, and steps are small."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.maps.versions.datum import CELL_MM, NODE_MM, STILL, Datum
from semloc_jax.maps.versions.difference import applied, difference
from semloc_jax.maps.versions.sdiff import SdiffFile, sdiff_bytes
from semloc_jax.maps.versions.state import MapState, read_state, write_state
from tests.maps.versions.made_maps import road


def bent(seed: int = 0, turn: float = 1e-3, scale: float = 1e-3, wide: bool = False) -> Datum:
    """A map that was turned, stretched, lifted and bent, as more drives do it."""
    random = np.random.default_rng(seed)
    found = {}
    for a in range(-3, 30):
        for b in (-3, -2, -1, 0, 1, 2, 3) if wide else (-1, 0, 1):
            x, y = a * NODE_MM, b * NODE_MM
            wobble = random.integers(-6, 7, 3) * 5
            shift = np.array([scale * x - turn * y - 700.0, turn * x + scale * y + 400.0, 1e-3 * x])
            found[a, b] = tuple((5 * np.rint(shift / 5.0) + wobble).astype(int).tolist())
    return Datum(found)


def test_published_points_come_back_to_the_bit():
    """Wherever they lie, and however the map is turned, stretched or pressed."""
    random = np.random.default_rng(1)
    points = random.integers([-30_000, -30_000, -600], [360_000, 30_000, 600], (20_000, 3)) * CELL_MM / 1000.0
    for seed, turn, scale in ((0, 1e-3, 1e-3), (1, -2e-3, -2e-3), (2, 0.0, 5e-3)):
        datum = bent(seed, turn, scale, wide=True)
        now = datum.moved(points)
        assert np.abs(now - points).max() > 0.5
        assert datum.back(now).tobytes() == points.tobytes()
    assert datum.back(now + 0.001) is None and datum.back(now / 3.0) is None
    assert STILL.moved(points).tobytes() == points.tobytes()


def test_shifts_are_those_of_the_nodes_and_weighted_between_them():
    datum = Datum({(0, 0): (0, 10, 0), (1, 0): (100, 10, -8)})
    at = np.array([[0, 0, 0], [NODE_MM, 0, 0], [NODE_MM // 2, 0, 0], [NODE_MM // 4, NODE_MM // 2, 0], [-NODE_MM, 0, 0]])
    assert datum.shift_mm(at).tolist() == [[0, 10, 0], [100, 10, -8], [50, 10, -4], [13, 5, -1], [0, 0, 0]]


def test_a_map_that_moves_as_a_whole_is_a_step_of_few_bytes(tmp_path):
    """200 elements, none of which is named; the other way round as well, and between two frames that both moved."""
    still = MapState(road(200), 3, 9)
    points = [(e, bent(k).moved(e.points)) for k in (0, 1) for e in still.map.elements]
    once, twice = (
        MapState(still.map.with_elements([e.with_points(p) for e, p in part]), 4 + k, 10 + k, bent(k))
        for k, part in enumerate((points[:200], points[200:]))
    )
    for base, target, most in ((still, once, 450), (once, twice, 400), (twice, still, 120)):
        step = difference(base, target)
        assert not (step.added or step.modified or step.removed)
        content = sdiff_bytes(step, base)
        assert len(content) < most
        write_state(base, tmp_path / "a.gpkg")
        write_state(target, tmp_path / "b.gpkg")
        held = read_state(tmp_path / "a.gpkg")
        assert held.digest == base.digest and held.datum == base.datum
        write_state(applied(held, SdiffFile(content, "d").on(held)), tmp_path / "again.gpkg")
        assert (tmp_path / "again.gpkg").read_bytes() == (tmp_path / "b.gpkg").read_bytes()
    assert still.tiles.values() != once.tiles.values() or still.tiles == once.tiles
    assert still.content != once.content != twice.content


def test_what_was_never_published_stands_where_it_is():
    """Whole millimetres that are no cells, and numbers that are no millimetres."""
    odd = [e.with_points(e.points + [0.0, 0.001 * (k % 4), 1e-5 * (k % 3)]) for k, e in enumerate(road(12).elements)]
    base = MapState(road(12).with_elements(odd), 2, 5, bent(3))
    target = replace(base, version=3, datum=bent(4))
    again = applied(base, SdiffFile(sdiff_bytes(difference(base, target), base), "d").on(base))
    assert again.digest == target.digest
    assert all((a.points == b.points).all() for a, b in zip(again.map.elements, odd, strict=True))


@pytest.mark.parametrize("columns", [[[0], [0], [1.5], [0], [0]], [[0], [0]], [[0], [0], [10**9], [0], [0]], 7])
def test_junk_is_no_datum(columns):
    with pytest.raises((TypeError, ValueError)):
        Datum.from_json(columns)
