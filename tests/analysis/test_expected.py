"""What is expected of places before anyone drives there, against the scatter of poses of masks with faults."""

import numpy as np
import pytest

from semloc_jax.analysis.expected import BoundaryNoise
from semloc_jax.analysis.seed_errors import errors_by_seed
from semloc_jax.analysis.survey import Way, survey_ways
from semloc_jax.maps import read_map
from semloc_jax.perception import load_class_table
from semloc_jax.simulation import SimulationConfig, simulate


def test_a_vehicle_scatters_no_more_than_the_prior_says():
    """Height and tilt as vehicles really stand, never more than the prior; the rest as the prior has it."""
    scatter = np.diag(BoundaryNoise(height_m=0.01, roll_pitch_deg=0.5).road_scatter(np.full(6, 0.005)))
    np.testing.assert_allclose(scatter, 1.0)
    scatter = np.diag(BoundaryNoise(height_m=0.01).road_scatter(np.array([1.0, 1.0, 0.02, 0.1, 0.1, 0.0])))
    np.testing.assert_allclose(scatter[[0, 1, 2, 5]], [1.0, 1.0, 0.25, 0.0])
    assert scatter[3] == pytest.approx((np.deg2rad(0.15) / 0.1) ** 2)


@pytest.mark.slow
def test_sigmas_of_a_survey_are_the_scatter_of_poses(tmp_path):
    """Two unseen roads, 20 places, 12 draws of the noise: sigmas of the right size, large where the scatter is."""
    predicted, measured = [], []
    for seed in (81, 82):
        few = SimulationConfig(num_frames=10, rate_hz=1.0, width_px=640, height_px=400, has_images=False)
        drive = simulate("road", seed, tmp_path / str(seed), few)
        road_map = read_map(drive.map_path)
        found = errors_by_seed(drive, road_map, drive.frames, 12)
        way = Way("drive", found.Ts_map_base, np.arange(len(drive.frames), dtype=float))
        predicted.append(survey_ways(road_map, drive.rig, load_class_table("drive"), [way]).ways[0].sigma)
        measured.append(found.rms)
    predicted, measured = np.log(np.concatenate(predicted)), np.log(np.concatenate(measured))
    correlation = [float(np.corrcoef(predicted[:, k], measured[:, k])[0, 1]) for k in range(3)]
    ratio = np.exp(np.median(measured - predicted, axis=0))
    print(f"correlation along, across, heading {np.round(correlation, 2)}; measured / expected {np.round(ratio, 2)}")
    assert correlation[0] > 0.7 and correlation[1] > 0.7
    assert np.all((ratio > 0.6) & (ratio < 1.6))
