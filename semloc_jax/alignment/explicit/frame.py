"""One frame in a compact map: associate, solve, associate again (room: alignment; host).

In: landmarks, primitives of all cameras, a prior. Out: ExplicitFrame: pose, matches, what was seen and missed.
The way of the literature with few landmarks (Xiao 2018; MLVHM 2020) beside ours with contours.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.alignment.explicit.association import associated
from semloc_jax.alignment.explicit.landmarks import Landmark
from semloc_jax.alignment.explicit.pairs import Match
from semloc_jax.alignment.explicit.pose import ExplicitPose, solved
from semloc_jax.alignment.explicit.prediction import AssociationConfig, Prediction
from semloc_jax.alignment.explicit.sights import ShapeSight, shape_sights
from semloc_jax.cameras import Rig
from semloc_jax.perception.primitives import Primitives
from semloc_jax.structs import SolveStatus


@dataclass(frozen=True)
class ExplicitConfig:
    """How explicit shapes are used. All values are ours."""

    association: AssociationConfig = field(default_factory=AssociationConfig)
    passes: int = 3
    """Shapes are associated again from every solved pose."""
    doubt: float = 2.0
    """Factor on the standard deviations of a solved pose where shapes are associated again."""
    missed_nats: float = 4.0
    """Cost of a landmark that should be seen and is not; one that is seen costs no more."""


class ExplicitFrame(NamedTuple):
    """What a frame says of its pose."""

    pose: ExplicitPose
    matches: tuple[Match, ...]
    expected_px: Float[np.ndarray, " landmark"]
    """Outline of each landmark that should be seen [px]."""
    missed: Float[np.ndarray, " landmark"]
    """Share of it that fits nothing: between 0 (its shape fits) and 1 (there is none)."""
    nats: float
    """Cost of everything that should be seen."""


class SeenShapes(NamedTuple):
    """Shapes of one frame."""

    primitives: tuple[Primitives, ...]
    sights: tuple[ShapeSight, ...]
    rig: Rig

    @classmethod
    def by(cls, rig: Rig, primitives: Sequence[Primitives]) -> "SeenShapes":
        """What the cameras of a rig show."""
        return cls(tuple(primitives), tuple(shape_sights(primitives, rig)), rig)


def explicit_frame(
    seen: SeenShapes,
    landmarks: Sequence[Landmark],
    is_known: Bool[np.ndarray, " landmark"],
    T_prior: Float[np.ndarray, "4 4"],
    sigma: Float[np.ndarray, "6"],
    config: ExplicitConfig,
    start: ExplicitPose | None = None,
) -> ExplicitFrame:
    """The pose near a prior.

    Args:
        seen: Shapes in the masks.
        landmarks: Of the map around, in the local frame.
        is_known: Which of them may move the pose; others are associated only.
        T_prior: Mean of the prior, in the local frame.
        sigma: Its standard deviations (right tangent).
        config: How shapes are used.
        start: A pose that some shapes gave already; None: the prior.
    """
    none = ExplicitPose(T_prior, np.diag(sigma**2), np.zeros(0), SolveStatus.NO_EVIDENCE)
    pose = start or none
    used: list[Match] = []
    for _ in range(config.passes):
        matches = associated(_prediction(pose, sigma, landmarks, seen, config), seen.sights)
        used = [match for match in matches if is_known[match.landmark]]
        if not used:
            pose = none._replace(T_local_base=pose.T_local_base)
            break
        pose = solved(used, landmarks, T_prior, sigma, pose.T_local_base, config.association)
    expected_px = _prediction(pose, sigma, landmarks, seen, config).expected_px(seen.primitives)
    missed = np.ones(len(landmarks))
    missed[[match.landmark for match in matches]] = 0.0
    for match, cost in zip(used, pose.costs, strict=True):
        missed[match.landmark] = min(cost / config.missed_nats, 1.0)
    nats = float(config.missed_nats * missed[expected_px > 0.0].sum())
    return ExplicitFrame(pose, tuple(matches), expected_px, missed, nats)


def _prediction(
    pose: ExplicitPose, sigma: np.ndarray, landmarks: Sequence[Landmark], seen: SeenShapes, config: ExplicitConfig
) -> Prediction:
    covariance = _doubted(pose.covariance, sigma, config.doubt)
    return Prediction(pose.T_local_base, covariance, landmarks, seen.rig, config.association)


def _doubted(
    covariance: Float[np.ndarray, "6 6"], sigma: Float[np.ndarray, "6"], doubt: float
) -> Float[np.ndarray, "6 6"]:
    """Covariance of a solved pose with less belief in the shapes, but all of it in the prior."""
    held = np.diag(1.0 / sigma**2)
    return np.linalg.inv(held + (np.linalg.inv(covariance) - held) / doubt**2)
