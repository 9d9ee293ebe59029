"""The parking slots of top views without a drive (room: reports; host).

In: pictures seen from above. Out: points.csv, slots.csv, a picture of each, config.yaml, text: what `semloc slots`
writes with --metres-per-px.
"""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from semloc_jax.datasets.pictures import as_colour, read_picture
from semloc_jax.errors import SemlocError
from semloc_jax.mapping.point_dividers import in_view
from semloc_jax.mapping.slot_sights import SlotSightConfig
from semloc_jax.mapping.view_slots import ViewSlot, in_metres, in_pixels, slots_of_view
from semloc_jax.perception.networks.marking_net import MarkingNet, MarkingPoints
from semloc_jax.perception.target_pictures import PICTURE_SUFFIXES
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.tables import write_csv
from semloc_jax.storage import output_path
from semloc_jax.viz.slots import DrawnSlot, draw_slots
from semloc_jax.viz.style import save

_LEAST = 0.1
"""Points down to this confidence are written, so that recall and precision can be weighed afterwards."""
_SHOWS_M = (4.0, 60.0)
"""Shortest and longest side of a top view that shows a slot and whose pixels show lines."""
_POINTS = ("image", "u_px", "v_px", "x_m", "y_m", "yaw_rad", "shape", "confidence", "counts")
_CORNERS = tuple(f"{axis}{k}_px" for k in range(4) for axis in "uv")
_SLOTS = ("image", "slot", "type", *_CORNERS, "x_m", "y_m", "yaw_rad", "width_m", "depth_m", "confidence")


def report_view_slots(path: Path, metres_per_px: float, net: MarkingNet, out: Path | None = None) -> str:
    """Find the slots of every top view by itself, write tables and pictures, and return the text for people.

    Args:
        path: a picture, or a folder of them, each seen from above.
        metres_per_px: size of their pixels.
        net: finds the marking points.

    Raises:
        SemlocError: no pictures, or pixels of a size that shows no slots.
    """
    files, config = _pictures(path), SlotSightConfig().slots
    _check_size(files[0], metres_per_px)
    folder = make_folder(out)
    points: list[tuple] = []
    slots: list[tuple] = []
    for file in tqdm(files, unit="picture", desc="slots", disable=None):
        picture = as_colour(read_picture(file))
        side = (picture.shape[1], picture.shape[0])
        said = net(picture, metres_per_px, _LEAST)
        found = slots_of_view(said.above(net.threshold), side, metres_per_px, config)
        points += _point_rows(file.name, said, side, metres_per_px, net.threshold)
        slots += [_slot_row(file.name, k, slot, side, metres_per_px) for k, slot in enumerate(found)]
        drawn = [DrawnSlot(slot.corners, f"{100 * slot.confidence:.0f}", None, True) for slot in found]
        pixels = lambda xy, side=side: in_pixels(xy, side, metres_per_px)  # noqa: E731 - of this picture
        save(draw_slots(picture[..., ::-1], pixels, drawn), output_path(folder, "pictures", file.stem, suffix=".png"))
    write_csv(folder / "points.csv", _POINTS, points)
    write_csv(folder / "slots.csv", _SLOTS, slots)
    write_record(folder, {"slots": config}, {"metres_per_px": metres_per_px, "threshold": net.threshold})
    told = sum(row[-1] for row in points)
    return (
        f"{len(files)} top view{'s' if len(files) > 1 else ''}: {told} marking points that are "
        f"{100 * net.threshold:.0f} % sure, {len(slots)} slots\nresults: {folder}"
    )


def _pictures(path: Path) -> list[Path]:
    """The pictures of a folder by name, or the one that is given."""
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in PICTURE_SUFFIXES and file.is_file())
        if files:
            return files
    elif path.suffix.lower() in PICTURE_SUFFIXES:
        return [path]
    raise SemlocError(
        f"slots {path}: no top views; expected a picture or a folder of pictures ({', '.join(PICTURE_SUFFIXES)})"
    )


def _check_size(file: Path, metres_per_px: float) -> None:
    width, height = read_picture(file).shape[1::-1]
    sides = (width * metres_per_px, height * metres_per_px)
    if not (min(sides) >= _SHOWS_M[0] and max(sides) <= _SHOWS_M[1]):
        raise SemlocError(
            f"slots: {file.name} of {width} x {height} px shows {sides[0]:.3g} x {sides[1]:.3g} m at --metres-per-px "
            f"{metres_per_px:g}; expected sides of {_SHOWS_M[0]:g} to {_SHOWS_M[1]:g} m"
        )


def _point_rows(
    name: str, said: MarkingPoints, side: tuple[int, int], metres_per_px: float, threshold: float
) -> list[tuple]:
    """One line for each marking point: the middle of the paint where a divider begins; at the rim none counts."""
    places = zip(said.uv, in_metres(said.uv, side, metres_per_px), strict=True)
    counts = (said.confidence >= threshold) & in_view(said.uv, side)
    # Pictures turn from u towards v, the frame of the car from x towards y: up is ahead.
    ahead = np.arctan2(-np.cos(said.yaw_rad), -np.sin(said.yaw_rad))
    return [
        (name, *(f"{v:.2f}" for v in uv), *(f"{v:.3f}" for v in (*xy, yaw)), "TL"[corner], f"{sure:.3f}",
         int(own))
        for (uv, xy), yaw, corner, sure, own in zip(
            places, ahead, said.is_corner.astype(int), said.confidence, counts, strict=True
        )
    ]  # fmt: skip


def _slot_row(name: str, number: int, slot: ViewSlot, side: tuple[int, int], metres_per_px: float) -> tuple:
    uv = in_pixels(slot.corners, side, metres_per_px)
    entrance, inward = slot.corners[:2].mean(axis=0), slot.corners[3] - slot.corners[0]
    width_m = np.linalg.norm(slot.corners[1] - slot.corners[0])
    numbers = (*entrance, np.arctan2(inward[1], inward[0]), width_m, np.linalg.norm(inward), slot.confidence)
    return (name, number, slot.kind, *(f"{v:.2f}" for v in uv.ravel()), *(f"{v:.3f}" for v in numbers))
