"""A map of any size, merged cell by cell (room: mapping; host).

In: all drives that were ever merged, a base map. Out: WholeMap. Cells whose drives are those of before are not solved
again: what they made is kept. A function of the set of drives: no order, grouping or number of workers changes a bit.
Without a survey the map that cars are told of follows from that of the first half of the drives, see `editions`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.mapping.crowd.cell_map import CellMap, DriveRow
from semloc_jax.mapping.crowd.cell_work import CellTask, merge_cell
from semloc_jax.mapping.crowd.cells import CELL_M, HALO_M, Cell, cell_of, cells_of
from semloc_jax.mapping.crowd.changes import CrowdChange
from semloc_jax.mapping.crowd.editions import Edition, next_edition, prefixes
from semloc_jax.mapping.crowd.fusion import Distrusted, Progress
from semloc_jax.mapping.crowd.joined import joined
from semloc_jax.mapping.crowd.kept_cells import KeptCells, name_of
from semloc_jax.mapping.crowd.ledger import Ledger
from semloc_jax.mapping.crowd.merged import MergeConfig, Rate, map_of, origin_of, summed_rates
from semloc_jax.mapping.crowd.sights import Base, sights_of
from semloc_jax.mapping.crowd.time_order import timed
from semloc_jax.maps import BeliefMap, GeoOrigin
from semloc_jax.maps.io.packed_drive import PackedDrive
from semloc_jax.maps.versions.datum import Datum
from semloc_jax.runtime.crew import spread


@dataclass(frozen=True)
class Crew:
    """Who works.

    Attributes:
        jobs: processes; 1 works in this one.
        on_ray: on a Ray cluster instead.
    """

    jobs: int = 1
    on_ray: bool = False


@dataclass(frozen=True)
class WholeMap:
    """The map of many drives.

    Attributes:
        beliefs: the map, as cars are told of it.
        datum: how its frame has moved since its elements were published.
        changes: what came, went and moved.
        distrusted: drives that disagree with the others, each once.
        rates: how well drives show what is there, by class.
        drives: how each drive lies in each cell.
        num_solved: cells that were solved; the others were kept.
    """

    beliefs: BeliefMap
    datum: Datum
    changes: tuple[CrowdChange, ...]
    distrusted: tuple[Distrusted, ...]
    rates: dict[str, Rate]
    drives: tuple[tuple[str, DriveRow], ...]
    num_solved: int

    @property
    def alone(self) -> list[str]:
        """Drives that pass no place that the base map or another drive knows."""
        held: dict[str, list[str]] = {}
        for cell, row in self.drives:
            held.setdefault(cell, []).append(row.drive)
        beside = {name for names in held.values() if len(names) > 1 for name in names}
        return sorted({names[0] for names in held.values()} - beside) if len(held) > 1 or beside else []

    @property
    def detected(self) -> dict[str, float]:
        """P_D by class."""
        return {kind: rate.detected for kind, rate in self.rates.items()}


class _Plan(NamedTuple):
    """A cell, its drives by block, and the name of what each block makes."""

    cell: Cell
    blocks: list[list[str]]
    names: list[str]


def merge_whole(
    ledger: Ledger,
    config: MergeConfig | None = None,
    crew: Crew | None = None,
    kept: KeptCells | None = None,
    progress: Progress = lambda items, _: items,
) -> WholeMap:
    """Merges all drives of a map, cell by cell.

    Args:
        ledger: the map before any drive, and all drives.
        config: None for the defaults.
        crew: who works; None for this process.
        kept: what cells made before; None for nothing.
        progress: shows how far it has come.

    Raises:
        SemlocError: no drive, none fits any other, nothing stays of them, or workers die.
    """
    config, crew, kept = config or MergeConfig(), crew or Crew(), kept or KeptCells(None)
    drives = timed(ledger.unpacked())
    if not drives:
        raise SemlocError("merge: no drives; give files of `semloc pack`")
    origin, edition, num_solved = origin_of(ledger.base, [drive for drive, _ in drives]), None, 0
    is_surveyed = ledger.base is not None and Base.of(ledger.base).is_surveyed
    for num in [len(drives)] if is_surveyed else prefixes(len(drives)):
        cells, solved = _cells_made(ledger, drives[:num], origin, config, crew, kept, progress)
        known = joined(cells, ledger.base)
        if not known:
            raise SemlocError(f"merge: nothing stays of {num} drives; do they show the same road?")
        # Under a survey a merge itself says no more than what has changed in meaning.
        sigma_m = float(np.median([made.sigma_place_m for made in cells.values()]))
        edition = Edition(tuple(known)) if is_surveyed else next_edition(edition, known, sigma_m)
        num_solved += solved
    return _whole(edition, ledger.base, origin, cells, num_solved)


def _cells_made(
    ledger: Ledger,
    drives: Sequence[tuple[PackedDrive, str]],
    origin: GeoOrigin | None,
    config: MergeConfig,
    crew: Crew,
    kept: KeptCells,
    progress: Progress,
) -> tuple[dict[Cell, CellMap], int]:
    """What some of the drives make of each cell, and how many cells were solved for it."""
    plans = {plan.cell.name: plan for plan in _plans(ledger, drives, origin, config)}
    made = {name: found for name, plan in plans.items() if (found := kept.get(plan.names[-1])) is not None}
    missing = [plan for name, plan in plans.items() if name not in made]
    tasks = ((plan.cell.name, _task(plan, ledger, origin, config, kept)) for plan in missing)
    for name, found in _worked(tasks, len(missing), crew, progress):
        done = len(plans[name].names) - len(found)
        for key, content in zip(plans[name].names[done:], found, strict=True):
            kept.put(key, content)
        made[name] = found[-1]
    cells = {plans[name].cell: CellMap.from_bytes(content, f"cell {name}") for name, content in made.items()}
    return {cell: cells[cell] for cell in sorted(cells)}, len(missing)


def _plans(
    ledger: Ledger, drives: Sequence[tuple[PackedDrive, str]], origin: GeoOrigin | None, config: MergeConfig
) -> Iterator[_Plan]:
    """The cells that any drive has anything in, and their drives in the order of time."""
    passed: dict[Cell, list[str]] = {}
    for drive, digest in drives:
        for cell in cells_of(sights_of(drive, origin)):
            passed.setdefault(cell, []).append(digest)
    root = None if ledger.root is None else ledger.root.digest
    for cell in sorted(passed):
        digests = passed[cell]
        blocks = [digests[k : k + config.block] for k in range(0, len(digests), config.block)]
        name, names = name_of(cell, root, origin, config), []
        for block in blocks:
            name = name_of(name, block)
            names.append(name)
        yield _Plan(cell, blocks, names)


def _task(plan: _Plan, ledger: Ledger, origin: GeoOrigin | None, config: MergeConfig, kept: KeptCells) -> CellTask:
    """What a worker needs: from the last block on that is kept."""
    before = [kept.get(name) for name in plan.names]
    first = max((k + 1 for k, content in enumerate(before) if content is not None), default=0)
    blocks = tuple(tuple(ledger.drives[digest] for digest in block) for block in plan.blocks[first:])
    base = None if ledger.base is None or first else _part(ledger.base, plan.cell)
    return CellTask(plan.cell, origin, base, before[first - 1] if first else None, blocks, config)


def _part(beliefs: BeliefMap, cell: Cell) -> Base | None:
    """What of a base map may lie in a cell and its halo."""
    low, high = cell.low - HALO_M, cell.low + CELL_M + HALO_M
    near = [
        e
        for e in beliefs.map.elements
        if not e.is_logical
        and (e.points[:, :2].max(axis=0) >= low).all()
        and (e.points[:, :2].min(axis=0) <= high).all()
    ]
    whole = Base.of(beliefs)
    held = BeliefMap(beliefs.map.with_elements(near), {e.id: beliefs.beliefs[e.id] for e in near})
    return replace(whole, beliefs=held) if near else None


def _worked(
    tasks: Iterator[tuple[str, CellTask]], num: int, crew: Crew, progress: Progress
) -> Iterator[tuple[str, list[bytes]]]:
    """What each cell makes; of a single one it is shown how far it has come."""
    if num == 1:
        name, task = next(tasks)
        yield name, merge_cell(task, progress)
        return
    results = spread(merge_cell, tasks, crew.jobs, crew.on_ray)
    for _ in progress(range(num), "cells"):
        yield next(results)


def _whole(
    edition: Edition, base: BeliefMap | None, origin: GeoOrigin | None, cells: dict[Cell, CellMap], num_solved: int
) -> WholeMap:
    """The edition, and the cells' own words put together."""
    changes = [change for cell, made in cells.items() for change in made.changes if cell_of(change.element) == cell]
    distrusted = {(d.name, d.reason): d for made in cells.values() for d in made.distrusted}
    rates: dict[str, Rate] = {}
    for made in cells.values():
        rates = summed_rates(rates, made.rates)
    rows = [(cell.name, row) for cell, made in cells.items() for row in made.drives]
    beliefs = map_of(edition.now, base, origin)
    return WholeMap(beliefs, edition.datum, tuple(changes), tuple(distrusted.values()), rates, tuple(rows), num_solved)
