"""Faults of calibration and map that the drive speaks for (room: localization; host).

In: WatchState. Out: Suspicion: each fault, its size, by how much the drive is better explained, where the pose would
be.
"""

import numpy as np

from semloc_jax.localization.moved_elements import classes_apart
from semloc_jax.localization.other_calibrations import ASIDE, STEPS, WIDTH, alternatives, unit_of
from semloc_jax.localization.stance_sums import height_m
from semloc_jax.localization.watch_config import WatchConfig
from semloc_jax.localization.watch_sums import Suspicion, WatchState, means_of


def suspicions(watch: WatchState, num_cameras: int, config: WatchConfig) -> list[Suspicion]:
    """Every fault that the drive speaks for, the clearest first."""
    if not len(watch.num):
        return []
    found = [*_calibrations(watch, alternatives(num_cameras), config), *classes_apart(watch, config)]
    return sorted(found, key=lambda s: -s.nats)


def _calibrations(watch: WatchState, names: tuple[str, ...], config: WatchConfig) -> list[Suspicion]:
    """Where a parabola through the costs of the calibration and of those beside it has its minimum."""
    found = []
    for k, name in enumerate(names):
        num, gain, moved = means_of(watch, k)
        # All cameras together are weighed only, see `weighed_faults`: one look from one place may like it by 7 nats.
        if name == ASIDE or (num[:2] < 0.5).any():
            continue
        side = int(np.argmax(gain[:2]))
        if num[side + 2] >= 0.5 and gain[side] > 0.0:
            at, better, step = _on_one_side(gain[side], gain[side + 2], moved[side], moved[side + 2])
            at *= STEPS[side]
        else:
            at, better = _between(gain[0], gain[1])
            step = at * 0.5 * (moved[0] - moved[1])
        # Both neighbours say it, as often as they were asked.
        least_nats = _least_of_width(watch, at, config) if name == WIDTH else config.least_gain_nats
        nats = config.share * float(num[:2].sum()) * max(better - least_nats, 0.0)
        found.append(Suspicion(name, at * unit_of(name, config), nats, step))
    return found


def _least_of_width(watch: WatchState, at: float, config: WatchConfig) -> float:
    """What a frame must gain at least by a road that is wider (`at` above 0) or narrower.

    A map that has the road wider than it is makes the vehicle stand higher: both sides then fit, and what lies ahead
    fits from somewhere else along the road.
    """
    return float(np.interp(-np.sign(at) * height_m(watch.stance), config.width_height_m, config.width_gain_nats))


def _between(gain_up: float, gain_down: float) -> tuple[float, float]:
    """Where a parabola through costs at 0, 1 and -1 is least, not beyond these, and what is gained there."""
    slope, bend = 0.5 * (gain_down - gain_up), -0.5 * (gain_up + gain_down)
    at = float(np.clip(-0.5 * slope / bend, -1.0, 1.0)) if bend > 0.0 else -float(np.sign(slope))
    return at, float(-(slope * at + bend * at**2))


def _on_one_side(
    near: float, far: float, moved_near: np.ndarray, moved_far: np.ndarray
) -> tuple[float, float, np.ndarray]:
    """Where a parabola through gains at 0, 1 and 2 is largest, not beyond these, what is gained there, and how far the
    pose moves."""
    bend = 0.5 * (far - 2.0 * near)
    slope = near - bend
    at = float(np.clip(-0.5 * slope / bend, 0.0, 2.0)) if bend < 0.0 else 2.0
    moved = at * moved_near if at <= 1.0 else moved_near + (at - 1.0) * (moved_far - moved_near)
    return at, float(slope * at + bend * at**2), moved
