"""The parking slots of a drive over many frames: what `semloc slots` writes (room: reports; host).

In: a drive, masks. Out: slots.csv, slots_final.csv, slots.geojson, metrics.json, a film, text.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from semloc_jax.datasets import Drive
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.inputs.surround_masks import check_surround_masks
from semloc_jax.mapping.chain import drive_chain
from semloc_jax.mapping.net_slots import NetSlotObserver
from semloc_jax.mapping.object_tracks import ObjectTrackConfig, Tracker
from semloc_jax.mapping.obstacle_tracks import ObstacleFollower
from semloc_jax.mapping.slot_sights import SlotObserver, SlotSightConfig
from semloc_jax.mapping.slot_tracks import SlotTrack
from semloc_jax.maps import BeliefMap, MapElement, SemanticMap, write_map
from semloc_jax.perception.networks.marking_net import MarkingNet
from semloc_jax.perception.obstacle_classes import obstacle_ids
from semloc_jax.reports.film import SIZE_M, top_view_film
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.object_errors import is_slow, last_poses
from semloc_jax.reports.objects import Tables, belief_of, placed, write_objects
from semloc_jax.reports.true_objects import SlotErrors
from semloc_jax.structs import ElementClass
from semloc_jax.viz.recording import RecordedThing, object_recording
from semloc_jax.viz.slots import DrawnSlot, colour_of, draw_slots

_TABLES = Tables("slots", "type", ("width_m", "depth_m", "occupied", "obstacle"))


def report_slots(
    drive: Drive,
    masks: MaskSource,
    frames: slice = slice(None),
    sights: SlotSightConfig | None = None,
    tracks: ObjectTrackConfig | None = None,
    net: MarkingNet | None = None,
    video: bool = False,
    rrd: Path | None = None,
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> str:
    """Find slots in every frame, follow them, write everything, and return the text for people.

    Args:
        drive: with wheel odometry.
        masks: of its cameras; they show the lines of slots.
        frames: which frames; the way is that of the whole drive.
        net: finds the marking points of slots in the images; None follows the lines in the masks.
        video: write a film of the top view.
        rrd: where a recording for Rerun is written; None for none.

    Raises:
        SemlocError: no odometry, masks that show no slot lines, or that do not fit the cameras.
    """
    chain, notes = drive_chain(drive), check_surround_masks(drive, masks)
    observer = SlotObserver(drive, masks, sights) if net is None else NetSlotObserver(drive, masks, net, sights)
    tracker = Tracker(SlotTrack, tracks)
    obstacles = ObstacleFollower(drive, masks) if obstacle_ids(masks.table) else None
    chosen = range(len(drive))[frames]
    folder = make_folder(out)
    errors = SlotErrors.of(drive)
    rows: list[tuple] = []
    film_of = top_view_film(folder / "slots.mp4", drive, masks, chosen, video)
    with film_of as film, object_recording(rrd) as recording:
        for index in tqdm(chosen, unit="frame", desc="slots", disable=None):
            frame, T = drive.frames[index], chain.Ts_odom_base[index]
            seen = observer.at(frame, index, chain.Ts_odom_base)
            visible = np.array([seen.shows_slot(t.corners(), float(t.pose[2])) for t in tracker.tracks], bool)
            found = tracker.step(seen.slots, frame.time_s, float(chain.way_m[index]), visible)
            if obstacles is not None:
                obstacles.step(frame, index, chain)
            rows += [_row(frame.time_s, track, T, obstacles) for track in found if track is not None]
            errors.add(frame, T, seen.slots, found, is_slow(drive, frame))
            if recording is not None:
                recording.add(frame.time_s, T, [_recorded(track) for track in tracker.tracks])
            if film is not None:
                drawn = _drawn(tracker.tracks, T)
                film.add(frame, lambda top, view, drawn=drawn: draw_slots(top, view.pixels, drawn))
    final = tracker.final()
    last = last_poses(final, drive, chain.Ts_odom_base)
    _write_map(folder, final, drive.name)
    write_record(folder, {"sights": observer.config, "tracks": tracker.config}, options or {})
    return write_objects(
        folder, _TABLES, rows, final, lambda track: _row(track.last_s, track, last[track.id], obstacles), len(chosen),
        errors.metrics(final, last), notes,
    )  # fmt: skip


def _row(time_s: float, track: SlotTrack, T_odom_base: np.ndarray, obstacles: ObstacleFollower | None) -> tuple:
    """One line of a table: the fused slot in base and odom; sigmas are along x and y of the base frame."""
    pose, sigmas = placed(track, float(track.pose[2]), T_odom_base)
    taken = "" if track.occupied is None else int(track.occupied)
    corners = track.outline()
    stands = (None if obstacles is None else obstacles.standing_in(corners)) or ""
    size = [f"{value:.3f}" for value in (track.width_m, track.depth_m)]
    told = [f"{value:.4f}" for value in (*sigmas, np.sqrt(track.covariance[2, 2]), track.existence)]
    return (f"{time_s:.3f}", track.id, track.kind, *pose, *size, taken, stands, *told, int(track.confirmed))


def _recorded(track: SlotTrack) -> RecordedThing:
    corners = track.outline()
    colour = colour_of(track.occupied)
    return RecordedThing(f"slot {track.id}", corners, colour, track.confirmed, track.existence)


def _write_map(folder: Path, final: Sequence[SlotTrack], name: str) -> None:
    """The slots with their beliefs, in odom."""
    elements, beliefs = [], {}
    for track in final:
        corners = track.outline()
        words = {"kind": track.kind} | ({} if track.occupied is None else {"occupied": bool(track.occupied)})
        element = MapElement(
            f"slot_{track.id}",
            ElementClass.PARKING_SLOT,
            np.column_stack([corners, np.zeros(4)]),
            closed=True,
            attributes=words,
        )
        beliefs[element.id] = belief_of(track, name)
        elements.append(element)
    if elements:
        write_map(BeliefMap(SemanticMap(tuple(elements), None, name), beliefs).as_map(), folder / "slots.geojson")


def _drawn(tracks: Sequence[SlotTrack], T_odom_base: np.ndarray) -> list[DrawnSlot]:
    """The slots that a top view shows."""
    drawn = []
    for track in tracks:
        corners = track.outline()
        base = (corners - T_odom_base[:2, 3]) @ T_odom_base[:2, :2]
        if np.abs(base).max() < SIZE_M:
            drawn.append(DrawnSlot(base, str(track.id), track.occupied, track.confirmed))
    return drawn
