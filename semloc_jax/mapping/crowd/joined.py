"""Cells side by side again (room: mapping; host).

In: maps of cells with their halos, the base where no drive came. Out: each element once, lines that meet at borders.
Of a thing near a border the cell that it lies in says what it is. Two cells place it a few centimetres apart: one that
both claim is the one of the first, one that neither claims is taken from the halo.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from semloc_jax.evaluation.map_shapes import is_line, kind_of
from semloc_jax.mapping.crowd.cell_map import CellMap
from semloc_jax.mapping.crowd.cells import Cell, cell_of, cells_of, cut, owned
from semloc_jax.mapping.crowd.elements import rounded
from semloc_jax.mapping.crowd.merged import Known
from semloc_jax.mapping.crowd.sights import Base, base_sights
from semloc_jax.maps import BeliefMap, MapElement
from semloc_jax.maps.versions.records import record_of

_SEAM_M = 1.0
"""Two cells never place one thing farther apart."""


def joined(cells: Mapping[Cell, CellMap], base: BeliefMap | None) -> list[Known]:
    """All elements of all cells, and of the base what lies in none of them."""
    whole, pieces = _whole_lines(cells, base)
    own: list[tuple[Cell, Known]] = []
    spare: list[tuple[Cell, Known]] = []
    lines: list[Known] = []
    for cell in sorted(cells):
        for element, belief in cells[cell].known:
            if (cell, element.id) in pieces:
                continue
            if is_line(element):
                parts = owned(element, cell)
                lines += [(part if part is element else rounded(part), belief) for part in parts]
            elif cell_of(element) == cell:
                own.append((cell, (element, belief)))
            elif cell.holds(_middle(element)[None], _SEAM_M)[0]:
                spare.append((cell, (element, belief)))
    rest = [] if base is None else _untouched(base, set(cells), whole)
    kept = {element.id for element, _ in rest}
    things = [item for _, item in _each_once([*own, *spare]) if item[0].id not in kept]
    return _with_own_ids(
        [
            *things,
            *(item for item in rest if not is_line(item[0])),
            *lines,
            *(item for item in rest if is_line(item[0])),
        ]
    )


def _whole_lines(cells: Mapping[Cell, CellMap], base: BeliefMap | None) -> tuple[set[str], set[tuple[Cell, str]]]:
    """Lines of the base that no cell has changed anywhere, and what the cells call their pieces of these."""
    if base is None:
        return set(), set()
    pieces: dict[str, set[tuple[Cell, str]]] = {}
    changed: set[str] = set()
    lines = [(e, base.beliefs[e.id]) for e in base.map.elements if not e.is_logical and is_line(e)]
    for cell, made in cells.items():
        known = {e.id: record_of(e) for e, _ in made.known}
        for element, belief in lines:
            for piece, _ in cut(element, belief, cell):
                pieces.setdefault(element.id, set()).add((cell, piece.id))
                if known.get(piece.id) != record_of(piece):
                    changed.add(element.id)
    whole = pieces.keys() - changed
    return set(whole), {name for line in whole for name in pieces[line]}


def _each_once(found: list[tuple[Cell, Known]]) -> list[tuple[Cell, Known]]:
    """Things without those that another cell has named before."""
    near = [k for k, (cell, (e, _)) in enumerate(found) if not cell.holds(_middle(e)[None], -_SEAM_M)[0]]
    if len(near) < 2:
        return found
    xy = np.array([_middle(found[k][1][0]) for k in near])
    dropped: set[int] = set()
    for a, b in sorted(map(tuple, cKDTree(xy).query_pairs(_SEAM_M, output_type="ndarray").tolist())):
        (one, (first, _)), (other, (second, _)) = found[near[a]], found[near[b]]
        if one != other and near[a] not in dropped and kind_of(first) == kind_of(second):
            dropped.add(near[b])
    return [item for k, item in enumerate(found) if k not in dropped]


def _untouched(base: BeliefMap, touched: set[Cell], whole: set[str]) -> list[Known]:
    """What of the base lies where no drive came, as it is; lines up to where one came."""
    kept: list[Known] = []
    for element in base.map.elements:
        belief = base.beliefs[element.id]
        if element.is_logical:
            kept.append((element, belief))
        elif not is_line(element):
            kept += [(element, belief)] if cell_of(element) not in touched else []
        else:
            only = BeliefMap(base.map.with_elements([element]), {element.id: belief})
            passed = cells_of(base_sights(Base.of(only)))
            if passed.isdisjoint(touched) or element.id in whole:
                kept.append((element, belief))
            else:
                kept += [(rounded(part), belief) for cell in sorted(passed - touched) for part in owned(element, cell)]
    return kept


def _with_own_ids(known: Iterable[Known]) -> list[Known]:
    """Elements, those of a name that is taken under another."""
    held: dict[str, Known] = {}
    for element, belief in known:
        name, k = element.id, 1
        while name in held:
            name, k = f"{element.id}+{k}", k + 1
        held[name] = (element if name == element.id else replace(element, id=name), belief)
    return list(held.values())


def _middle(element: MapElement) -> np.ndarray:
    xy = element.points[:, :2]
    return 0.5 * (xy.min(axis=0) + xy.max(axis=0))
