"""Numbers of a configuration that cannot be meant are refused with the name of their option."""

import dataclasses

import pytest

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.alignment.verdict import VerdictConfig
from semloc_jax.datasets import open_drive
from semloc_jax.errors import SemlocError, UsageError
from semloc_jax.inputs.priors import prior_source
from semloc_jax.inputs.settings_check import require_plausible
from semloc_jax.localization.localizer import TrackConfig
from semloc_jax.simulation import SimulationConfig


@pytest.mark.parametrize("settings", [LocalizeConfig(), TrackConfig(), SimulationConfig()])
def test_defaults_are_meant(settings):
    require_plausible(settings)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("max_cost", float("nan"), "--verdict.max-cost nan: expected a finite number"),
        ("max_cost", float("inf"), "expected a finite number"),
        ("max_sigma_lateral_m", -1.0, "--verdict.max-sigma-lateral-m -1.0: expected more than 0"),
    ],
)
def test_a_limit_that_limits_nothing_is_refused(field, value, words):
    settings = dataclasses.replace(LocalizeConfig(), verdict=dataclasses.replace(VerdictConfig(), **{field: value}))
    with pytest.raises(UsageError, match=words):
        require_plausible(settings, "--")


@pytest.mark.parametrize("count", [0, -5, 1_000_000_000])
def test_numbers_of_hypotheses_have_both_limits(count):
    settings = LocalizeConfig()
    settings = dataclasses.replace(settings, search=dataclasses.replace(settings.search, num_hypotheses=count))
    with pytest.raises(UsageError, match=r"search\.num-hypotheses .*: expected at (least 1|most)"):
        require_plausible(settings, "--")


@pytest.mark.parametrize("rate_hz", [-1.0, float("nan"), float("inf")])
def test_rates_are_positive(rate_hz):
    with pytest.raises(UsageError, match="rate-hz"):
        require_plausible(dataclasses.replace(SimulationConfig(), rate_hz=rate_hz))


@pytest.mark.parametrize("sigma", [0.0, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["sigma_xy_m", "sigma_heading_deg"])
def test_zero_is_no_default_of_a_sigma(simulated_road, sigma, name):
    with pytest.raises(SemlocError, match="expected a positive number"):
        prior_source("truth", open_drive(simulated_road), **{name: sigma})
