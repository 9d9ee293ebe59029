"""The report of a map made from a drive: what `semloc map` writes (room: reports; host).

In: a drive, its masks, how the map is made. Out: map, trajectory, tables, metrics and pictures in a folder.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import MapComparison, Metric, Trajectory, format_metrics, write_metrics, write_tum
from semloc_jax.inputs.kept_masks import kept
from semloc_jax.inputs.mask_source import made_of_images
from semloc_jax.mapping.base_map import Change
from semloc_jax.mapping.base_places import write_places
from semloc_jax.mapping.chain import Chain, drive_chain
from semloc_jax.mapping.closing import ClosedWay, closed_way
from semloc_jax.mapping.found_loops import write_loops
from semloc_jax.mapping.gauge import GNSS, IDENTITY, Gauge, gauge_of
from semloc_jax.mapping.mapper import MadeMap, make_map
from semloc_jax.mapping.parts import Parts
from semloc_jax.mapping.refining import refined_way
from semloc_jax.mapping.seen_area import FILE as SEEN_AREA
from semloc_jax.mapping.seen_area import MadeFrame, seen_area, sensor_scale, write_seen_area
from semloc_jax.maps import BeliefMap, read_map, write_drive_geojson, write_map
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.map_film import MapFilm, write_map_film
from semloc_jax.reports.map_judgement import NUM_SEEN, base_metrics, judged, loop_metrics, true_poses
from semloc_jax.reports.map_request import MapRequest
from semloc_jax.reports.pictures import element_panels
from semloc_jax.reports.tables import write_csv
from semloc_jax.storage import output_path, remove_folder
from semloc_jax.viz import draw_contours, save, sigmas_from_above


class MadeMapReport(NamedTuple):
    """A map that was made.

    Args:
        folder: where everything was written.
        text: summary for people.
        num_elements: elements of the map.
    """

    folder: Path
    text: str
    num_elements: int


def report_map(
    request: MapRequest,
    out: Path | None = None,
    resume: Path | None = None,
    num_overlays: int = 4,
    has_video: bool = False,
) -> MadeMapReport:
    """Make a map of a drive and write everything about it.

    Args:
        request: what the map is made of.
        num_overlays: pictures of the map over images.
        has_video: whether map.mp4 is written.

    Raises:
        SemlocError: no wheel odometry, nothing that fixes the frame as asked, or no map came out.
    """
    drive, frames = request.drive, request.frames
    chain = drive_chain(drive)
    gauge = gauge_of(drive, chain, request.start)
    base = None if request.base is None else _base_of(request.base, gauge)
    folder = make_folder(out, resume)
    parts = request.parts(folder, is_resumed=resume is not None)
    write_record(folder, request.settings, request.options)
    if made_of_images(request.masks.name):  # they are looked at some ten times
        request = request._replace(masks=kept(request.masks, parts.folder / "masks"))
    drawn = _drawn(request, chain, gauge, base, parts)
    trajectory = Trajectory(chain.times_s, drawn.Ts_map_base)
    _write(drawn, trajectory, request, folder)
    metrics, comparison = judged(drive, drawn.made, trajectory, folder)
    metrics += loop_metrics(drawn.closed.loops, true_poses(drive, chain.times_s))
    if base is not None:
        metrics += base_metrics(drawn.closed.places, drawn.made.changes)
    write_metrics(metrics, folder / "metrics.json")
    _draw(request, drawn, num_overlays, folder)
    if has_video:
        poses = drawn.Ts_map_base[request.looking]
        write_map_film(
            folder / "map.mp4", MapFilm(drawn.made.belief_map, request.masks, frames, poses, drive.name), _shown
        )
    remove_folder(parts.folder)
    text = _text(drawn.made, drawn.closed, metrics, comparison)
    return MadeMapReport(folder, text, drawn.made.belief_map.map.num_elements)


class _Drawn(NamedTuple):
    """A map and the way that it was drawn along."""

    made: MadeMap
    closed: ClosedWay
    Ts_map_base: Float[np.ndarray, "n 4 4"]
    """Of all frames of the drive."""


def _drawn(request: MapRequest, chain: Chain, gauge: Gauge, base: BeliefMap | None, parts: Parts) -> _Drawn:
    """The way closed and made to agree with what is seen, and the map along it."""
    drive, masks, settings, looking = request.drive, request.masks, request.settings, request.looking

    def groups(items: Iterable) -> Iterable:
        return _shown(items, "loops", "group")

    known = None if base is None else base.map
    closed = closed_way(drive, masks, chain, gauge, settings, groups, request.has_loops, parts=parts, base=known)
    way = refined_way(drive, masks, looking, chain, closed, settings, _shown, parts, base)
    origin = drive.gnss.origin if gauge.name == GNSS and drive.gnss is not None and base is None else None
    made = make_map(
        drive,
        masks,
        request.frames,
        way.Ts_map_base[looking],
        settings,
        None if origin is None else GeoOrigin(*origin),
        _shown,
        parts=parts,
        base=base,
    )
    if base is None:  # else the sigmas of what is around it there are stated
        made = replace(made, belief_map=way.sigmas.stated(made.belief_map))
    return _Drawn(made, closed, way.Ts_map_base)


def _shown(items: Iterable, name: str, unit: str = "frame") -> Iterable:
    return tqdm(items, desc=name, unit=unit)


def _write(drawn: _Drawn, trajectory: Trajectory, request: MapRequest, folder: Path) -> None:
    """Map, way and tables; nothing that needs the truth."""
    made, closed = drawn.made, drawn.closed
    write_loops(folder / "loops.csv", closed.loops, trajectory.time_s)
    if request.base is not None:
        write_places(folder / "places.csv", closed.places, trajectory.time_s)
        write_changes(made.changes, folder / "changes.csv")
    write_map(made.belief_map.as_map(), folder / "map.gpkg")
    write_drive_geojson(made.belief_map.as_map(), folder / "map.geojson")
    write_tum(trajectory, folder / "trajectory.tum")
    write_elements(made, folder / "elements.csv")
    frame = MadeFrame(closed.gauge.name, sensor_scale(drawn.Ts_map_base, closed.Ts_map_base))
    area = seen_area(made, drawn.Ts_map_base[request.looking], request.settings.min_seen)
    write_seen_area(area, frame, folder / SEEN_AREA)


def _base_of(path: Path, gauge: Gauge) -> BeliefMap:
    """The map that is there, where something says where in it the drive begins."""
    if gauge.name == IDENTITY:
        raise SemlocError(
            f"--base {path}: nothing says where in it the drive begins: it has no satellite fixes (or --no-gnss leaves "
            "them out); give --start with its first pose in that map"
        )
    return BeliefMap.of(read_map(path))


def write_changes(changes: Sequence[Change], path: Path) -> None:
    """changes.csv: what the drive removed from the base map and added to it."""
    rows = []
    for change in changes:
        x_m, y_m = change.element.points[:, :2].mean(axis=0)
        name = change.element.label.name.lower()
        rows.append((change.id, change.change, name, float(x_m), float(y_m), round(change.existence, 6)))
    write_csv(path, ("id", "change", "class", "x_m", "y_m", "existence"), rows)


def write_elements(made: MadeMap, path: Path) -> None:
    """elements.csv: every element that stayed."""
    beliefs = made.belief_map.beliefs
    rows = []
    for element in made.belief_map.map.elements:
        b = beliefs[element.id]
        name = element.label.name.lower()
        sigma_m = float(np.hypot(b.sigma_across_m, b.sigma_along_m))
        rows.append((element.id, name, b.num_seen, b.num_missed, round(b.existence, 6), sigma_m))
        rows[-1] += (b.sigma_across_m, b.sigma_along_m, b.sigma_place_m, b.sigma_turn_rad)
    head = ("id", "class", "num_seen", "num_missed", "existence", "sigma_m", "sigma_across_m", "sigma_along_m")
    head += ("sigma_place_m", "sigma_turn_rad")
    write_csv(path, head, rows)


def _draw(request: MapRequest, drawn: _Drawn, num_overlays: int, folder: Path) -> None:
    """map.png: the sigmas of the map from above; overlays/*.png: the map in some of the images."""
    belief_map, frames = drawn.made.belief_map, request.frames
    picture = sigmas_from_above(belief_map.map.elements, belief_map.beliefs, drawn.Ts_map_base, request.drive.name)
    save(picture, folder / "map.png")
    for index in np.unique(np.linspace(0, len(frames) - 1, num_overlays).astype(int)) if num_overlays else ():
        frame = frames[index]
        T_map_base = drawn.Ts_map_base[frame.index]
        for name, image, contours in element_panels(belief_map.map, request.masks, frame, T_map_base):
            for part in contours.values():
                image = draw_contours(image, part)
            save(image, output_path(folder, "overlays", f"{frame.id}_{name}", suffix=".png"))


def _text(made: MadeMap, closed: ClosedWay, metrics: list[Metric], comparison: MapComparison | None) -> str:
    counts: dict[str, int] = {}
    for element in made.belief_map.map.elements:
        name = element.label.name.lower()
        counts[name] = counts.get(name, 0) + 1
    lines = [f"map: {', '.join(f'{count} {name}' for name, count in counts.items())}"]
    lines.append(f"frame of the map: {closed.gauge.name}; {len(made.rejected.beliefs)} candidates did not stay")
    accepted = sum(loop.is_accepted for loop in closed.loops)
    lines.append(f"loops: {accepted} of {len(closed.loops)} revisits that were searched (loops.csv)")
    if closed.places:
        found = sum(place.is_accepted for place in closed.places)
        counts = Counter(change.change for change in made.changes)
        lines.append(f"base map: found in it at {found} of {len(closed.places)} places (places.csv)")
        words = ", ".join(f"{counts[word]} {word}" for word in ("removed", "moved", "added"))
        lines.append(f"changes: {words} (changes.csv)")
    rates = [f"{label.name.lower()} {100 * rate:.0f} %" for label, rate in made.detection_rates.items()]
    lines.append(f"shown by a visible look: {', '.join(rates)}")
    if metrics:
        poses = [m for m in metrics if not m.key.startswith(("map.", "surveyed."))]
        lines += ["", "trajectory against the truth, after one motion in the plane:", format_metrics(poses)]
    if comparison is not None:
        title = f"map against that of the drive where it was seen in {NUM_SEEN} frames, after one motion in the plane:"
        lines += ["", title, comparison.to_text()]
        if surveyed := [m for m in metrics if m.key.startswith("surveyed.")]:
            lines += ["", "surveyed distances:", format_metrics(surveyed)]
    return "\n".join(lines)
