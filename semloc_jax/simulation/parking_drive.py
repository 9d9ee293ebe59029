"""How a garage or a lot is driven: rings of aisles, then backing into a slot (room: simulation; host).

In: a ParkingPlan, laps. Out: the way and its time table.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.polyline import arc_length
from semloc_jax.simulation.motion import DrivingStyle, RouteMotion, driven_line, on_table, timed
from semloc_jax.simulation.parking_plan import ParkingPlan
from semloc_jax.simulation.path import PlanePath
from semloc_jax.simulation.slot_rows import SlotRow
from semloc_jax.simulation.surface import Surface

LANE_M = 1.35
"""From the middle of an aisle to the middle of its right lane."""
_TURN_M, _SMOOTH_M = 4.2, 0.7
_REVERSE_M = 4.7
"""Radius of the bend that leads backwards into a slot."""
_DEPTH_M = 4.0
"""From the entrance of a slot to the rear axle of who is parked in it."""
_PARKED_S, _SHIFT_S = 4.0, 1.6
_REVERSE_MPS = 0.9
_BEFORE_M = 9.0


@dataclass(frozen=True)
class Target:
    """The slot that the drive ends in: of a row on the left of an aisle that is driven along x."""

    row: SlotRow
    slot: int
    y_m: float

    @property
    def x_m(self) -> float:
        """Its middle along the aisle."""
        return float(self.row.outline(self.slot)[:2, 0].mean())

    @property
    def num_beside(self) -> tuple[int, ...]:
        """Slots that must be empty: this one and its neighbours."""
        return self.slot - 1, self.slot, self.slot + 1


@dataclass(frozen=True)
class ParkingTour:
    """One drive through a garage or a lot.

    Args:
        motion: where the vehicle is.
        path: line that it drives.
        end_s: time of the last frame: it has stood in the slot for a while.
        reverse_s: time at which it begins to back up.
        target: where it stands in the end.
    """

    motion: RouteMotion
    path: PlanePath
    end_s: float
    reverse_s: float
    target: Target


def choose_target(plan: ParkingPlan, laps: int, rng: np.random.Generator, kept: Collection[str] = ()) -> Target:
    """A slot square to the last aisle of the way, on its left, not the first or last of its row, not one of `kept`.

    Raises:
        SemlocError: obstacles keep all of them free.
    """
    y_m = plan.y_m[last_aisle(plan, laps)]
    fronts = [row for row in plan.rows if row.kind == "perp" and row.along_rad == 0.0 and row.side > 0]
    fronts = [row for row in fronts if abs(row.corner_xy[1] - y_m - 0.5 * plan.aisle_m) < 1e-6 and row.count > 3]
    targets = [Target(row, slot, y_m) for row in fronts for slot in range(1, row.count - 1)]
    targets = [target for target in targets if target.row.slot_id(target.slot) not in kept]
    if not targets:
        raise SemlocError("obstacles stand on every slot that the drive could end in; give another seed")
    return targets[int(rng.integers(len(targets)))]


def last_aisle(plan: ParkingPlan, laps: int) -> int:
    """Number of the aisle along x that a drive ends in; there are slots on its left."""
    return 0 if laps < 2 or len(plan.y_m) < 3 else 1


def drive_parking(
    plan: ParkingPlan, surface: Surface, laps: int, style: DrivingStyle, target: Target, rng: np.random.Generator
) -> ParkingTour:
    """Drive `laps` rings and back into the target."""
    corners = _corners(plan, laps, target)
    forward = _wandering(_rounded(corners), rng)
    backward = _into(target, forward[-1])
    path = _joined(forward, backward)
    shift_m = float(np.linalg.norm(np.diff(forward, axis=0), axis=1).sum())
    first_m, end_m = path.s_m[0], path.s_m[-1]
    shift_m, park_m = on_table(np.array([shift_m, end_m - 0.1]), first_m)
    stops = [(float(shift_m), _SHIFT_S), (float(park_m), _PARKED_S)]
    limits = [(shift_m - 4.0, end_m, _REVERSE_MPS)]
    motion = timed(path, surface, style, stops, (first_m, end_m), first_m + _BEFORE_M, rng, limits)
    reverse_s = float(motion.time_s[np.searchsorted(motion.s_m, shift_m + 0.05)])
    end_s = float(motion.time_s[np.searchsorted(motion.s_m, park_m - 0.03)]) + 0.6 * _PARKED_S
    return ParkingTour(motion, path, end_s, reverse_s, target)


def _corners(plan: ParkingPlan, laps: int, target: Target) -> list[tuple[float, float]]:
    """Corners of the way on the middles of aisles: rings to the left; the last one comes back the other way."""
    left, right, low, high = plan.x_m[0], plan.x_m[-1], plan.y_m[0], plan.y_m[-1]
    inner = plan.y_m[1]
    way = [(left - _BEFORE_M - 3.0, low)]
    for lap in range(laps):
        # Every second ring is a smaller one, so that inner aisles are driven as well.
        top = high if lap % 2 == 0 else inner
        way += [(right, low), (right, top), (left, top)]
        if last_aisle(plan, laps) and lap == laps - 1:
            # Down, along the lowest aisle against its first direction, and up again.
            way[-3:] = [(right, low), (right, high), (left, high), (left, inner), (right, inner), (right, low)]
            way += [(left, low), (left, inner)]
        else:
            way += [(left, low)]
    return [*way, (target.x_m + _REVERSE_M + 1.0, target.y_m)]


def _rounded(corners: Sequence[tuple[float, float]]) -> np.ndarray:
    """The way in the right lane with rounded corners, places 0.1 m apart."""
    nodes = np.array(corners)
    step = np.diff(nodes, axis=0)
    ahead = step / np.linalg.norm(step, axis=1, keepdims=True)
    right = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    line = [nodes[0] + LANE_M * right[0]]
    # Aisles are square to each other: the lanes meet where both offsets are kept.
    turns = zip(nodes[1:-1], right[:-1], right[1:], strict=True)
    line += [node + LANE_M * (before + after) for node, before, after in turns]
    line.append(nodes[-1] + LANE_M * right[-1])
    vertices = np.array(line)
    pieces = [vertices[:1]]
    for corner, before, after in zip(vertices[1:-1], ahead[:-1], ahead[1:], strict=True):
        angle = np.linspace(0.0, 0.5 * np.pi, 24)[:, None]
        center = corner - _TURN_M * before + _TURN_M * after
        pieces.append(center - _TURN_M * after * np.cos(angle) + _TURN_M * before * np.sin(angle))
    return _evenly(np.vstack([*pieces, vertices[-1:]]))


def _evenly(line: np.ndarray) -> np.ndarray:
    s = arc_length(line)
    at = np.linspace(0.0, s[-1], round(s[-1] / 0.1) + 1)
    return np.column_stack([np.interp(at, s, line[:, axis]) for axis in range(2)])


def _wandering(line: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The line smoothed, swaying a little; its last metres straight and in the lane, where the way back begins."""
    fixed = line[-40:].copy()
    line = gaussian_filter1d(line, _SMOOTH_M / 0.1, axis=0, mode="nearest")
    s = 0.1 * np.arange(len(line))
    ahead = np.gradient(line, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    waves = [(size, wave, rng.uniform(0.0, 2.0 * np.pi)) for size, wave in ((0.09, 23.0), (0.06, 11.0))]
    sway = sum(size * np.sin(2.0 * np.pi * s / wave + phase) for size, wave, phase in waves)
    fade = np.clip((s[-1] - 4.0 - s) / 8.0, 0.0, 1.0)
    line = line + (fade * sway)[:, None] * left
    line[-40:] = fixed
    return line


def _into(target: Target, begin: np.ndarray) -> np.ndarray:
    """From the end of the way forward backwards into the slot: a straight, a quarter of a circle, a straight."""
    x_m, y_m = target.x_m, begin[1]
    angle = np.linspace(0.0, 0.5 * np.pi, 60)
    bend = np.column_stack([x_m + _REVERSE_M * (1.0 - np.sin(angle)), y_m + _REVERSE_M * (1.0 - np.cos(angle))])
    end = np.array([[x_m, target.row.corner_xy[1] + _DEPTH_M]])
    line = _evenly(np.vstack([begin[None], bend, end]))
    smooth = gaussian_filter1d(line, _SMOOTH_M / 0.1, axis=0, mode="nearest")
    # The smoothing draws the ends inwards: they stay where the way begins and where the vehicle parks.
    share = np.clip(np.minimum(np.arange(len(line)), np.arange(len(line))[::-1]) / 20.0, 0.0, 1.0)[:, None]
    return share * smooth + (1.0 - share) * line


def _joined(forward: np.ndarray, backward: np.ndarray) -> PlanePath:
    """One path of both; the vehicle keeps its heading where it changes direction."""
    first, second = driven_line(forward), driven_line(backward)
    heading = second.heading_rad + np.pi
    heading = heading - 2.0 * np.pi * np.round((heading[0] - first.heading_rad[-1]) / (2.0 * np.pi))
    s_m = np.concatenate([first.s_m, first.s_m[-1] + second.s_m[1:]])
    return PlanePath(s_m, np.vstack([forward, backward[1:]]), np.concatenate([first.heading_rad, heading[1:]]))
