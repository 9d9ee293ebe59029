"""One cell merged from nothing but bytes: what a worker does (room: mapping; host).

In: CellTask: packed drives in the order of time, what lies there before. Out: bytes of CellMaps.
Drives are merged in blocks in the order of time; what a block made is the base of the next. So a cell with many drives
costs what its last block costs: those before it come from the task, ready made.
"""

from dataclasses import dataclass

from semloc_jax.mapping.crowd.cell_map import CellMap
from semloc_jax.mapping.crowd.cells import Cell, clipped
from semloc_jax.mapping.crowd.fusion import Progress
from semloc_jax.mapping.crowd.merged import MergeConfig, map_of, merged_sights
from semloc_jax.mapping.crowd.sights import Base, base_sights, sights_of
from semloc_jax.maps import GeoOrigin
from semloc_jax.maps.io.packed_drive import unpacked

_LEAST_THINGS = 4
"""A drive with fewer things in a cell and its halo cannot be laid onto others there."""


@dataclass(frozen=True)
class CellTask:
    """A cell to merge; all of it can be sent to another process.

    Attributes:
        cell: which one.
        origin: place of the map on the earth.
        base: what lies there before the first block; None where nothing does.
        made: the map that the blocks before made; None where `blocks` begins with the first.
        blocks: files of packed drives in the order of time, by block.
        config: how drives are merged.
    """

    cell: Cell
    origin: GeoOrigin | None
    base: Base | None
    made: bytes | None
    blocks: tuple[tuple[bytes, ...], ...]
    config: MergeConfig


def merge_cell(task: CellTask, progress: Progress = lambda items, _: items) -> list[bytes]:
    """The map of the cell and its halo after each block.

    Raises:
        SemlocError: a drive is damaged.
    """
    found: list[bytes] = []
    before = None if task.base is None else clipped(base_sights(task.base), task.cell)
    made = None if task.made is None else CellMap.from_bytes(task.made, f"cell {task.cell.name}")
    for block in task.blocks:
        if made is not None:
            before = base_sights(Base(map_of(made.known, None, None), made.sigma_place_m, made.num_drives))
        drives = [sights_of(unpacked(content, "drive"), task.origin) for content in block]
        here = [clipped(drive, task.cell) for drive in drives]
        here = [drive for drive in here if len(drive.things) >= _LEAST_THINGS] or here[:1]
        first = [before] if before is not None and (len(before.things) or before.lines) else []
        now = CellMap.of(merged_sights([*first, *here], task.config, progress))
        made = now if made is None else now.after(made)
        found.append(made.to_bytes())
    return found
