"""map_changes.csv: where a drive contradicts its map, by stretches of the way and by elements (room: reports; host).

In: the table of a run, what it holds of the elements of the map. Out: rows, stretches first.
Lines that were painted anew and posts that were set up anew move a pose together, element by element nothing is
missed: only kinds of elements that contradict each other show it, over a stretch of the way.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from semloc_jax.localization.map_faults import TrustConfig, map_changes
from semloc_jax.localization.track_state import ElementTrust
from semloc_jax.maps import SemanticMap
from semloc_jax.reports.tables import write_csv
from semloc_jax.reports.track_log import TrackTable

FILE = "map_changes.csv"
_GAP_M = 10.0
"""Doubts with less way between them are one stretch. Ours: what is in view at once."""


@dataclass(frozen=True)
class MapChangeRow:
    """One stretch or one element; what is not known of it is None.

    Attributes:
        what: stretch or element.
        name: id of the element.
        label: class of the element; lines or posts for a stretch.
        from_way_m, to_way_m: driven way at its begin and its end.
        from_x_m, from_y_m, to_x_m, to_y_m: place in the map: of the vehicle for a stretch, of its ends for an element.
        ahead_m, left_m: where these elements fit, taken alone, as seen from the vehicle; the largest on the way.
        nats: what speaks for it.
        missed_share: share of the element that lies on no border.
        num_frames: frames that say so.
        weight: what the element still counts.
    """

    what: str
    name: str
    label: str
    from_way_m: float
    to_way_m: float
    from_x_m: float
    from_y_m: float
    to_x_m: float
    to_y_m: float
    ahead_m: float | None = None
    left_m: float | None = None
    nats: float | None = None
    missed_share: float | None = None
    num_frames: int | None = None
    weight: float | None = None


def write_map_changes(
    folder: Path, table: TrackTable, trust: ElementTrust, semantic_map: SemanticMap, config: TrustConfig
) -> None:
    """Write map_changes.csv."""
    rows = [*stretches(table), *elements(table, trust, semantic_map, config)]
    columns = [field.name for field in fields(MapChangeRow)]
    write_csv(folder / FILE, columns, ([_cell(getattr(row, name)) for name in columns] for row in rows))


def stretches(table: TrackTable) -> Iterator[MapChangeRow]:
    """Every stretch of the way on which one kind of elements, taken alone, fits elsewhere, in the order driven.

    What speaks for it is remembered for some tens of frames: a stretch ends late.
    """
    xy, way_m = _way(table)
    for kind in dict.fromkeys(filter(None, table.moved)):
        rows = np.array([k for k, name in enumerate(table.moved) if name == kind and table.has_pose[k]], dtype=int)
        for part in np.split(rows, np.flatnonzero(np.diff(way_m[rows]) > _GAP_M) + 1):
            if not len(part):
                continue
            most = part[int(np.argmax(table.columns["moved_nats"][part]))]
            ends = (part[0], part[-1])
            yield MapChangeRow(
                *("stretch", "", kind, *(float(way_m[k]) for k in ends), *(float(v) for k in ends for v in xy[k])),
                *(float(table.columns[key][most]) for key in ("moved_ahead_m", "moved_left_m", "moved_nats")),
                num_frames=len(part),
            )


def elements(
    table: TrackTable, trust: ElementTrust, semantic_map: SemanticMap, config: TrustConfig
) -> Iterator[MapChangeRow]:
    """Every element that lies on no border of its class, the clearest first."""
    xy, way_m = _way(table)
    known = table.has_pose
    for change in map_changes(trust, semantic_map, config):
        ends = semantic_map.element_at(change.row).points[[0, -1], :2]
        near = [int(np.argmin(np.hypot(*(xy[known] - end).T))) for end in ends] if known.any() else []
        passed = sorted(float(way_m[known][k]) for k in near) or [np.nan, np.nan]
        yield MapChangeRow(
            *("element", change.element_id, change.label, *passed, *(float(v) for end in ends for v in end)),
            missed_share=change.missed_share,
            num_frames=change.num_frames,
            weight=change.weight,
        )


def _way(table: TrackTable) -> tuple[np.ndarray, np.ndarray]:
    """Places in the map, float[n 2], and the way driven to them, float[n] [m]; frames without a pose stay behind."""
    xy = np.column_stack([table.columns["x_m"], table.columns["y_m"]])
    steps = np.hypot(*np.diff(xy[table.has_pose], axis=0).T)
    way_m = np.zeros(len(table))
    way_m[table.has_pose] = np.concatenate([[0.0], np.cumsum(steps)])[: table.has_pose.sum()]
    return xy, way_m


def _cell(value: object) -> object:
    if isinstance(value, float):
        return f"{value:.6g}" if np.isfinite(value) else ""
    return "" if value is None else value
