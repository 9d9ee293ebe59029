"""Stretches and elements of a map that a drive contradicts: where they begin and end."""

import csv

import numpy as np
import pytest

from semloc_jax.localization.map_faults import TrustConfig, full_trust, updated
from semloc_jax.localization.track_state import TrackStatus
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.reports.map_changes import FILE, stretches, write_map_changes
from semloc_jax.reports.track_log import COLUMNS, TrackTable
from semloc_jax.structs import ElementClass

NUM = 60
LINE = np.array([[10.0, 2.0, 0.0], [30.0, 2.0, 0.0]])


def table(moved: dict[int, tuple[str, float, float, float]]) -> TrackTable:
    """A drive of one metre a frame along x; frame -> kind, ahead, left, nats."""
    columns = {name: np.full(NUM, np.nan) for name in COLUMNS}
    columns["x_m"], columns["y_m"] = np.arange(NUM, dtype=float), np.zeros(NUM)
    columns["x_m"][0] = np.nan  # not found yet
    for k, values in moved.items():
        for key, value in zip(("moved_ahead_m", "moved_left_m", "moved_nats"), values[1:], strict=True):
            columns[key][k] = value
    kinds = tuple(moved[k][0] if k in moved else "" for k in range(NUM))
    names = tuple(f"{k:06d}" for k in range(NUM))
    return TrackTable(names, ("",) * NUM, (TrackStatus.TRACKING,) * NUM, ("",) * NUM, kinds, columns)


def test_doubts_are_one_stretch_until_there_is_a_gap_in_them():
    moved = {k: ("lines", 0.0, 0.5, float(k)) for k in [*range(10, 21), *range(25, 28)]}
    moved |= {k: ("posts", 2.0, 0.0, 9.0) for k in range(50, 53)} | {k: ("lines", 0.0, -0.3, 4.0) for k in (45, 46)}
    found = list(stretches(table(moved)))
    told = [(row.label, row.from_x_m, row.to_x_m, row.left_m, row.ahead_m, row.num_frames) for row in found]
    assert told == [
        ("lines", 10.0, 27.0, 0.5, 0.0, 14),
        ("lines", 45.0, 46.0, -0.3, 0.0, 2),
        ("posts", 50.0, 52.0, 0.0, 2.0, 3),
    ]
    assert (found[0].from_way_m, found[0].to_way_m, found[0].nats) == (9.0, 26.0, 27.0)
    assert list(stretches(table({}))) == []


def test_an_element_is_listed_with_its_ends_and_where_the_drive_passed_them(tmp_path):
    semantic_map = SemanticMap((MapElement("kept", ElementClass.LANE_MARKING, LINE - [0.0, 4.0, 0.0]),
                                MapElement("gone", ElementClass.LANE_MARKING, LINE)))  # fmt: skip
    trust = full_trust(2)
    for _ in range(10):
        trust = updated(trust, np.full(2, 100.0), np.array([5.0, 95.0]), TrustConfig())
    write_map_changes(tmp_path, table({10: ("lines", 0.0, 0.5, 3.0)}), trust, semantic_map, TrustConfig())
    with (tmp_path / FILE).open(newline="", encoding="utf-8") as file:
        stretch, element = csv.DictReader(file)
    assert (stretch["what"], stretch["missed_share"], element["name"]) == ("stretch", "", "gone")
    assert [float(element[key]) for key in ("from_x_m", "to_x_m", "from_way_m", "to_way_m")] == [10.0, 30.0, 9.0, 29.0]
    assert float(element["missed_share"]) == pytest.approx(0.95) and element["ahead_m"] == ""
