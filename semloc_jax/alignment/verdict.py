"""Whether a pose may be used (room: alignment; host).

In: modes of a frame. Out: SolveStatus and reasons. No single number separates good poses from bad ones: cost, coverage,
separation of modes and information decide together.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from semloc_jax.alignment.fault_modes import PLANE, FaultConfig, probabilities
from semloc_jax.alignment.level_choice import INLIER_LIMITS
from semloc_jax.alignment.result import FoundModes, Mode, ModeEvidence
from semloc_jax.evaluation.held import held_directions
from semloc_jax.structs import STATUS_TEXT, SolveStatus


@dataclass(frozen=True)
class VerdictConfig:
    """Limits beyond which a pose is not called localized. All values are ours."""

    max_cost: float = 0.9
    min_inlier_ratio: float = INLIER_LIMITS.single_frame
    min_coverage: float = 0.2
    min_explained: float = 0.35
    """Share of the pieces of map in view that must lie on borders of their class."""
    min_nats_per_piece: float = 0.5
    """Evidence of one piece of map against seeing the map elsewhere: of less, see `min_margin_nats`."""
    min_margin_nats: float = 7.0
    """Where masks hold less for each piece, since they miss much or are coarse, all pieces together must decide: no
    other place of those looked at may hold more than a thousandth of what the pose does, the evidence must exclude
    every other lens (`FaultConfig.excluded_nats`), and kinds of elements must agree (`max_weak_kinds_chi2`). With masks
    of elsewhere the next place is 4 nats behind at most, at right poses 7 to 40; through a wrong lens the evidence
    excludes none."""
    min_weight: float = 0.95
    """Share of the posterior that the best mode must hold against modes elsewhere: of real images for which less was
    stated, one in five was elsewhere."""
    least_rival_weight: float = 0.003
    """Evidence and ramp cost tell the same masks by other means. Where a mode elsewhere has the lower cost and no less
    than this share of the posterior, the two do not agree which is the place: so it was with two of four false poses
    of real images that were accepted, one of them a period of dashes off, and with two of 140 right ones."""
    max_border_offset_px: float = 2.5
    """Borders of the map farther outside or inside of those of the masks do not say where along the road; in pixels of
    an image of usual size."""
    max_kinds_chi2: float = 30.0
    """Lane lines against all else in the map, or what stands against all else: farther apart than this (three degrees
    of freedom), one of both is not where the map says."""
    max_weak_kinds_chi2: float = 11.3
    """The same where masks hold little for each piece: one in a hundred (three degrees of freedom). There kinds may not
    be farther apart than a direction may be unsure, either: pillars that are seen badly contradict nothing."""
    max_lens_nats: float = 3.0
    """Through another lens the frame may fit better by chance; by more than this, the stated one is doubted."""
    min_confirmed: int = 1
    """Other starts whose solves must end at the pose."""
    max_sigma_lateral_m: float = 0.25
    max_sigma_longitudinal_m: float = 0.5
    max_sigma_heading_deg: float = 0.5
    max_prior_share: float = 0.8
    least_prior_m: float = 0.5
    """A sigma along the road of more than this share of the prior's (taken as at least so wide) is the prior's own."""
    max_prior_sigmas: float = 4.0
    """A pose farther from the prior than this was found at the border of the search."""


def judge(
    found: FoundModes, T_map_prior: np.ndarray, sigma_xy_m: float, config: VerdictConfig
) -> tuple[SolveStatus, tuple[str, ...]]:
    """The status of the best mode and every reason not to trust it; no reason means localized.

    Args:
        found: Distinct modes, best first, and how the solve of the best ended.
        T_map_prior: The pose that the search started around.
        sigma_xy_m: Standard deviation that the prior states for its position [m].
        config: Limits.
    """
    status, modes = found.status, found.modes
    if not modes or status in (SolveStatus.NO_EVIDENCE, SolveStatus.NOT_FINITE):
        status = status if status != SolveStatus.CONVERGED else SolveStatus.NO_EVIDENCE
        return status, (STATUS_TEXT[status],)
    reasons = list(_against(found, T_map_prior, sigma_xy_m, config))
    return (reasons[0][0] if reasons else status), tuple(text for _, text in reasons)


def directions_held(
    found: FoundModes, T_map_prior: np.ndarray, sigma_xy_m: float, config: VerdictConfig
) -> tuple[tuple[str, ...], tuple[float, float, float]]:
    """The directions that the masks of a frame hold, though it may not be localized, and the bounds they hold it to.

    Nothing is held where the masks do not show the map, where no second start confirms the pose and at the border of
    the search. A rival adds its distance in each direction: two places along one line hold the place across it.

    Args:
        found: Distinct modes, best first, and how the solve of the best ended.
        T_map_prior: The pose that the search started around.
        sigma_xy_m: Standard deviation that the prior states for its position [m].
        config: Limits.

    Returns:
        Names of directions and lateral [m], longitudinal [m], heading [deg]; infinite where nothing is known.
    """
    limits = (config.max_sigma_lateral_m, config.max_sigma_longitudinal_m, config.max_sigma_heading_deg)
    doubts = {SolveStatus.POOR_FIT, SolveStatus.NO_EVIDENCE, SolveStatus.MAX_STEPS, SolveStatus.AT_SEARCH_BORDER}
    modes = found.modes
    if not modes or found.status in (SolveStatus.NO_EVIDENCE, SolveStatus.NOT_FINITE):
        return (), (np.inf, np.inf, np.inf)
    if not doubts.isdisjoint(status for status, _ in _against(found, T_map_prior, sigma_xy_m, config)):
        return (), (np.inf, np.inf, np.inf)
    best = modes[0]
    bounds = np.array([best.sigma_lateral_m, best.sigma_longitudinal_m, best.sigma_heading_deg])
    for rival in _rivals_of(modes, config):
        step = np.linalg.inv(best.T_map_base) @ rival.T_map_base
        turn_deg = np.degrees(np.arctan2(step[1, 0], step[0, 0]))
        bounds = np.maximum(bounds, np.abs([step[1, 3], step[0, 3], turn_deg]))
    is_open = _is_held_by_prior(best, sigma_xy_m, config) or _is_beside_borders(best, config)
    lateral_m, along_m, heading_deg = bounds.tolist()
    told = (lateral_m, along_m, heading_deg)
    return held_directions(told, limits, ("along",) if is_open else ()), told


Reasons = Iterator[tuple[SolveStatus, str]]


def _against(found: FoundModes, T_map_prior: np.ndarray, sigma_xy_m: float, config: VerdictConfig) -> Reasons:
    """Every reason against the best mode."""
    modes = found.modes
    yield from _fit(modes[0], found.margin_nats, config)
    # A place that holds next to nothing is a doubt about a pose that is held, and none about one that is open.
    rivals, directions = _rivals(modes, config), _directions(modes[0], sigma_xy_m, config)
    first, second = (rivals, directions) if modes[0].weight < config.min_weight else (directions, rivals)
    yield from first
    yield from second
    yield from _faults(found, config)
    if found.status == SolveStatus.MAX_STEPS:
        yield found.status, "no solve of this place converged"
    elif found.confirmed is not None and found.confirmed < config.min_confirmed:
        yield SolveStatus.MAX_STEPS, "no second start found the same pose"
    prior_sigmas = float(np.hypot(*(modes[0].T_map_base - T_map_prior)[:2, 3])) / sigma_xy_m
    if prior_sigmas > config.max_prior_sigmas:
        text = f"{prior_sigmas:.1f} sigmas from the prior, which states {sigma_xy_m:.2g} m: one of both is wrong"
        yield SolveStatus.AT_SEARCH_BORDER, text


def _fit(best: Mode, margin_nats: float, config: VerdictConfig) -> Reasons:
    """Whether the masks show the map at all."""
    if best.coverage < config.min_coverage:
        yield SolveStatus.NO_EVIDENCE, f"only {best.coverage:.0%} of the map in view falls on usable pixels"
    if best.cost > config.max_cost or best.inlier_ratio < config.min_inlier_ratio:
        text = f"cost {best.cost:.2f}, {best.inlier_ratio:.0%} of the map in view explained"
        yield SolveStatus.POOR_FIT, text
    evidence = best.evidence
    if evidence is None:
        return
    is_weak = evidence.nats_per_piece < config.min_nats_per_piece
    text = f"{evidence.explained:.0%} of the map in view on borders of the masks, {evidence.nats_per_piece:.2f} nats"
    if evidence.explained < config.min_explained:
        yield SolveStatus.POOR_FIT, f"{text} a piece"
    elif is_weak and margin_nats < config.min_margin_nats:
        told = f"tell the place from the next one by {margin_nats:.1f} nats, {config.min_margin_nats:g} are asked for"
        yield SolveStatus.POOR_FIT, f"{text} a piece: so weak masks {told}"
    elif is_weak and evidence.lens_left_nats > -FaultConfig.excluded_nats:
        yield SolveStatus.POOR_FIT, f"{text} a piece: so weak masks do not tell the lens from others"
    if _are_kinds_apart(evidence, is_weak, config):
        text = f"{abs(evidence.kinds_left_m):.2f} m across and {abs(evidence.kinds_ahead_m):.2f} m along"
        text += " from where the rest of the map does"
        yield SolveStatus.POOR_FIT, f"lane lines, or posts and signs, put the vehicle {text}: one of both was moved"
    if evidence.lens_nats > config.max_lens_nats:
        text = f"masks fit {evidence.lens_nats:.0f} nats better through {evidence.lens}: calibration or map is wrong"
        yield SolveStatus.POOR_FIT, text


def _are_kinds_apart(evidence: ModeEvidence, is_weak: bool, config: VerdictConfig) -> bool:
    """Whether kinds of elements put the vehicle at two places."""
    if not is_weak:
        return evidence.kinds_chi2 > config.max_kinds_chi2
    is_far = abs(evidence.kinds_left_m) > config.max_sigma_lateral_m
    is_far |= abs(evidence.kinds_ahead_m) > config.max_sigma_longitudinal_m
    return is_far or evidence.kinds_chi2 > config.max_weak_kinds_chi2


def _rivals(modes: tuple[Mode, ...], config: VerdictConfig) -> Reasons:
    """Whether another place explains the frame about as well, and where it is."""
    best, rivals = modes[0], _rivals_of(modes, config)
    if not rivals:
        return
    rival = rivals[0]
    ahead_m, left_m = ((rival.T_map_base - best.T_map_base)[:3, 3] @ best.T_map_base[:3, :2]).tolist()
    text = f"a pose {ahead_m:+.1f} m ahead and {left_m:+.1f} m to the left holds {rival.weight:.0%} of the posterior"
    if best.evidence is not None and rival.evidence is not None:
        text += f" ({rival.evidence.nats - best.evidence.nats:+.1f} nats of the masks)"
    if best.weight >= config.min_weight:
        text += f", and its cost is lower: {rival.cost:.2f} for {best.cost:.2f}"
    yield SolveStatus.AMBIGUOUS, text


def _rivals_of(modes: tuple[Mode, ...], config: VerdictConfig) -> tuple[Mode, ...]:
    """The places that the best one is not told from."""
    best = modes[0]
    if best.weight < config.min_weight:
        least = 0.5 * (1.0 - config.min_weight)
        return tuple(mode for mode in modes[1:] if mode is modes[1] or mode.weight > least)
    least = config.least_rival_weight
    return tuple(mode for mode in modes[1:] if mode.weight >= least and mode.cost < best.cost)


def _directions(best: Mode, sigma_xy_m: float, config: VerdictConfig) -> Reasons:
    """Whether every direction is held, and by the masks."""
    for name, sigma, limit, unit in (
        ("lateral", best.sigma_lateral_m, config.max_sigma_lateral_m, "m"),
        ("longitudinal", best.sigma_longitudinal_m, config.max_sigma_longitudinal_m, "m"),
        ("heading", best.sigma_heading_deg, config.max_sigma_heading_deg, "deg"),
    ):
        if not sigma <= limit:
            yield SolveStatus.WEAK_DIRECTION, f"{name} sigma {sigma:.2f} {unit} exceeds {limit:g} {unit}"
    if _is_held_by_prior(best, sigma_xy_m, config):
        text = f"longitudinal sigma {best.sigma_longitudinal_m:.2f} m is about that of the prior, {sigma_xy_m:.2f} m"
        yield SolveStatus.WEAK_DIRECTION, f"{text}: the masks do not hold it"
    if _is_beside_borders(best, config):
        text = f"the map lies {best.evidence.border_offset_px:+.1f} px outside of the borders of its masks"
        yield SolveStatus.WEAK_DIRECTION, f"{text}: the place along the road is not held"


def _faults(found: FoundModes, config: VerdictConfig) -> Reasons:
    """What takes a direction beyond its limit that would be held had it not to be feared."""
    if found.sound is None or not found.faults:
        return
    heading_rad = np.deg2rad(config.max_sigma_heading_deg)
    most = np.square([config.max_sigma_longitudinal_m, config.max_sigma_lateral_m, heading_rad])
    sound, with_faults = found.sound.diagonal(), found.modes[0].covariance.diagonal()[list(PLANE)]
    if not ((sound <= most) & (with_faults > most)).any():
        return
    share, fault = max(zip(probabilities(found.faults), found.faults, strict=True), key=lambda pair: pair[0])
    ahead_m, left_m, _ = fault.moved
    text = f"the vehicle is {ahead_m:+.2f} m ahead and {left_m:+.2f} m to the left with {fault.cause}"
    yield SolveStatus.WEAK_DIRECTION, f"{text}, which the masks make {share:.0%} probable"


def _is_held_by_prior(best: Mode, sigma_xy_m: float, config: VerdictConfig) -> bool:
    """Whether the place along the road is about as well known as before the frame."""
    held_m = config.max_prior_share * max(sigma_xy_m, config.least_prior_m)
    return held_m < best.sigma_longitudinal_m <= config.max_sigma_longitudinal_m


def _is_beside_borders(best: Mode, config: VerdictConfig) -> bool:
    """Whether the map lies beside the borders of its masks: then they do not say where along the road."""
    return best.evidence is not None and abs(best.evidence.border_offset_px) > config.max_border_offset_px
