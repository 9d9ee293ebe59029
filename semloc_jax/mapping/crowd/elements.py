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
from semloc_jax.mapping.crowd.ground import Ground
from semloc_jax.mapping.crowd.looks_chain import Looks
from semloc_jax.mapping.crowd.presence import Presence
from semloc_jax.mapping.crowd.shapes import Shapes, counted_sights, shapes_of, told_number
from semloc_jax.mapping.crowd.sights import CROWD, Sights
from semloc_jax.mapping.crowd.world import HUNG
from semloc_jax.maps import Belief, MapElement
from semloc_jax.maps.curves import simplify
from semloc_jax.maps.versions.datum import CELL_MM

_CELL_M, _SURVEYED_CELL_M = CELL_MM / 1000.0, 0.02
"""Grid of the map; of what is new to a survey, which is told by few drives."""
_THIN_M = 0.01
_LEAST_SIGMA_M = 0.005
_MOST_LOGIT = 6.0
_SIGMA_STEP, _TINY = 0.5 * np.log(2.0), 1e-5
_GONE_LOGIT, _THERE_LOGIT = -2.0, 2.0
"""Under a survey it is told whether something is rather gone or there, not how sure each drive makes it; ours."""
_TOLD_M = (0.15, 0.05)
"""How far along and across drives must place a thing off a surveyed map to be believed: three times what masks are off
alike in all drives; ours."""
TOLD_ASIDE_M, _TOLD_SIGMAS = _TOLD_M[1], 3.0
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
    world, shapes = found.world, shapes_of(found)
    stays = stays_as_surveyed(found, shapes)
    ground_z = Ground.of(found).height_m(shapes.centre)
    cell_m = _SURVEYED_CELL_M if found.is_surveyed else _CELL_M
    elements = []
    for k, (place, row) in enumerate(world.source.tolist()):
        sights = found.drives[place].sights
        things, element = sights.things, sights.things.elements[row]
        if stays[k]:
            elements.append(element)
            continue
        low = ground_z[k] if found.is_surveyed and kind_of(element) not in HUNG else z[k]
        middle = np.array([*shapes.centre[k], low])
        if found.is_surveyed and sights.is_base:  # all of it moves by the same cells
            before = np.array([*things.centre[row], element.points[:, 2].min()])
            points = on_grid(element.points + on_grid(middle - before, cell_m), 0.001)
            elements.append(replace(element, points=points))
            continue
        offset = element.points - [*things.centre[row], element.points[:, 2].min()]
        if world.half_m[k].any():
            old = np.stack([things.along[row], [-things.along[row, 1], things.along[row, 0]]])
            new = np.stack([shapes.along[k], [-shapes.along[k, 1], shapes.along[k, 0]]])
            grown = shapes.half_m[k] / np.maximum(things.half_m[row], 1e-3)
            grown = np.where(things.half_m[row] > 0.05, grown, 1.0)
            offset[:, :2] = (offset[:, :2] @ old.T * grown) @ new
        attributes = element.attributes if sights.is_base else {}
        points = on_grid(middle, cell_m) + offset
        elements.append(rounded(replace(element, id=id_of(sights, element), points=points, attributes=attributes)))
    return elements


def stays_as_surveyed(found: Fused, shapes: Shapes) -> Bool[np.ndarray, " n"]:
    """Which things of a surveyed base map lie where it says, as far as drives can tell.

    The middle of what was seen of a thing may be off along it by what was not seen.
    """
    world = found.world
    stays = np.zeros(len(world.kind), dtype=bool)
    if not found.is_surveyed:
        return stays
    rows = np.flatnonzero(world.source[:, 0] == 0)
    surveyed, own = found.drives[0].sights.things, world.source[rows, 1]
    off = shapes.centre[rows] - surveyed.centre[own]
    ahead = surveyed.along[own]
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    off_m = np.abs(np.stack([(off * ahead).sum(axis=1), (off * aside).sum(axis=1)], axis=1))
    off_m[:, 0] -= np.maximum(surveyed.half_m[own, 0] - shapes.half_m[rows, 0], 0.0)
    told_by = np.zeros(len(world.kind), dtype=np.int64)
    for seen in found.seen[1:]:
        told_by[seen.pairs[:, 1]] += 1
    least_m = np.maximum(_TOLD_M, _TOLD_SIGMAS * sigmas_of(found)[rows])
    stays[rows] = (off_m < least_m).all(axis=1) | (told_by[rows] < LEAST_TOLD_BY)
    return stays


def sigmas_of(found: Fused) -> Float[np.ndarray, "n 2"]:
    """How well the sights that count place each thing, along and across [m]; a metre for what no drive saw."""
    information = np.zeros((len(found.world.kind), 2))
    for drive, seen, counted in zip(found.drives, found.seen, counted_sights(found), strict=True):
        noise = stepped(seen.factor[:2]) if found.is_surveyed else seen.factor[:2]
        sigma = drive.sights.things.sigma_m[seen.pairs[counted, 0]] * noise
        np.add.at(information, seen.pairs[counted, 1], sigma**-2.0)
    return np.maximum(np.maximum(information, 1.0) ** -0.5, _LEAST_SIGMA_M)


def beliefs_of(found: Fused, looks: Looks, there: Presence) -> list[Belief]:
    """How sure all drives together are of each thing; under a survey no finer than anybody needs."""
    sigmas, counts, logits = sigmas_of(found), looks.counts, [logit_of(p) for p in there.now.tolist()]
    if found.is_surveyed:
        sigmas, counts = stepped(sigmas), told_number(counts)
        logits = [_GONE_LOGIT if logit < 0.0 else _THERE_LOGIT for logit in logits]
    rows = zip(sigmas.round(3).tolist(), logits, counts.tolist(), strict=True)
    made = [Belief(across, along, logit, *n, provenance=CROWD) for (along, across), logit, n in rows]
    for k in np.flatnonzero(stays_as_surveyed(found, shapes_of(found))).tolist():
        made[k] = surveyed_belief(found.drives[0].sights.things.beliefs[found.world.source[k, 1]], made[k])
    return made


def surveyed_belief(before: Belief, now: Belief) -> Belief:
    """The belief in what stays where a surveyed map has it: that of the map, until it is rather gone than there.

    Certainty that only fades since nobody looks says nothing new.
    """
    if now.existence_logit >= min(before.existence_logit, 0.0):
        return before
    counts = {"num_seen": now.num_seen, "num_missed": now.num_missed}
    return replace(before, existence_logit=now.existence_logit, **counts)


def logit_of(probability: float) -> float:
    """Log odds in steps of a half, no surer than 99.75 %."""
    p = float(np.clip(probability, 1e-6, 1.0 - 1e-6))
    return float(np.clip(np.round(2.0 * np.log(p / (1.0 - p))) / 2.0, -_MOST_LOGIT, _MOST_LOGIT)) + 0.0


def stepped(sigma: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Sigmas in steps of the root of two: what nobody needs to know better does not change with each drive."""
    return np.exp(_SIGMA_STEP * np.ceil(np.log(np.maximum(sigma, _TINY)) / _SIGMA_STEP))


def on_grid(points: np.ndarray, cell_m: float) -> np.ndarray:
    """Points on a grid, in whole millimetres."""
    return np.rint(np.rint(points / cell_m) * cell_m * 1000.0) / 1000.0 + 0.0


def rounded(element: MapElement) -> MapElement:
    """On the grid of the crowd map; widths to the centimetre, lines without vertices that say nothing."""
    points = element.points
    if not element.closed and len(points) > 2:
        points = simplify(points, _THIN_M)
    points = on_grid(points, _CELL_M)
    if not element.closed and len(points) > 1:
        steps = polyline.arc_length(points)
        points = points[np.append(True, np.diff(steps) > 0.0)] if steps[-1] > 0.0 else points
    normal = None if element.normal is None else np.round(element.normal, 3) + 0.0
    sizes = {name: round(getattr(element, name), 3) for name in ("width_m", "radius_m", "radius_top_m", "height_m")}
    return replace(element, points=points, normal=normal, **sizes)
