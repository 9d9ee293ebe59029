"""What a car uploads of a drive that `semloc map` has mapped (room: mapping; host).

In: the folder of the map. Out: PackedDrive: elements and beliefs, the area that was looked at, a thinned way; no image.
Times of frames, speeds and other road users are not in it. Where the car went is: the way is its pose every ten metres.
"""

from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import shapely

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import read_trajectory
from semloc_jax.geometry import polyline, rigid
from semloc_jax.mapping.gauge import GNSS, IDENTITY
from semloc_jax.mapping.seen_area import FILE, read_seen_area
from semloc_jax.maps import BeliefMap, MapElement, read_map
from semloc_jax.maps.io.packed_drive import PackedDrive
from semloc_jax.maps.versions.state import MapState
from semloc_jax.structs import ElementClass

_EVERY_M = 10.0
_A_DATE_S = 1e8
"""A clock that shows less than three years counts from somewhere else than 1970."""
_HOUR_S = 3600.0
_BESIDE_M = 30.0
_RING_M = 0.8
_CURB_M, _BESIDE = 0.4, 0.7
"""Two curbs of a road are farther apart; one is another one where so large a share of it lies nearer."""
_GNSS_SIGMA_M, _STATED_SIGMA_M, _NOWHERE_M = 1.5, 0.3, 1e4
"""How far the frame of a map is off that satellite fixes placed, that somebody placed, and that nothing did; ours."""


def packed(folder: Path, when: str | None = None) -> PackedDrive:
    """The drive of a folder that `semloc map` wrote.

    Args:
        folder: with map.gpkg, trajectory.tum and seen_area.json.
        when: date of the drive (2026-05-31, or with a time), where its clock shows none; None asks the clock.

    Raises:
        SemlocError: a file is missing or broken, or `when` is no date.
    """
    missing = [name for name in ("map.gpkg", "trajectory.tum", FILE) if not (folder / name).is_file()]
    if missing:
        raise SemlocError(f"{folder}: has no {', '.join(missing)}; expected the folder of a finished `semloc map`")
    made = read_map(folder / "map.gpkg")
    beliefs = BeliefMap.of(made)
    trajectory = read_trajectory(folder / "trajectory.tum")
    rings, frame = read_seen_area(folder / FILE)
    T = trajectory.T_map_base
    heading_rad = np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
    place = np.array([*T[0, :3, 3].round(2), heading_rad[0].round(4)])
    T_odom_map = rigid.inverse(rigid.planar_pose(place[0], place[1], place[3], place[2]))
    rows = _every(T[:, :2, 3])
    way = np.column_stack([_moved(T_odom_map, T[rows, :3, 3]), heading_rad[rows] - place[3]])
    flat = [_moved(T_odom_map, np.column_stack([ring, np.zeros(len(ring))]))[:, :2] for ring in rings]
    elements = [
        replace(
            element,
            points=_moved(T_odom_map, element.points),
            normal=None if element.normal is None else T_odom_map[:3, :3] @ element.normal,
            attributes={},
        )
        for element in each_curb_once(beliefs)
    ]
    names = Counter(b.provenance for b in beliefs.beliefs.values())
    return PackedDrive(
        name=names.most_common(1)[0][0] or made.name,
        beliefs=BeliefMap(beliefs.map.with_elements(elements), {e.id: beliefs.beliefs[e.id] for e in elements}),
        place=place,
        sigma_place_m={GNSS: _GNSS_SIGMA_M, IDENTITY: _NOWHERE_M}.get(frame.gauge, _STATED_SIGMA_M),
        scale=frame.scale,
        origin=made.origin,
        way=way,
        rings=tuple(_thinned(ring) for ring in flat),
        when_s=_when(when, float(trajectory.time_s[0])),
        source=MapState(made).content,
    )


def each_curb_once(beliefs: BeliefMap) -> list[MapElement]:
    """All elements, of curbs that lie beside each other the longest: from frame to frame a border without paint is seen
    now here, now there, and is drawn anew."""
    curbs = [e for e in beliefs.map.elements if e.label == ElementClass.CURB]
    kept: list[MapElement] = []
    for curb in sorted(curbs, key=lambda e: -polyline.arc_length(e.points[:, :2])[-1]):
        length_m = float(polyline.arc_length(curb.points[:, :2])[-1])
        places = polyline.interpolate(curb.points[:, :2], np.linspace(0.0, length_m, max(round(length_m), 1) + 1))
        apart_m = [polyline.nearest(other.points[:, :2], places).distance_m for other in kept]
        if np.mean(np.min(apart_m, axis=0, initial=np.inf) < _CURB_M) < _BESIDE:
            kept.append(curb)
    names = {e.id for e in kept}
    return [e for e in beliefs.map.elements if e.label != ElementClass.CURB or e.id in names]


def _thinned(ring: np.ndarray) -> np.ndarray:
    """An outline with fewer corners; the road is looked at to about a metre."""
    thin = shapely.Polygon(ring).buffer(0.0).simplify(_RING_M)
    parts = [part for part in shapely.get_parts(thin) if part.geom_type == "Polygon" and not part.is_empty]
    return np.array(max(parts, key=lambda part: part.area).exterior.coords)[:-1] if parts else ring


def _moved(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ T[:3, :3].T + T[:3, 3]


def _every(xy: np.ndarray) -> np.ndarray:
    """Rows of places about ten metres apart, first and last among them."""
    s_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    marks = np.linspace(0.0, s_m[-1], max(round(s_m[-1] / _EVERY_M), 1) + 1)
    return np.unique(np.searchsorted(s_m, marks - 1e-9).clip(0, len(xy) - 1))


def _when(stated: str | None, clock_s: float) -> float | None:
    """Seconds since 1970, to the hour."""
    if stated is not None:
        try:
            date = datetime.fromisoformat(stated)
        except ValueError as error:
            raise SemlocError(f"--when {stated}: expected a date such as 2026-05-31 or 2026-05-31T14:00") from error
        clock_s = (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
    elif clock_s < _A_DATE_S:
        return None
    return _HOUR_S * (clock_s // _HOUR_S)


def trimmed(drive: PackedDrive, end_m: float) -> PackedDrive:
    """The drive without what lies beside the first and the last metres of its way.

    Raises:
        SemlocError: nothing stays.
    """
    if end_m <= 0.0:
        return drive
    xy = drive.way[:, :2]
    s_m = polyline.arc_length(xy)
    kept = drive.way[(s_m >= end_m) & (s_m <= s_m[-1] - end_m)]
    if len(kept) < 2:
        raise SemlocError(f"--trim {end_m:g}: nothing stays of {s_m[-1]:.0f} m of way; give less")
    foot_m = {e.id: polyline.nearest(xy, e.points[:, :2]).s_m for e in drive.beliefs.map.elements}
    stays = [
        e for e in drive.beliefs.map.elements if end_m <= foot_m[e.id].min() <= foot_m[e.id].max() <= s_m[-1] - end_m
    ]
    near = shapely.LineString(kept[:, :2]).buffer(_BESIDE_M, cap_style="flat")
    area = shapely.intersection(shapely.union_all([shapely.Polygon(ring).buffer(0) for ring in drive.rings]), near)
    rings = [np.array(part.exterior.coords)[:-1] for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
    if not stays or not rings:
        raise SemlocError(f"--trim {end_m:g}: no element stays; give less")
    held = BeliefMap(drive.beliefs.map.with_elements(stays), {e.id: drive.beliefs.beliefs[e.id] for e in stays})
    return _begun_at(replace(drive, beliefs=held, way=kept, rings=tuple(rings)))


def _begun_at(drive: PackedDrive) -> PackedDrive:
    """The same drive in the frame of the first pose of its way: the frame would tell where it began."""
    x, y, z, heading_rad = drive.way[0]
    T_odom_first = rigid.planar_pose(x, y, heading_rad, z)
    T = rigid.inverse(T_odom_first)
    T_map = rigid.planar_pose(drive.place[0], drive.place[1], drive.place[3], drive.place[2]) @ T_odom_first
    elements = [
        replace(e, points=_moved(T, e.points), normal=None if e.normal is None else T[:3, :3] @ e.normal)
        for e in drive.beliefs.map.elements
    ]
    return replace(
        drive,
        beliefs=BeliefMap(drive.beliefs.map.with_elements(elements), drive.beliefs.beliefs),
        place=np.array([*T_map[:3, 3], drive.place[3] + heading_rad]),
        way=np.column_stack([_moved(T, drive.way[:, :3]), drive.way[:, 3] - heading_rad]),
        rings=tuple(_moved(T, np.column_stack([r, np.zeros(len(r))]))[:, :2] for r in drive.rings),
    )
