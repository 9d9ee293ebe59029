"""The one noise model: floors, gains and weights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.residuals.noise import NoiseModel, is_inlier

NOISE = NoiseModel(noise_px=2.0, correlation_px=60.0, ramp_share=0.15)


@pytest.mark.parametrize(("ramp_px", "off_px"), [(8.0, 2.0), (40.0, 6.0)])
def test_gain_counts_independent_observations(ramp_px, off_px):
    """60 px of contour off by one standard deviation cost half a nat, as one observation should."""
    assert NOISE.floor_px(ramp_px) == pytest.approx(off_px)
    assert 60.0 * 0.5 * (off_px / ramp_px) ** 2 * NOISE.gain(ramp_px) == pytest.approx(0.5)


def test_information_is_that_of_the_observations():
    assert NOISE.information_per_px == pytest.approx(NOISE.observations_per_px / 2.0**2)


def test_scatter_widens_and_never_narrows():
    assert NOISE.excess(1.0, 8.0) == 1.0
    assert NOISE.excess(6.0, 8.0) == pytest.approx(3.0)
    assert NOISE.excess(6.0, 40.0) == pytest.approx(1.0)


def test_numbers_arrays_and_traced_values_agree():
    ramps = np.array([3.0, 8.0, 14.0, 40.0])
    plain = [NOISE.gain(float(ramp)) for ramp in ramps]
    assert NOISE.gain(ramps) == pytest.approx(plain)
    assert np.asarray(jax.jit(NOISE.gain)(jnp.asarray(ramps))) == pytest.approx(plain)


def test_a_plain_number_does_not_change_the_type_of_an_array():
    assert (NOISE.floor_px(np.float64(8.0)) * jnp.ones(3, jnp.float32)).dtype == jnp.float32


def test_inliers_are_within_reach():
    assert is_inlier(np.array([-0.94, 0.0, 0.94, 0.96, -1.0])).tolist() == [True, True, True, False, False]


@pytest.mark.parametrize("wrong", [{"noise_px": 0.0}, {"correlation_px": -1.0}, {"ramp_share": float("nan")}])
def test_impossible_noise_is_refused(wrong):
    with pytest.raises(SemlocError, match="above 0"):
        NoiseModel(**wrong)


@pytest.mark.parametrize(("scatter_px", "grain"), [(0.05, 0.2), (0.4, 0.3), (1.0, 0.75), (1.6, 1.0), (5.0, 1.0)])
def test_the_grain_of_masks_follows_their_scatter_and_never_exceeds_the_model(scatter_px, grain):
    assert NoiseModel().grain(scatter_px) == pytest.approx(grain)
    assert float(NoiseModel().grain(jnp.asarray(scatter_px))) == pytest.approx(grain)


def test_fine_masks_hold_more_by_the_cube_of_their_grain():
    # Half the noise is four times the information of an observation, half the correlation twice the observations.
    model, ramp_px = NoiseModel(), 3.0
    assert model.gain(ramp_px, 0.5) == pytest.approx(8.0 * model.gain(ramp_px, 1.0))
