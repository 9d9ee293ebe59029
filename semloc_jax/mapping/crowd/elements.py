"""Things of a world as elements of a map: shape, name, belief, on the grid of the map (room: mapping; host).

In: Fused, heights, who saw what. Out: MapElements and Beliefs.
"""

import hashlib
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.evaluation.map_shapes import kind_of
from semloc_jax.geometry import polyline
from semloc_jax.mapping.crowd.fusion import Fused
from semloc_jax.mapping.crowd.looks import directions
from semloc_jax.mapping.crowd.presence import Looks, Presence
from semloc_jax.mapping.crowd.sights import CROWD, Sights
from semloc_jax.maps import Belief, MapElement
from semloc_jax.maps.curves import simplify

_CELL_M = 0.005
_THIN_M = 0.01
_LEAST_SIGMA_M = 0.005
_MOST_LOGIT = 6.0
_SHARED_STEP, _LEAST_SHARED = 0.2, 1e-5
_TOLD_M = (0.15, 0.05)
"""How far along and across drives must place a thing off a surveyed map to be believed: three times what masks are off
alike in all drives; ours."""
TOLD_ASIDE_M = _TOLD_M[1]
LEAST_TOLD_BY = 2
"""One drive alone does not move what somebody surveyed; ours."""


def id_of(sights: Sights, element: MapElement) -> str:
    """The id of what a drive was the first to see: that of the base map, else a short one that tells nothing of it."""
    if sights.is_base:
        return element.id
    text = repr((sights.name, sights.when_s, sights.source, element.id))
    return f"{kind_of(element)}_{hashlib.sha256(text.encode('utf-8', 'replace')).hexdigest()[:8]}"


def things_of(found: Fused, z: Float[np.ndarray, " n"]) -> list[MapElement]:
    """Every thing as an element: the shape that the first drive saw, where and as large as all say.

    What a surveyed base map names stays as it is there, unless drives speak against that.
    """
    world = found.world
    along, half = directions(found)
    stays = stays_as_surveyed(found)
    elements = []
    for k, (place, row) in enumerate(world.source.tolist()):
        sights = found.drives[place].sights
        things, element = sights.things, sights.things.elements[row]
        if stays[k]:
            elements.append(element)
            continue
        offset = element.points[:, :2] - things.centre[row]
        if world.half_m[k].any():
            old = np.stack([things.along[row], [-things.along[row, 1], things.along[row, 0]]])
            new = np.stack([along[k], [-along[k, 1], along[k, 0]]])
            grown = half[k] / np.maximum(things.half_m[row], 1e-3)
            grown = np.where(things.half_m[row] > 0.05, grown, 1.0)
            offset = (offset @ old.T * grown) @ new
        points = np.column_stack([world.centre[k] + offset, element.points[:, 2] - element.points[:, 2].min() + z[k]])
        attributes = element.attributes if sights.is_base else {}
        made = replace(element, id=id_of(sights, element), points=points, attributes=attributes)
        elements.append(rounded(made))
    return elements


def stays_as_surveyed(found: Fused) -> Bool[np.ndarray, " n"]:
    """Which things of a surveyed base map lie where it says, as far as drives can tell."""
    world = found.world
    stays = np.zeros(len(world.kind), dtype=bool)
    if not found.drives or not found.drives[0].is_held:
        return stays
    rows = np.flatnonzero(world.source[:, 0] == 0)
    off = world.centre[rows] - found.drives[0].sights.things.centre[world.source[rows, 1]]
    ahead = world.along[rows]
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    off_m = np.abs(np.stack([(off * ahead).sum(axis=1), (off * aside).sum(axis=1)], axis=1))
    told_by = np.zeros(len(world.kind), dtype=np.int64)
    for seen in found.seen[1:]:
        told_by[seen.pairs[:, 1]] += 1
    stays[rows] = (off_m < _TOLD_M).all(axis=1) | (told_by[rows] < LEAST_TOLD_BY)
    return stays


def beliefs_of(found: Fused, looks: Looks, there: Presence) -> list[Belief]:
    """How sure all drives together are of each thing."""
    information = np.zeros((len(found.world.kind), 2))
    for drive, seen in zip(found.drives, found.seen, strict=True):
        sigma = drive.sights.things.sigma_m[seen.pairs[:, 0]] * seen.factor[:2]
        np.add.at(information, seen.pairs[:, 1], sigma**-2.0)
    sigmas = np.maximum(np.maximum(information, 1.0) ** -0.5, _LEAST_SIGMA_M).round(3)
    rows = zip(sigmas.tolist(), there.now.tolist(), looks.counts.tolist(), strict=True)
    made = [Belief(across, along, logit_of(p), *n, provenance=CROWD) for (along, across), p, n in rows]
    for k in np.flatnonzero(stays_as_surveyed(found)).tolist():
        made[k] = surveyed_belief(found.drives[0].sights.things.beliefs[found.world.source[k, 1]], made[k])
    return made


def surveyed_belief(before: Belief, now: Belief) -> Belief:
    """The belief in what stays where a surveyed map has it: that of the map, until it is rather gone than there.

    Certainty that only fades since nobody looks says nothing new.
    """
    if now.existence_logit > min(before.existence_logit, 0.0):
        return before
    counts = {"num_seen": now.num_seen, "num_missed": now.num_missed}
    return replace(before, existence_logit=now.existence_logit, **counts)


def logit_of(probability: float) -> float:
    """Log odds in steps of a half, no surer than 99.75 %."""
    p = float(np.clip(probability, 1e-6, 1.0 - 1e-6))
    return float(np.clip(np.round(2.0 * np.log(p / (1.0 - p))) / 2.0, -_MOST_LOGIT, _MOST_LOGIT))


def told_shared(sigma: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Sigmas in steps of a fifth and no finer: what nobody needs to know better does not change with each drive."""
    steps = np.ceil(np.log(np.maximum(sigma, _LEAST_SHARED)) / _SHARED_STEP)
    return np.where(sigma < _LEAST_SHARED, 0.0, np.exp(_SHARED_STEP * steps).round(6))


def rounded(element: MapElement) -> MapElement:
    """On the grid of the crowd map; widths to the centimetre, lines without vertices that say nothing."""
    points = element.points
    if not element.closed and len(points) > 2:
        points = simplify(points, _THIN_M)
    points = np.rint(points / _CELL_M) * _CELL_M
    points = np.rint(points * 1000.0) / 1000.0 + 0.0
    if not element.closed and len(points) > 1:
        steps = polyline.arc_length(points)
        points = points[np.append(True, np.diff(steps) > 0.0)] if steps[-1] > 0.0 else points
    normal = None if element.normal is None else np.round(element.normal, 3) + 0.0
    sizes = {name: round(getattr(element, name), 3) for name in ("width_m", "radius_m", "radius_top_m", "height_m")}
    return replace(element, points=points, normal=normal, **sizes)
