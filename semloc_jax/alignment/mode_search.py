"""How all places that explain a frame are looked for (room: alignment; host).

In: nothing. Out: CompleteModesConfig; FrameImage, what a frame gives to it beyond its cost maps.
"""

from dataclasses import dataclass, field

from semloc_jax.alignment.agreement import AgreementConfig
from semloc_jax.alignment.aliases import AliasConfig
from semloc_jax.alignment.evidence_null import NullConfig
from semloc_jax.alignment.posterior import PosteriorConfig
from semloc_jax.perception.border_distance import BorderDistances

ALIAS_SIGMAS = 5.0
"""Aliases are looked for so many sigmas of the prior away."""


@dataclass(frozen=True)
class CompleteModesConfig:
    """How the places are found and weighed. All values are ours."""

    null: NullConfig = field(default_factory=NullConfig)
    posterior: PosteriorConfig = field(default_factory=PosteriorConfig)
    aliases: AliasConfig = field(default_factory=AliasConfig)
    agreement: AgreementConfig = field(default_factory=AgreementConfig)
    num_samples: int = 2048
    """Map samples of which evidence is counted."""
    window_sigmas: float = 4.0
    least_window_m: float = 4.0
    window_heading_sigmas: float = 3.0
    """Half width of the search in sigmas of the prior, and its least."""
    coarse_scale_px: float = 14.0
    null_every: int = 4
    """Of every so many samples the null is counted: 56 poses give more of them than it needs."""
    num_coarse: int = 16
    """Places of the first look that are solved."""
    apart: float = 1.4
    """Places of the first look are at least this many units apart; see `alignment.same_pose`."""
    num_ridges: int = 16
    """As many more that are ridges of their own (`PosteriorConfig`), else the places along one line would take all;
    twice as many in a wide window."""
    num_ramps: int = 8
    """Places of the search by ramps that are solved."""
    view_samples: int = 512
    """Samples that candidates are solved with; the last solves have all."""
    num_final: int = 4
    """Poses of the best place, and other places, that are solved to the end."""
    least_sigma_m: float = 1.0
    least_sigma_deg: float = 2.0
    """Of the prior of a solve: it must not pull."""
    levels: tuple[int, ...] = (1, 2, 3)
    max_steps: int = 10
    """Levels of the cost maps that candidates are solved on, and most evaluations on each."""
    final_max_steps: int = 40
    final_tolerance: float = 5e-3
    """Of the last solve, which visits the levels of the polish: it must converge."""
    restarts: tuple[int, ...] = (-3, -1, 1, 3)
    """Second starts: steps along each of the two directions that the best pose is held least in."""
    restart_step_m: tuple[float, float] = (0.1, 0.3)
    """Least and largest step, where heading counts as the shift that it makes `lever_m` ahead."""
    lever_m: float = 25.0
    within_nats: float = 12.0
    """Poses of one place that are this close in evidence make up its pose."""


def half_window_m(sigma_xy_m: float, config: CompleteModesConfig) -> float:
    """Half width of the search around a prior [m]."""
    return max(config.window_sigmas * sigma_xy_m, config.least_window_m)


@dataclass(frozen=True)
class FrameImage:
    """What is known of the masks of a frame beyond their cost maps.

    Attributes:
        borders: distances to the borders of their classes.
        size: width and height of the largest mask [px].
        unit_px: `perception.border_distance.pixel_unit` of them.
    """

    borders: BorderDistances
    size: tuple[int, int]
    unit_px: float
