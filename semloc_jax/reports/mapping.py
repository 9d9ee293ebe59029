"""The report of a map made from a drive: what `semloc map` writes (room: reports; host).

In: a drive, its masks, how the map is made. Out: map, trajectory, tables, metrics and pictures in a folder.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import (
    MapComparison,
    Metric,
    Trajectory,
    aligned,
    compare_maps,
    evaluate,
    format_metrics,
    surveyed_distances,
    surveyed_metrics,
    write_metrics,
    write_tum,
)
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.base_map import Change
from semloc_jax.mapping.base_places import write_places
from semloc_jax.mapping.chain import drive_chain
from semloc_jax.mapping.closing import ClosedWay, closed_way
from semloc_jax.mapping.found_loops import FoundLoop, write_loops
from semloc_jax.mapping.gauge import GNSS, IDENTITY, Gauge, gauge_of
from semloc_jax.mapping.mapper import MadeMap, MapConfig, make_map
from semloc_jax.mapping.parts import Parts
from semloc_jax.mapping.refining import refined_way
from semloc_jax.mapping.seen_area import FILE as SEEN_AREA
from semloc_jax.mapping.seen_area import MadeFrame, seen_area, sensor_scale, write_seen_area
from semloc_jax.maps import BeliefMap, read_map, write_drive_geojson, write_map
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.map_film import MapFilm, write_map_film
from semloc_jax.reports.pictures import element_panels
from semloc_jax.reports.run_inputs import FILE as INPUTS
from semloc_jax.reports.run_inputs import begun, file_digest, fingerprint_without_map
from semloc_jax.reports.tables import write_csv
from semloc_jax.storage import json_document, output_path, remove_folder
from semloc_jax.viz import draw_contours, maps_over_each_other, save, sigmas_from_above

_PARTS = "parts"
"""What a run that is not finished has made so far."""
_NUM_SEEN = 5
"""An element of the reference counts where it was looked at in so many frames."""
_FALSE_LOOP_M, _FALSE_LOOP_DEG = 0.5, 2.0
"""A loop that is off by more leads to another place."""


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
    drive: Drive,
    masks: MaskSource,
    frames: Sequence[Frame],
    settings: MapConfig,
    start: str | None = None,
    out: Path | None = None,
    num_overlays: int = 4,
    options: Mapping[str, Any] | None = None,
    loops: bool = True,
    resume: Path | None = None,
    base: Path | None = None,
    has_video: bool = False,
) -> MadeMapReport:
    """Make a map of a drive and write everything about it.

    Args:
        drive: the drive.
        masks: what its cameras see.
        frames: those that look, in time order.
        settings: how the map is made.
        start: what fixes the frame of the map; see `mapping.gauge.gauge_of`.
        out: folder to write; None for a new one in results/.
        num_overlays: pictures of the map over images.
        options: what config.yaml keeps besides the configuration.
        loops: whether places that the drive comes to again tie its way down.
        resume: folder of a run that was killed, to go on with.
        base: map that is there already: the drive is found in it, updates its beliefs and adds to it.
        has_video: whether map.mp4 is written.

    Raises:
        SemlocError: no wheel odometry, nothing that fixes the frame as asked, or no map came out.
    """
    chain = drive_chain(drive)
    gauge = gauge_of(drive, chain, start)
    known = None if base is None else _base_of(base, gauge)
    folder = make_folder(out, resume)
    parts = _begun(folder, drive, masks, settings, options or {}, base, is_resumed=resume is not None)
    write_record(folder, settings, options or {})
    looking = [frame.index for frame in frames]
    origin = drive.gnss.origin if gauge.name == GNSS and drive.gnss is not None and base is None else None

    def shown(items: Iterable, name: str, unit: str = "frame") -> Iterable:
        return tqdm(items, desc=name, unit=unit)

    closed = closed_way(
        drive,
        masks,
        chain,
        gauge,
        settings,
        lambda items: shown(items, "loops", "group"),
        loops,
        parts=parts,
        base=None if known is None else known.map,
    )
    way = None
    if known is None:
        way = refined_way(drive, masks, looking, chain, closed, settings, shown, parts)
    Ts_map_base = closed.Ts_map_base if way is None else way.Ts_map_base
    write_loops(folder / "loops.csv", closed.loops, chain.times_s)
    made = make_map(
        drive,
        masks,
        frames,
        Ts_map_base[looking],
        settings,
        GeoOrigin(*origin) if origin is not None else None,
        shown,
        parts=parts,
        base=known,
    )
    if way is not None:
        made = replace(made, belief_map=way.sigmas.stated(made.belief_map))
    if known is not None:
        write_places(folder / "places.csv", closed.places, chain.times_s)
        write_changes(made.changes, folder / "changes.csv")
    trajectory = Trajectory(chain.times_s, Ts_map_base)
    write_map(made.belief_map.as_map(), folder / "map.gpkg")
    write_drive_geojson(made.belief_map.as_map(), folder / "map.geojson")
    write_tum(trajectory, folder / "trajectory.tum")
    write_elements(made, folder / "elements.csv")
    frame = MadeFrame(gauge.name, sensor_scale(Ts_map_base, closed.Ts_map_base))
    write_seen_area(seen_area(made, Ts_map_base[looking], settings.min_seen), frame, folder / SEEN_AREA)
    metrics, comparison = _judged(drive, made, trajectory, folder)
    metrics += loop_metrics(closed.loops, true_poses(drive, chain.times_s))
    if known is not None:
        metrics += base_metrics(closed.places, made.changes)
    write_metrics(metrics, folder / "metrics.json")
    _draw(drive, masks, frames, made, Ts_map_base, num_overlays, folder)
    if has_video:
        write_map_film(
            folder / "map.mp4", MapFilm(made.belief_map, masks, frames, Ts_map_base[looking], drive.name), shown
        )
    remove_folder(parts.folder)
    return MadeMapReport(folder, _text(made, closed, metrics, comparison), made.belief_map.map.num_elements)


def _begun(
    folder: Path,
    drive: Drive,
    masks: MaskSource,
    settings: MapConfig,
    options: Mapping[str, Any],
    base: Path | None,
    is_resumed: bool,
) -> Parts:
    """The parts of a new run, or those of the run that is resumed."""
    if is_resumed and not (folder / _PARTS).is_dir():
        raise SemlocError(f"--resume {folder}: has no folder '{_PARTS}': that run is finished, or is none of this verb")
    if not is_resumed:
        # What an earlier run left there is none of this one: it goes before the folder says what this one began with.
        remove_folder(folder / _PARTS)
    begun(folder, _made_of(drive, masks, settings, options, base), is_resumed)
    return Parts(folder / _PARTS)


def _made_of(
    drive: Drive, masks: MaskSource, settings: MapConfig, options: Mapping[str, Any], base: Path | None
) -> dict[str, str]:
    """A hash for each part of what a map depends on."""
    same = {name: value for name, value in options.items() if name not in ("overlays", "video")}
    made_of = fingerprint_without_map(drive, masks, settings, same)
    return made_of if base is None else {**made_of, "base": file_digest(base)}


def is_made(
    folder: Path, drive: Drive, masks: MaskSource, settings: MapConfig, options: Mapping[str, Any], base: Path | None
) -> bool:
    """Whether a folder holds a finished map of just this drive, these masks and settings; as for `report_map`."""
    if not all((folder / name).is_file() for name in ("metrics.json", "map.gpkg", INPUTS)):
        return False
    if (folder / _PARTS).exists():
        return False
    held = json_document((folder / INPUTS).read_bytes(), str(folder / INPUTS))
    return held == _made_of(drive, masks, settings, options, base)


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


def base_metrics(places: Sequence[FoundLoop], changes: Sequence[Change]) -> list[Metric]:
    """How often the drive was found in the base map, and what it changed there."""
    counts = {
        "base.searched": len(places),
        "base.found": sum(place.is_accepted for place in places),
        "base.removed": sum(change.change == "removed" for change in changes),
        "base.moved": sum(change.change == "moved" for change in changes),
        "base.added": sum(change.change == "added" for change in changes),
    }
    units = ("places", "places", "elements", "elements", "elements")
    return [Metric(key, float(n), unit, "report") for (key, n), unit in zip(counts.items(), units, strict=True)]


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


def true_poses(drive: Drive, times_s: np.ndarray) -> np.ndarray | None:
    """True poses of all frames; None where the reference does not span them."""
    truth = drive.truth
    if truth is None or truth.time_s[0] > times_s[0] or truth.time_s[-1] < times_s[-1]:
        return None
    return truth.interpolate(times_s)


def loop_metrics(loops: Sequence[FoundLoop], Ts_true: np.ndarray | None) -> list[Metric]:
    """How many revisits were searched and accepted and, where the truth of every frame is known, which were false."""
    accepted = [loop for loop in loops if loop.is_accepted]
    metrics = [
        Metric("loops.searched", float(len(loops)), "loops", "report"),
        Metric("loops.accepted", float(len(accepted)), "loops", "report"),
    ]
    if Ts_true is None or not accepted:
        return metrics
    off = np.array(
        [rigid.log(rigid.inverse(rigid.inverse(Ts_true[loop.a]) @ Ts_true[loop.b]) @ loop.T_a_b) for loop in accepted]
    )
    off_m, off_deg = np.hypot(off[:, 0], off[:, 1]), np.degrees(np.abs(off[:, 5]))
    false = float(np.sum((off_m > _FALSE_LOOP_M) | (off_deg > _FALSE_LOOP_DEG)))
    return [
        *metrics,
        Metric("loops.false", false, "loops"),
        Metric("loops.error.median", float(np.median(off_m)), "m"),
        Metric("loops.error.max", float(off_m.max()), "m"),
    ]


def _judged(
    drive: Drive, made: MadeMap, trajectory: Trajectory, folder: Path
) -> tuple[list[Metric], MapComparison | None]:
    """The map and the trajectory against those of the drive, where it has them, after one motion in the plane each."""
    metrics: list[Metric] = []
    guess = np.eye(4)
    if drive.truth is not None:
        moved, guess = aligned(trajectory, drive.truth, "se2")
        metrics = evaluate(moved, drive.truth)
    if drive.map_path is None or drive.truth is None:
        return metrics, None
    reference = read_map(drive.map_path)

    def seen(xy_reference: np.ndarray) -> np.ndarray:
        back = np.linalg.inv(comparison_motion)
        return made.seen(xy_reference @ back[:2, :2].T + back[:2, 3], _NUM_SEEN)

    ours = made.belief_map.map.elements
    comparison_motion = compare_maps(ours, reference.elements, "se2", T_reference_made=guess).T_reference_made
    comparison = compare_maps(ours, reference.elements, "none", seen=seen, T_reference_made=comparison_motion)
    moved = [e.with_points(e.points @ comparison_motion[:3, :3].T + comparison_motion[:3, 3]) for e in ours]
    extent = np.stack([e.points.mean(axis=0)[:2] for e in moved])
    low, high = extent.min(axis=0) - 20.0, extent.max(axis=0) + 20.0
    near = [e for e in reference.elements if not e.is_logical and _within(e.points[:, :2], low, high)]
    save(maps_over_each_other([e for e in moved if not e.is_logical], near, drive.name), folder / "against_truth.png")
    return [*metrics, *comparison.metrics(), *_surveyed(drive, made, comparison_motion)], comparison


def _surveyed(drive: Drive, made: MadeMap, T_reference_made: np.ndarray) -> list[Metric]:
    """The distances that were surveyed in the place of the drive, where it tells some."""
    path = drive.path / "meta.json"
    rows = json_document(path.read_bytes(), f"drive file {path}").get("surveyed") if path.is_file() else None
    if not rows:
        return []
    return surveyed_metrics(made.belief_map.map.elements, surveyed_distances(rows, str(path)), T_reference_made)


def _within(xy: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    return bool(((xy >= low) & (xy <= high)).all(axis=1).any())


def _draw(
    drive: Drive,
    masks: MaskSource,
    frames: Sequence[Frame],
    made: MadeMap,
    Ts_map_base: np.ndarray,
    num_overlays: int,
    folder: Path,
) -> None:
    belief_map = made.belief_map
    picture = sigmas_from_above(belief_map.map.elements, belief_map.beliefs, Ts_map_base, drive.name)
    save(picture, folder / "map.png")
    for index in np.unique(np.linspace(0, len(frames) - 1, num_overlays).astype(int)) if num_overlays else ():
        frame = frames[index]
        for name, image, contours in element_panels(belief_map.map, masks, frame, Ts_map_base[frame.index]):
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
        title = f"map against that of the drive where it was seen in {_NUM_SEEN} frames, after one motion in the plane:"
        lines += ["", title, comparison.to_text()]
        if surveyed := [m for m in metrics if m.key.startswith("surveyed.")]:
            lines += ["", "surveyed distances:", format_metrics(surveyed)]
    return "\n".join(lines)
