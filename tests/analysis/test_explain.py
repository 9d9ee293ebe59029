"""Explained poses: shares add up, the solver answers as foretold, what is missing is missed."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from semloc_jax import viz
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.analysis.explain import ExplainConfig, explain_frame
from semloc_jax.analysis.explain_drive import element_roles, is_irreplaceable
from semloc_jax.analysis.influence import PRIOR_PARTS
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.structs import ElementClass, SolveStatus
from semloc_jax.viz.explain import explained_map
from tests.analysis.frame_to_explain import frame_to_explain

pytestmark = pytest.mark.slow  # a quarter of a minute, most of it compilation


@pytest.fixture(autouse=True, scope="module")
def single_precision():
    """As `semloc explain` runs."""
    with jax.enable_x64(False):
        yield


@pytest.fixture(scope="module")
def made(simulated_road):
    """One frame at its true pose, and what explains it; no search, which would take half a minute to compile."""
    given = frame_to_explain(simulated_road)
    return SimpleNamespace(given=given, found=explain_frame(*given), map=given[0].map)


def test_shares_add_up_and_who_moves_everything_moves_the_pose(made):
    found = made.found
    assert found.is_exact
    assert np.abs(100 * found.offset[:2]).max() < 5.0
    np.testing.assert_allclose(sum(holder.share for holder in found.holders), 1.0, atol=1e-5)
    everything = sum(holder.by_shift for holder in found.holders)
    T_base_map = rigid.inverse(found.T_map_base)
    np.testing.assert_allclose(everything[:2], T_base_map[:2, :3], atol=2e-3)
    np.testing.assert_allclose(everything[2], 0.0, atol=2e-3)
    for total in found.classes:
        own = [holder for holder in found.elements if holder.label == total.label]
        np.testing.assert_allclose(total.share, sum(holder.share for holder in own), atol=1e-5)
    assert {holder.id for holder in found.holders if not holder.is_element} == set(PRIOR_PARTS)


def test_the_solver_answers_a_centimetre_as_the_derivative_foretells(made):
    """All elements at once, in its own maps of bytes: correlation above 0.9. What is 1 m off it does not believe."""
    small = explain_frame(*made.given, ExplainConfig(shift_m=0.01)).elements
    linear, shifted = (np.stack([getattr(h, name)[:2] for h in small]).ravel() for name in ("linear", "shifted"))
    assert np.corrcoef(linear, shifted)[0, 1] > 0.9
    far = explain_frame(*made.given, ExplainConfig(shift_m=1.0)).elements
    linear, shifted = (np.stack([getattr(h, name)[:2] for h in far]).ravel() for name in ("linear", "shifted"))
    assert (linear @ shifted) / (linear @ linear) < 0.3


def test_what_is_missing_is_missed(made):
    found = made.found
    assert found.most_missed.id in {holder.id for holder in found.elements}
    longest = max(np.hypot(*holder.removed[:2]) for holder in found.elements)
    assert np.hypot(*found.most_missed.removed[:2]) == longest
    for holder in found.holders:
        assert (holder.sigma_without >= found.sigma * (1 - 1e-5)).all()
    lanes = next(holder for holder in found.classes if holder.label == ElementClass.LANE_MARKING)
    assert lanes.share[1] > 0.2
    assert lanes.sigma_without[1] > 1.1 * found.sigma[1]


def test_roles_in_a_drive_are_means_over_its_frames(made):
    roles = element_roles([made.found, made.found])
    assert sum(role.share for role in roles) == pytest.approx(sum(h.strength for h in made.found.elements))
    assert all(role.num_frames == 2 for role in roles)
    alone = {holder.id for holder in made.found.elements if is_irreplaceable(holder, made.found)}
    assert {role.id for role in roles if role.num_irreplaceable == 2} == alone
    assert roles[0].id == made.found.elements[0].id


def test_the_map_names_what_moves_the_vehicle_and_its_bars_are_full(made):
    around = made.map.query(made.found.T_map_base[:3, 3], 65.0).elements
    figure = explained_map(around, made.found, "title", num_arrows=3)
    above, bars = figure.axes[:2]
    movers = sorted(made.found.elements, key=lambda holder: -np.hypot(*holder.shifted[:2]))[:3]
    named = {text.get_text().split("  ")[0] for text in above.texts if text.get_text()}
    assert named == {holder.id[:20] for holder in movers}
    for k in range(3):
        tops = [bar.get_y() + bar.get_height() for bar in bars.patches if round(bar.get_x() + 0.31) == k]
        assert max(tops) == pytest.approx(100.0)
    assert viz.to_image(figure).std() > 10.0


def test_no_pose_no_explanation(made):
    localizer, result, *rest = made.given
    lost = LocalizationResult(result.frame, np.full((4, 4), np.nan), result.T_map_prior, SolveStatus.NO_EVIDENCE, False)
    with pytest.raises(SemlocError, match="no pose to explain"):
        explain_frame(localizer, lost, *rest)
