"""The obstacles of a drive over many frames: what `semloc obstacles` writes (room: reports; host).

In: a drive, masks. Out: obstacles.csv, obstacles_final.csv, obstacles.geojson, metrics.json, a film, text.
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
from semloc_jax.mapping.object_tracks import ObjectTrackConfig
from semloc_jax.mapping.obstacle_sights import ObstacleConfig
from semloc_jax.mapping.obstacle_tracks import ObstacleFollower, ObstacleTrack
from semloc_jax.maps import BeliefMap, MapElement, SemanticMap
from semloc_jax.maps.io.drive_geojson import write_drive_geojson
from semloc_jax.perception.networks.obstacle_net import ObstacleNet
from semloc_jax.perception.obstacle_classes import OBSTACLES
from semloc_jax.reports.film import SIZE_M, top_view_film
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.object_errors import is_slow, last_poses
from semloc_jax.reports.objects import Tables, belief_of, placed, write_objects
from semloc_jax.reports.true_objects import obstacle_errors
from semloc_jax.structs import ElementClass
from semloc_jax.viz.obstacles import COLOURS, DrawnObstacle, draw_obstacles, ellipse
from semloc_jax.viz.recording import RecordedThing, object_recording

_TABLES = Tables("obstacles", "class", ("length_m", "width_m"))
_PILLAR_M = 2.5
"""Drawn height of a pillar whose top nobody saw."""


def report_obstacles(
    drive: Drive,
    masks: MaskSource,
    frames: slice = slice(None),
    sights: ObstacleConfig | None = None,
    tracks: ObjectTrackConfig | None = None,
    net: ObstacleNet | None = None,
    video: bool = False,
    rrd: Path | None = None,
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> str:
    """Find obstacles in every frame, follow them, write everything, and return the text for people.

    Args:
        drive: with wheel odometry.
        masks: of its cameras; they show obstacles, or what hides the road where a network finds them.
        frames: which frames; the way is that of the whole drive.
        net: finds obstacles in the images instead of the masks.
        video: write a film of the top view.
        rrd: where a recording for Rerun is written; None for none.

    Raises:
        SemlocError: no odometry, masks that know no obstacles, or that do not fit the cameras.
    """
    chain, notes = drive_chain(drive), check_surround_masks(drive, masks)
    follower = ObstacleFollower(drive, masks, sights, tracks, net)
    chosen = range(len(drive))[frames]
    folder = make_folder(out)
    errors = obstacle_errors(drive)
    rows: list[tuple] = []
    film_of = top_view_film(folder / "obstacles.mp4", drive, masks, chosen, video)
    with film_of as film, object_recording(rrd) as recording:
        for index in tqdm(chosen, unit="frame", desc="obstacles", disable=None):
            frame, T = drive.frames[index], chain.Ts_odom_base[index]
            seen, found = follower.step(frame, index, chain)
            rows += [_row(frame.time_s, track, T) for track in found if track is not None]
            errors.add(frame, T, seen, found, is_slow(drive, frame))
            if recording is not None:
                recording.add(frame.time_s, T, [_recorded(track) for track in follower.tracker.tracks])
            if film is not None:
                drawn = _drawn(follower.tracker.tracks, T)
                film.add(frame, lambda top, view, drawn=drawn: draw_obstacles(top, view, drawn))
    final = follower.tracker.final()
    last = last_poses(final, drive, chain.Ts_odom_base)
    _write_map(folder, final, drive.name)
    write_record(folder, {"sights": follower.observer.config, "tracks": follower.tracker.config}, options or {})
    return write_objects(
        folder, _TABLES, rows, final, lambda track: _row(track.last_s, track, last[track.id]), len(chosen),
        errors.metrics(final, last), notes,
    )  # fmt: skip


def _row(time_s: float, track: ObstacleTrack, T_odom_base: np.ndarray) -> tuple:
    """One line of a table: the fused obstacle in base and odom; sigmas are along x and y of the base frame."""
    print_of = track.footprint()
    pose, sigmas = placed(track, print_of.yaw_rad, T_odom_base)
    size = [f"{value:.3f}" for value in (print_of.length_m, print_of.width_m)]
    told = [f"{value:.4f}" for value in (*sigmas, print_of.sigma_yaw_rad, track.existence)]
    return (f"{time_s:.3f}", track.id, track.kind, *pose, *size, *told, int(track.confirmed))


def outline_of(track: ObstacleTrack) -> np.ndarray:
    """Footprint in odom, `float64[4 2]` [m]."""
    box = track.footprint()
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    corners = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [box.length_m, box.width_m]
    return track.pose[:2] + corners @ np.array([[c, s], [-s, c]])


def _drawn(tracks: Sequence[ObstacleTrack], T_odom_base: np.ndarray) -> list[DrawnObstacle]:
    """The obstacles that a top view shows."""
    drawn = []
    for track in tracks:
        around = ellipse(track.pose[:2], track.covariance[:2, :2])
        outline, around = ((part - T_odom_base[:2, 3]) @ T_odom_base[:2, :2] for part in (outline_of(track), around))
        if np.abs(outline).max() < SIZE_M:
            drawn.append(DrawnObstacle(outline, around, track.kind, f"{track.kind} {track.id}", track.confirmed))
    return drawn


def _recorded(track: ObstacleTrack) -> RecordedThing:
    name = f"{track.kind} {track.id}"
    return RecordedThing(name, outline_of(track), COLOURS[track.kind], track.confirmed, track.existence)


def _write_map(folder: Path, final: Sequence[ObstacleTrack], name: str) -> None:
    """Cones and pillars as elements with their beliefs, locks and signs as points with the same; in odom."""
    elements, beliefs, more = [], {}, []
    for track in final:
        belief = belief_of(track, name)
        kind, name_of = OBSTACLES[track.kind], f"{track.kind}_{track.id}"
        if kind.label is None:
            more.append(_point(track, name_of, belief.sigma_across_m))
            continue
        beliefs[name_of] = belief
        elements.append(_element(track, name_of, kind.label))
    belief_map = BeliefMap(SemanticMap(tuple(elements), None, name), beliefs).as_map()
    write_drive_geojson(belief_map, folder / "obstacles.geojson", more)


def _element(track: ObstacleTrack, name: str, label: ElementClass) -> MapElement:
    if label == ElementClass.CONE:
        top_m = OBSTACLES[track.kind].height_m[0]
        points = np.array([[*track.pose[:2], 0.0], [*track.pose[:2], top_m]])
        return MapElement(name, label, points, radius_m=0.5 * track.footprint().width_m)
    points = np.column_stack([outline_of(track), np.zeros(4)])
    return MapElement(name, label, points, closed=True, height_m=_PILLAR_M)


def _point(track: ObstacleTrack, name: str, sigma_m: float) -> dict[str, Any]:
    """A feature in the form that drives with obstacles have."""
    box = track.footprint()
    words = {
        "class": track.kind,
        "yaw": round(box.yaw_rad, 4),
        "size": [round(box.length_m, 3), round(box.width_m, 3)],
        "sigma_m": round(sigma_m, 4),
        "existence": round(track.existence, 4),
    }
    place = [*(round(float(value), 4) for value in track.pose[:2]), 0.0]
    return {"type": "Feature", "id": name, "properties": words, "geometry": {"type": "Point", "coordinates": place}}
