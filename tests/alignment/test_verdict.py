"""When a pose may be used: every limit speaks for itself, in a sentence with its number."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.alignment.result import FoundModes, Mode, ModeEvidence
from semloc_jax.alignment.verdict import VerdictConfig, directions_held, judge
from semloc_jax.evaluation import held_text
from semloc_jax.structs import STATUS_TEXT, SolveStatus

LIMITS = VerdictConfig(
    max_cost=0.75,
    min_coverage=0.2,
    min_inlier_ratio=0.35,
    min_weight=0.6,
    max_sigma_lateral_m=0.25,
    max_sigma_longitudinal_m=0.5,
    max_sigma_heading_deg=0.5,
    max_prior_sigmas=4.0,
)
SEEN = ModeEvidence(60.0, 1.5, 0.8, 0.2, 0.5, -1.0, SolveStatus.CONVERGED)
GOOD = Mode(
    weight=1.0,
    T_map_base=np.eye(4),
    covariance=np.diag(np.array([0.1, 0.02, 0.01, 0.001, 0.001, 0.001]) ** 2),
    score=3.0,
    cost=0.2,
    coverage=0.8,
    inlier_ratio=0.9,
    weak_direction=np.eye(6)[0],
    evidence=SEEN,
)


def verdict(*modes, status=SolveStatus.CONVERGED, away=1.0, sigma_m=2.0, confirmed=3):
    """The verdict with a prior `away` sigmas to the side of the best mode."""
    T_prior = np.eye(4)
    T_prior[1, 3] = away * sigma_m
    return judge(FoundModes(tuple(modes), status, confirmed), T_prior, sigma_m, LIMITS)


def with_sigma(index, sigma):
    covariance = GOOD.covariance.copy()
    covariance[index, index] = sigma**2
    return replace(GOOD, covariance=covariance)


def seen(**values):
    return replace(GOOD, evidence=replace(SEEN, **values))


def far(weight):
    T = np.eye(4)
    T[:2, 3] = 3.0, 4.0
    return replace(GOOD, weight=weight, T_map_base=T)


def test_a_good_pose_has_no_reason_against_it():
    assert verdict(GOOD) == (SolveStatus.CONVERGED, ())


@pytest.mark.parametrize(
    ("mode", "status", "says"),
    [
        (replace(GOOD, coverage=0.19), SolveStatus.NO_EVIDENCE, "19%"),
        (replace(GOOD, cost=0.76), SolveStatus.POOR_FIT, "cost 0.76"),
        (replace(GOOD, inlier_ratio=0.34), SolveStatus.POOR_FIT, "34%"),
        (seen(explained=0.34), SolveStatus.POOR_FIT, "34% of the map"),
        (seen(nats_per_piece=0.49), SolveStatus.POOR_FIT, "0.49 nats a piece"),
        (seen(border_offset_px=-2.6), SolveStatus.WEAK_DIRECTION, "-2.6 px"),
        (seen(kinds_chi2=31.0, kinds_left_m=-0.4), SolveStatus.POOR_FIT, "0.40 m across and 0.00 m along"),
        (seen(lens_nats=3.2, lens="longer lenses"), SolveStatus.POOR_FIT, "3 nats better through longer lenses"),
        (with_sigma(1, 0.26), SolveStatus.WEAK_DIRECTION, "lateral sigma 0.26 m exceeds 0.25 m"),
        (with_sigma(0, 0.51), SolveStatus.WEAK_DIRECTION, "longitudinal sigma 0.51 m exceeds 0.5 m"),
        (with_sigma(5, np.radians(0.6)), SolveStatus.WEAK_DIRECTION, "heading sigma 0.60 deg exceeds 0.5 deg"),
        (with_sigma(1, np.nan), SolveStatus.WEAK_DIRECTION, "lateral sigma nan"),
    ],
)
def test_each_limit_is_a_reason(mode, status, says):
    given, reasons = verdict(mode)
    assert given == status
    assert len(reasons) == 1 and says in reasons[0]


def test_just_inside_of_every_limit_is_good():
    covariance = np.diag(np.array([0.499, 0.249, 0, 0, 0, np.radians(0.499)]) ** 2)
    edge = replace(GOOD, cost=0.75, coverage=0.2, inlier_ratio=0.35, weight=0.6, covariance=covariance)
    assert verdict(edge, replace(far(0.4), cost=0.75), away=4.0) == (SolveStatus.CONVERGED, ())


def test_a_second_place_makes_it_ambiguous():
    status, reasons = verdict(replace(GOOD, weight=0.55), far(0.45))
    assert status == SolveStatus.AMBIGUOUS
    said = "a pose +3.0 m ahead and +4.0 m to the left holds 45% of the posterior (+0.0 nats of the masks)"
    assert reasons == (said,)


def test_a_rival_of_lower_cost_is_not_dismissed_by_the_evidence_alone():
    """Frame 02 of PandaSet 002: 98 % for a place 0.6 m and 3.4 deg off, 1.6 % and a lower cost for the right one."""
    best, rival = replace(GOOD, weight=0.982, cost=0.596), replace(far(0.016), cost=0.578)
    status, reasons = verdict(best, rival)
    assert status == SolveStatus.AMBIGUOUS and "its cost is lower: 0.58 for 0.60" in reasons[0]
    assert verdict(best, replace(rival, cost=0.60))[1] == ()
    assert verdict(best, replace(rival, weight=0.002))[1] == ()
    loose = np.diag([0.9**2, *np.diag(best.covariance)[1:]])
    status, reasons = verdict(replace(best, covariance=loose), rival)
    assert status == SolveStatus.WEAK_DIRECTION and "its cost is lower" in reasons[1]


@pytest.mark.parametrize(
    ("status", "confirmed", "says"),
    [(SolveStatus.MAX_STEPS, 3, "no solve of this place converged"), (SolveStatus.CONVERGED, 0, "no second start")],
)
def test_a_pose_that_no_other_start_finds_is_not_used(status, confirmed, says):
    given, reasons = verdict(GOOD, status=status, confirmed=confirmed)
    assert given == SolveStatus.MAX_STEPS
    assert len(reasons) == 1 and says in reasons[0]


def test_a_sigma_along_the_road_that_is_the_priors_own_is_told():
    status, reasons = verdict(with_sigma(0, 0.45), sigma_m=0.3)
    assert status == SolveStatus.WEAK_DIRECTION
    assert reasons == ("longitudinal sigma 0.45 m is about that of the prior, 0.30 m: the masks do not hold it",)
    assert verdict(with_sigma(0, 0.45), sigma_m=1.0)[0] == SolveStatus.CONVERGED


def test_a_pose_far_from_the_prior_was_found_at_the_border():
    status, reasons = verdict(GOOD, away=4.3)
    assert status == SolveStatus.AT_SEARCH_BORDER
    assert reasons == ("4.3 sigmas from the prior, which states 2 m: one of both is wrong",)


@pytest.mark.parametrize(
    ("margin_nats", "lens_left_nats", "says"),
    [(7.1, -3.1, None), (6.9, -9.0, "the next one by 6.9 nats, 7 are asked for"), (30.0, -2.9, "do not tell the lens")],
)
def test_weak_masks_must_exclude_every_other_place_and_lens(margin_nats, lens_left_nats, says):
    weak = seen(nats_per_piece=0.2, lens_left_nats=lens_left_nats)
    found = FoundModes((weak,), SolveStatus.CONVERGED, 3, margin_nats=margin_nats)
    status, reasons = judge(found, np.eye(4), 2.0, LIMITS)
    for values in ({"kinds_chi2": 11.4}, {"kinds_left_m": -0.26}, {"kinds_ahead_m": 0.51}):
        apart = replace(weak, evidence=replace(weak.evidence, **values))
        assert "one of both was moved" in judge(replace(found, modes=(apart,)), np.eye(4), 2.0, LIMITS)[1][-1]
        strong = replace(apart, evidence=replace(apart.evidence, nats_per_piece=0.6))
        assert judge(replace(found, modes=(strong,)), np.eye(4), 2.0, LIMITS)[1] == ()
    if says is None:
        assert (status, reasons) == (SolveStatus.CONVERGED, ())
    else:
        assert status == SolveStatus.POOR_FIT
        assert len(reasons) == 1 and "0.20 nats a piece" in reasons[0] and says in reasons[0]


def test_all_reasons_are_told_and_the_first_names_the_status():
    status, reasons = verdict(replace(with_sigma(1, 1.0), coverage=0.1, cost=0.9), away=9.0)
    assert status == SolveStatus.NO_EVIDENCE
    assert len(reasons) == 4


@pytest.mark.parametrize("status", [SolveStatus.NO_EVIDENCE, SolveStatus.NOT_FINITE])
def test_a_failed_solve_is_never_localized(status):
    assert verdict(GOOD, status=status) == (status, (STATUS_TEXT[status],))


def test_no_mode_at_all():
    assert verdict() == (SolveStatus.NO_EVIDENCE, (STATUS_TEXT[SolveStatus.NO_EVIDENCE],))
    assert verdict(status=SolveStatus.NOT_FINITE)[0] == SolveStatus.NOT_FINITE


def test_one_mode_without_any_weight_is_judged_by_the_rest():
    """Weights vanish where a covariance is singular; there is no second mode to name."""
    status, reasons = verdict(replace(with_sigma(0, np.nan), weight=0.0))
    assert status == SolveStatus.WEAK_DIRECTION
    assert len(reasons) == 1


def test_every_status_has_its_sentence():
    assert set(STATUS_TEXT) == set(SolveStatus)
    assert all(len(text) > 20 for text in STATUS_TEXT.values())


def held(*modes, sigma_m=2.0, confirmed=3):
    found = FoundModes(tuple(modes), SolveStatus.CONVERGED, confirmed)
    return directions_held(found, np.eye(4), sigma_m, LIMITS)[0]


def test_across_is_held_where_only_the_place_along_the_road_is_open():
    assert held(GOOD) == ("across", "along", "heading")
    assert held(with_sigma(0, 1.5)) == ("across", "heading")
    assert held(seen(border_offset_px=4.0)) == ("across", "heading")
    ahead = far(0.45)
    ahead.T_map_base[1, 3] = 0.0
    assert held(replace(GOOD, weight=0.55), ahead) == ("across", "heading")


def test_nothing_is_held_where_the_masks_do_not_show_the_map_or_nothing_confirms_it():
    assert held(replace(GOOD, cost=0.9)) == ()
    assert held(GOOD, confirmed=0) == ()
    assert held() == ()


def test_what_is_open_is_told_with_what_would_help():
    text = held_text((0.08, 1.4, 0.2), ("across", "heading"))
    assert text.startswith("across held to 0.08 m, heading held to 0.20 deg, along open: signs, posts")
    assert held_text((0.1, 0.2, 0.1), ("across", "along", "heading")) == held_text((9.0, 9.0, 9.0), ()) == ""
