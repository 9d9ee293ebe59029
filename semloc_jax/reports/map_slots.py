"""The parking slots of a map: what `semloc slots MAP` writes (room: reports; host).

In: a map. Out: slots_final.csv, slots.geojson, slots.png, text.
"""

from pathlib import Path

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps import Belief, BeliefMap, MapElement, read_map, write_map
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.tables import write_csv
from semloc_jax.structs import ElementClass
from semloc_jax.viz.maps import slots_from_above
from semloc_jax.viz.style import save

_COLUMNS = (
    "slot", "type", "x_m", "y_m", "yaw_rad", "width_m", "depth_m", "occupied", "number", "sigma_across_m",
    "sigma_along_m", "existence", "num_seen", "num_missed",
)  # fmt: skip


def report_map_slots(path: Path, out: Path | None = None) -> str:
    """List the parking slots of a map, write tables and a picture, and return the text for people.

    Places are those of the map: the middle of the entrance, and the direction from there into the slot. A map that
    `semloc map` made says how sure it is of each; sigmas and existence of others are left empty.

    Args:
        path: the map; of each slot the first two corners are its entrance.
        out: folder for the results; None for results/TIME.

    Raises:
        SemlocError: no slots in the map, or it cannot be read.
    """
    whole = read_map(path)
    slots = [e for e in whole.walk() if e.label == ElementClass.PARKING_SLOT and len(e.points) >= 4]
    if not slots:
        num_lines = sum(e.label == ElementClass.SLOT_LINE for e in whole.walk())
        raise SemlocError(
            f"map {path.name}: no parking slots{f' but {num_lines} slot lines' if num_lines else ''}; expected "
            "elements of class parking_slot; `semloc map DRIVE` makes them of the lines that a drive sees"
        )
    chosen = whole.with_elements(slots)
    stated = BeliefMap.of(chosen).beliefs
    rows = [_row(slot, stated[slot.id] if stated[slot.id].num_seen else None) for slot in slots]
    folder = make_folder(out)
    write_csv(folder / "slots_final.csv", _COLUMNS, rows)
    write_map(chosen, folder / "slots.geojson")
    save(slots_from_above(whole.elements, slots, path.name), folder / "slots.png")
    write_record(folder, {}, {"map": str(path)})
    taken = [slot.attributes.get("occupied") for slot in slots]
    told = f"{sum(t is False for t in taken)} free, {sum(t is True for t in taken)} taken, {taken.count(None)} not told"
    return f"{path.name}: {len(slots)} parking slots: {told}\nresults: {folder}"


def entrance_pose(corners: np.ndarray) -> np.ndarray:
    """Middle of the entrance [m] and direction into a slot [rad], `float64[3]`, of its four corners, entrance first."""
    inward = 0.5 * (corners[3] - corners[0] + corners[2] - corners[1])
    return np.array([*(0.5 * (corners[0] + corners[1]))[:2], np.arctan2(inward[1], inward[0])])


def _row(slot: MapElement, belief: Belief | None) -> tuple:
    corners = slot.points[:4, :2]
    width_m = float(np.linalg.norm(corners[1] - corners[0]))
    depth_m = float(np.linalg.norm(0.5 * (corners[3] - corners[0] + corners[2] - corners[1])))
    words = slot.attributes
    taken = "" if words.get("occupied") is None else int(bool(words["occupied"]))
    sure = ("",) * 5
    if belief is not None:
        sigmas = (f"{belief.sigma_across_m:.4f}", f"{belief.sigma_along_m:.4f}")
        sure = (*sigmas, f"{belief.existence:.4f}", belief.num_seen, belief.num_missed)
    place = [f"{value:.4f}" for value in entrance_pose(corners)]
    size = [f"{value:.3f}" for value in (width_m, depth_m)]
    return (slot.id, words.get("kind", ""), *place, *size, taken, words.get("number", ""), *sure)
