"""Many drives fused: where everything is, who saw it, which drive cannot be trusted (room: mapping; host).

In: Sights of drives in the order of time, of a base map first where there is one. Out: Fused.
Nothing depends on the order in which drives arrive: everything is done anew from the set of them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.mapping.crowd.bends import judge_bends
from semloc_jax.mapping.crowd.correction import Correction, CorrectionConfig
from semloc_jax.mapping.crowd.joint import JointSolve
from semloc_jax.mapping.crowd.placing import place
from semloc_jax.mapping.crowd.seen import Seen, seen_by
from semloc_jax.mapping.crowd.shared import shared_sigmas
from semloc_jax.mapping.crowd.sights import Sights
from semloc_jax.mapping.crowd.world import CrowdWorld, turned_by
from semloc_jax.mapping.way_sigmas import WaySigmas

Progress = Callable[[Iterable, str], Iterable]
_WIDEN = ((2.0, 1.3), (1.3, 1.0), (1.0, 1.0))
"""By how much the gates are wider while drives still move."""


@dataclass(frozen=True)
class FusionConfig:
    """How drives are fused. All values are ours.

    Args:
        correction: what is known of a drive's error before.
        gate_m: a sight farther from a thing is of another thing; less than what counts as moved.
        turned_deg: a drive whose things are turned against those of all others by more is not calibrated.
        least_shown: a drive that shows a smaller share of what it should, against the median drive, disagrees.
        distrust: by how much such a drive counts less.
    """

    correction: CorrectionConfig = field(default_factory=CorrectionConfig)
    gate_m: float = 0.28
    turned_deg: float = 0.4
    least_shown: float = 0.45
    distrust: float = 25.0


@dataclass(frozen=True)
class Distrusted:
    """A drive that disagrees with all others."""

    name: str
    reason: str


@dataclass(frozen=True)
class Fused:
    """The world and its drives.

    Attributes:
        world: things and lines.
        drives: each with its correction, in the order they were given.
        seen: what each saw.
        distrusted: drives that count less, or not at all, by their place.
        sigmas: how far all that lies around a place may be off together.
    """

    world: CrowdWorld
    drives: list[Correction]
    seen: list[Seen]
    distrusted: dict[int, Distrusted]
    sigmas: WaySigmas

    @property
    def is_surveyed(self) -> bool:
        """Whether all lies in a surveyed base map."""
        return bool(self.drives) and self.drives[0].is_held


def fused(
    sights: list[Sights], config: FusionConfig | None = None, progress: Progress = lambda items, _: items
) -> Fused:
    """Fuses drives.

    Args:
        sights: of each drive, a base map first where there is one.
        config: None for the defaults.
        progress: shows how far it has come.

    Raises:
        SemlocError: no drive, or none fits any other.
    """
    config = config or FusionConfig()
    drives = [Correction(each, config.correction) for each in sights]
    distrusted = _placed(drives, config, progress)
    if len(drives) - len(distrusted) < 1:
        raise SemlocError(f"{len(drives)} drives: none of them fits any other; do they show the same road?")
    for round_ in progress(range(len(_WIDEN)), "fusing"):
        world, seen, solve = _fused_once(drives, distrusted, config, _WIDEN[round_])
    found = _disagreeing(world, drives, seen, distrusted, config)
    if found:
        distrusted |= found
        for widen in _WIDEN[1:]:
            world, seen, solve = _fused_once(drives, distrusted, config, widen)
    return Fused(world, drives, seen, distrusted, shared_sigmas(solve))


def _fused_once(
    drives: list[Correction], distrusted: dict[int, Distrusted], config: FusionConfig, widen: tuple[float, ...]
) -> tuple[CrowdWorld, list[Seen], JointSolve]:
    """Everything that was seen, each thing once, by where the drives lie now; then where they lie by it."""
    world = CrowdWorld()
    for k, drive in enumerate(drives):
        if k not in distrusted:
            world.take(k, drive, config.gate_m * widen[0])
    for k, drive in enumerate(drives):
        if k not in distrusted:
            world.take_parts(k, drive, config.gate_m * widen[0])
    for factor in (*widen, widen[-1]):
        if widen == _WIDEN[-1]:  # before, a sight may still be taken for that of a neighbour
            judge_bends([drive for k, drive in enumerate(drives) if k not in distrusted])
        seen, solve = _solved(world, drives, distrusted, config, factor)
        seen_in = np.zeros((len(world.kind), len(drives)), dtype=bool)
        for k, own in enumerate(seen):
            seen_in[own.pairs[:, 1], k] = True
        # Nothing goes that a base map names: whether it is still there, the looks say.
        twins = world.twins(seen_in, config.gate_m) & ~_is_of_base(world, drives)
        if not twins.any() and factor == widen[-1]:
            break
        world.drop(twins)
    if twins.any():
        seen, solve = _solved(world, drives, distrusted, config, widen[-1])
    return world, seen, solve


def _is_of_base(world: CrowdWorld, drives: list[Correction]) -> np.ndarray:
    return (world.source[:, 0] == 0) & drives[0].sights.is_base


def _solved(
    world: CrowdWorld, drives: list[Correction], distrusted: dict[int, Distrusted], config: FusionConfig, widen: float
) -> tuple[list[Seen], JointSolve]:
    seen = [seen_by(world, drive, config.gate_m * widen) for drive in drives]
    usable = [k for k, drive in enumerate(drives) if k not in distrusted or len(seen[k].pairs)]
    weights = [1.0 / config.distrust if k in distrusted else 1.0 for k in usable]
    solve = JointSolve(world, [drives[k] for k in usable], [seen[k] for k in usable], weights)
    solve.run()
    return seen, solve


def _placed(drives: list[Correction], config: FusionConfig, progress: Progress) -> dict[int, Distrusted]:
    """Lays the drives onto each other one by one; those that fit nowhere."""
    num = [len(drive.sights.things) for drive in drives]
    order = sorted(range(len(drives)), key=lambda k: (not drives[k].sights.is_base, -num[k], k))
    world, lost = CrowdWorld(), {}
    for rank, k in enumerate(progress(order, "placing")):
        if rank and not place(world, drives[k]):
            drives[k].value[:] = 0.0
            lost[k] = Distrusted(drives[k].sights.name, "fits no other drive and not the base map: left out")
            continue
        world.take(k, drives[k], 2.0 * config.gate_m)
        world.take_parts(k, drives[k], 2.0 * config.gate_m)
    return lost


def _disagreeing(
    world: CrowdWorld, drives: list[Correction], seen: list[Seen], known: dict[int, Distrusted], config: FusionConfig
) -> dict[int, Distrusted]:
    """Drives whose things are turned against those of the others, or that show hardly any of them."""
    rows = [k for k, drive in enumerate(drives) if k not in known and not drive.sights.is_base]
    if len(rows) < 3:  # two that disagree do not say which is wrong
        return {}
    turns = {k: _turn_against(world, drives[k], seen[k]) for k in rows}
    typical = float(np.median([turn for turn, _ in turns.values()]))
    shown = {k: len(seen[k].pairs) / max(len(drives[k].sights.things), 1) for k in rows}
    usual = float(np.median(list(shown.values())))
    found = {}
    for k in rows:
        turn, sigma = turns[k]
        name = drives[k].sights.name
        if abs(turn - typical) > max(config.turned_deg, 4.0 * sigma):
            found[k] = Distrusted(name, f"its things are turned by {turn - typical:+.2f} deg against the others")
        elif shown[k] < config.least_shown * usual:
            found[k] = Distrusted(name, f"only {100 * shown[k]:.0f} % of its things are those of others")
    return found if 2 * (len(found) + len(known)) < len(drives) else {}


def _turn_against(world: CrowdWorld, drive: Correction, seen: Seen) -> tuple[float, float]:
    """By how much things of a drive are turned against the world [deg], and the standard error of that."""
    things = drive.sights.things
    i, j = seen.pairs[:, 0], seen.pairs[:, 1]
    is_long = (things.half_m[i, 0] > 0.8) & (things.half_m[i, 0] > 2.0 * things.half_m[i, 1])
    i, j = i[is_long], j[is_long]
    if len(i) < 4:
        return 0.0, 180.0
    along = turned_by(things.along[i], drive.turn(things.centre[i]))
    cross = along[:, 0] * world.along[j, 1] - along[:, 1] * world.along[j, 0]
    turn = -np.degrees(np.arcsin(np.clip(cross * np.sign((along * world.along[j]).sum(axis=1)), -1.0, 1.0)))
    spread = 1.4826 * float(np.median(np.abs(turn - np.median(turn))))
    return float(np.median(turn)), 1.25 * max(spread, 0.1) / np.sqrt(len(turn))
