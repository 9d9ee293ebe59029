"""What is known of one pose beyond its covariance, in lines to print (room: reports).

In: PoseMixture of a localized frame; poses of many draws of the masks' noise. Out: text.
"""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from semloc_jax.analysis.pose_mixture import PoseMixture
    from semloc_jax.analysis.seed_errors import SeedErrors

_DIRECTIONS = (
    ("longitudinal", 0, 100.0, 1, "cm"),
    ("lateral", 1, 100.0, 1, "cm"),
    ("heading", 5, 180.0 / np.pi, 2, "deg"),
)
"""Name, coordinate of the tangent, factor, digits, unit."""


def posterior_text(mixture: "PoseMixture", probability: float = 0.95) -> str:
    """The modes of a pose with their weights, and the interval of each direction about the first one."""
    weights = " ".join(f"{weight:.3f}" for weight in mixture.weight if weight >= 5e-4)
    lines = [f"posterior: {len(mixture.weight)} modes, weights {weights}"]
    for name, direction, scale, digits, unit in _DIRECTIONS:
        low, high = (scale * end for end in mixture.interval(direction, probability))
        lines.append(f"{100 * probability:.0f} % interval of {name}: {low:+.{digits}f} to {high:+.{digits}f} {unit}")
    return "\n".join(lines)


def scatter_text(found: "SeedErrors") -> str:
    """How far the pose of one frame scatters when only the noise of the masks changes."""
    (longitudinal_m, lateral_m, heading_deg), num = found.rms[0], found.error.shape[1]
    return (
        f"{num} draws of a network's noise: RMS error longitudinal {100 * longitudinal_m:.1f} cm, "
        f"lateral {100 * lateral_m:.1f} cm, heading {heading_deg:.2f} deg"
    )
