"""Whether a pose may be used (room: alignment; host).

In: modes of a frame. Out: SolveStatus and reasons. No single number separates good poses from bad ones: cost, coverage,
separation of modes and information decide together.
"""

from dataclasses import dataclass

import numpy as np

from semloc_jax.alignment.result import Mode
from semloc_jax.structs import STATUS_TEXT, SolveStatus


@dataclass(frozen=True)
class VerdictConfig:
    """Limits beyond which a pose is not called localized. All values are ours."""

    max_cost: float = 0.78
    min_coverage: float = 0.2
    min_inlier_ratio: float = 0.28
    min_weight: float = 0.6
    """Share of the posterior that the best mode must hold against modes elsewhere."""
    max_sigma_lateral_m: float = 0.25
    max_sigma_longitudinal_m: float = 0.5
    max_sigma_heading_deg: float = 0.5
    max_prior_sigmas: float = 4.0
    """A pose farther from the prior than this was found at the border of the search."""


def judge(
    status: SolveStatus, modes: tuple[Mode, ...], prior_sigmas: float, config: VerdictConfig
) -> tuple[SolveStatus, tuple[str, ...]]:
    """The status of the best mode and every reason not to trust it; no reason means localized.

    Args:
        status: How the solve of the best mode ended.
        modes: Distinct modes, best first.
        prior_sigmas: Horizontal distance of the best mode to the prior, in its sigmas.
        config: Limits.
    """
    if not modes or status in (SolveStatus.NO_EVIDENCE, SolveStatus.NOT_FINITE):
        status = status if status != SolveStatus.CONVERGED else SolveStatus.NO_EVIDENCE
        return status, (STATUS_TEXT[status],)
    best = modes[0]
    found: list[tuple[SolveStatus, str]] = []
    if best.coverage < config.min_coverage:
        found.append((SolveStatus.NO_EVIDENCE, f"only {best.coverage:.0%} of the map in view falls on usable pixels"))
    if best.cost > config.max_cost or best.inlier_ratio < config.min_inlier_ratio:
        text = f"cost {best.cost:.2f}, {best.inlier_ratio:.0%} of the map in view explained"
        found.append((SolveStatus.POOR_FIT, text))
    if best.weight < config.min_weight and len(modes) > 1:
        away_m = np.hypot(*(modes[1].T_map_base - best.T_map_base)[:2, 3])
        found.append(
            (SolveStatus.AMBIGUOUS, f"a pose {away_m:.1f} m away holds {modes[1].weight:.0%} of the posterior")
        )
    for name, sigma, limit, unit in (
        ("lateral", best.sigma_lateral_m, config.max_sigma_lateral_m, "m"),
        ("longitudinal", best.sigma_longitudinal_m, config.max_sigma_longitudinal_m, "m"),
        ("heading", best.sigma_heading_deg, config.max_sigma_heading_deg, "deg"),
    ):
        if not sigma <= limit:
            found.append((SolveStatus.WEAK_DIRECTION, f"{name} sigma {sigma:.2f} {unit} exceeds {limit:g} {unit}"))
    if prior_sigmas > config.max_prior_sigmas:
        found.append((SolveStatus.AT_SEARCH_BORDER, f"{prior_sigmas:.1f} sigmas from the prior"))
    return (found[0][0] if found else status), tuple(text for _, text in found)
