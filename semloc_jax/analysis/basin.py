"""From how far away the right pose is found: success of starts spread over a window (room: analysis; host).

In: frames with truth, a map, masks, windows. Out: one Basin for each window, and a table of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import comb

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.alignment.hypotheses import score
from semloc_jax.alignment.one_start import WIDE_COST_MAPS, LookConfig, OneStartConfig, from_one_start
from semloc_jax.alignment.pose import Prior, in_chunks, total_weight
from semloc_jax.alignment.single_frame import FrameInput, evidence_from
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.metrics import pose_errors
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.inputs.mask_source import MaskSource, mask_source
from semloc_jax.maps import SemanticMap
from semloc_jax.residuals.view import ViewConfig


@dataclass(frozen=True)
class BasinWindow:
    """Half widths of the window around the true pose from which starts are drawn evenly."""

    longitudinal_m: float
    lateral_m: float
    heading_deg: float

    def __str__(self) -> str:
        """The window as a person writes it."""
        place = f"±{self.lateral_m:g} m"
        if self.longitudinal_m != self.lateral_m:
            place += f" lateral, ±{self.longitudinal_m:g} m longitudinal"
        return f"{place}, ±{self.heading_deg:g}°"


WINDOWS = (BasinWindow(1.0, 1.0, 2.0), BasinWindow(2.0, 2.0, 5.0), BasinWindow(5.0, 3.0, 10.0))


@dataclass(frozen=True)
class BasinConfig:
    """How a basin is measured. All values are our choice."""

    num_starts: int = 64
    """Starts in each frame."""
    seed: int = 0
    success_m: float = 0.2
    """A start succeeds if it ends within this distance of the truth in the plane of the road ..."""
    success_deg: float = 0.2
    """... and within this angle of its heading."""
    one_start: OneStartConfig = field(default_factory=OneStartConfig)
    localize: LocalizeConfig = field(default_factory=lambda: LocalizeConfig(cost_maps=WIDE_COST_MAPS))
    """Map query, sampling, cost maps and road."""
    rank_level: int = 5
    """Level of the cost maps on which the ends are scored, seen as from the end."""
    chunk: int | None = None
    """Starts side by side; None for what suits the device."""

    @cached_property
    def start(self) -> OneStartConfig:
        """How a pose is found from one start in the scene."""
        base, scene = self.one_start, self.localize
        return replace(base, view=scene.view_of(base.view), align=scene.align_of(base.align))


PLAIN = BasinConfig(
    one_start=OneStartConfig((LookConfig((0, 1, 2, 3), 0.15, max_steps=8),), ViewConfig(margin_share=0.15)),
    localize=LocalizeConfig(),
    rank_level=2,
)
"""The four levels of a search, descended once: what every hypothesis of a search would do alone."""


@dataclass(frozen=True)
class Basin:
    """What became of every start in one window.

    Attributes:
        window: where the starts were drawn from.
        start_error: longitudinal [m], lateral [m] and heading [deg] of every start against the truth.
        end_error: the same of where it ended.
        score: cost of evidence and road at the end [nats]; what ranks starts without the truth.
        success: whether it ended at the truth.
    """

    window: BasinWindow
    start_error: Float[np.ndarray, "frame start 3"]
    end_error: Float[np.ndarray, "frame start 3"]
    score: Float[np.ndarray, "frame start"]
    success: Bool[np.ndarray, "frame start"]

    @property
    def single(self) -> float:
        """Share of the starts that succeed."""
        return float(np.mean(self.success))

    def best_of(self, count: int) -> float:
        """How often the best scored of `count` starts succeeds: the mean over all choices of `count` from each frame.

        Raises:
            SemlocError: more starts than were drawn.
        """
        total = self.success.shape[1]
        if not 1 <= count <= total:
            raise SemlocError(f"best of {count} starts: expected 1 ... {total}; raise num_starts")
        ranked = np.take_along_axis(self.success, np.argsort(self.score, axis=1, kind="stable"), axis=1)
        # A start is the best of a choice if all others of it rank below.
        chance = np.array([comb(total - 1 - rank, count - 1) / comb(total, count) for rank in range(total)])
        return float(np.mean(ranked @ chance))


def basins_of(
    drive: Drive,
    semantic_map: SemanticMap,
    masks: MaskSource | str,
    windows: Sequence[BasinWindow] = WINDOWS,
    frames: slice | Sequence[Frame] = slice(None, None, 10),
    config: BasinConfig | None = None,
) -> tuple[Basin, ...]:
    """From how far away the true pose is found, for each window.

    A start uses what a vehicle knows: height, roll and pitch are those of the road of the map at its place,
    the map is seen as from there, and the prior is centred on the start and as wide as the window.

    Args:
        drive: A drive with truth.
        semantic_map: Its map.
        masks: Mask folder, segmenter or MaskSource.
        windows: Where the starts are drawn from.
        frames: Which frames.
        config: None for the defaults.

    Raises:
        SemlocError: no frames, no truth, unknown masks.
    """
    config = config or BasinConfig()
    chosen = drive.frames[frames] if isinstance(frames, slice) else tuple(frames)
    if not chosen or not windows:
        raise SemlocError(f"basin of {drive.name}: no frames or no windows chosen; expected at least one of each")
    source = mask_source(masks, drive) if isinstance(masks, str) else masks
    localizer = FrameLocalizer(semantic_map, source.table, config.localize)
    parts: list[list[tuple[np.ndarray, ...]]] = [[] for _ in windows]
    for frame in chosen:
        T_true = drive.truth_at(frame)
        rig = source.seen_by(frame.rig.select(source.cameras))
        inputs, local_map = localizer.prepare(source.masks(frame), rig, T_true)
        for window, part in zip(windows, parts, strict=True):
            Ts_start = draw_starts(T_true, window, semantic_map, config.num_starts, (config.seed, frame.index))
            Ts_end, scores = _solve_all(Ts_start, inputs, local_map.frame, window, config)
            part.append((_errors(Ts_start, T_true), _errors(Ts_end, T_true), scores))
    return tuple(_gathered(window, part, config) for window, part in zip(windows, parts, strict=True))


def basin_table(basins: Sequence[Basin], counts: Sequence[int] = (8, 64)) -> str:
    """A table in Markdown: one row for each window, success of one start and of the best of some."""
    head = ["starts drawn from", "one start", *(f"best of {count}" for count in counts)]
    rows = [[str(b.window), *(f"{100 * share:.1f} %" for share in (b.single, *map(b.best_of, counts)))] for b in basins]
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows))


def draw_starts(
    T_true: Float[np.ndarray, "4 4"],
    window: BasinWindow,
    semantic_map: SemanticMap,
    num: int,
    seed: int | Sequence[int],
) -> Float[np.ndarray, "num 4 4"]:
    """Poses on the road of the map, evenly drawn from a window around a pose; all in the map frame."""
    draw = np.random.default_rng(seed).uniform(-1.0, 1.0, (num, 3))
    ahead, left, turn = (draw * (window.longitudinal_m, window.lateral_m, np.deg2rad(window.heading_deg))).T
    heading = np.arctan2(T_true[1, 0], T_true[0, 0])
    x = T_true[0, 3] + np.cos(heading) * ahead - np.sin(heading) * left
    y = T_true[1, 3] + np.sin(heading) * ahead + np.cos(heading) * left
    return np.stack([semantic_map.road_pose(*place) for place in zip(x, y, heading + turn, strict=True)])


def _solve_all(
    Ts_start: np.ndarray, inputs: FrameInput, local: LocalFrame, window: BasinWindow, config: BasinConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Where every start ends, in the map frame, and its score."""
    road = config.localize.road
    tilt, heading = np.deg2rad(road.roll_pitch_deg), np.deg2rad(window.heading_deg)
    sigma = np.array([window.longitudinal_m, window.lateral_m, road.height_m, tilt, tilt, heading], np.float32)
    ends, scores = _solve(jnp.asarray(local.from_map(Ts_start)), inputs, jnp.asarray(sigma), config)
    return local.to_map(ends), np.asarray(scores, dtype=np.float64)


@partial(jax.jit, static_argnames="config")
def _solve(
    Ts_start: Float[Array, "n 4 4"], inputs: FrameInput, sigma: Float[Array, "6"], config: BasinConfig
) -> tuple[Float[Array, "n 4 4"], Float[Array, " n"]]:
    align, end_view = config.start.align, config.localize.view_of(ViewConfig())
    # One length of map in view for all: the ends are compared by the share of it that they explain.
    in_view_px = total_weight(evidence_from(Ts_start[0], inputs, end_view).views)
    # Where in the window a pose lies says nothing about it: position and heading take no part in the score.
    road_sigma = sigma.at[jnp.array([0, 1, 5])].set(0.0)

    def one(T_start: Array) -> tuple[Array, Array]:
        T_end = from_one_start(T_start, sigma, inputs, config.start)
        seen = evidence_from(T_end, inputs, end_view)
        return T_end, score(T_end, config.rank_level, seen, Prior(T_start, road_sigma), align, in_view_px)

    return in_chunks(one, Ts_start, config.chunk)


def _errors(Ts: np.ndarray, T_true: np.ndarray) -> np.ndarray:
    """Longitudinal [m], lateral [m] and heading [deg], `float[n 3]`."""
    errors = pose_errors(Ts, np.broadcast_to(T_true, Ts.shape))
    return np.stack([errors[key] for key in ("longitudinal_m", "lateral_m", "heading_deg")], axis=1)


def _gathered(window: BasinWindow, parts: list[tuple[np.ndarray, ...]], config: BasinConfig) -> Basin:
    start, end, scores = (np.stack(part) for part in zip(*parts, strict=True))
    near = np.hypot(end[..., 0], end[..., 1]) <= config.success_m
    return Basin(window, start, end, scores, near & (np.abs(end[..., 2]) <= config.success_deg))
