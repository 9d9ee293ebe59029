"""Covariances with correlated residuals: as often right as they say; mixtures over modes against sampling."""

import numpy as np
import pytest

from semloc_jax.analysis.expected import TANGENT_OF_DIRECTION, ExpectedConfig
from semloc_jax.analysis.pose_mixture import frame_mixture, laplace_mixture
from semloc_jax.analysis.seed_errors import noisy_solves
from semloc_jax.analysis.uncertainty import BoundaryResiduals, boundary_residuals, sandwich_covariance
from semloc_jax.datasets import open_sequence
from semloc_jax.datasets.synthetic import SimulationConfig, simulate
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.metrics import pose_errors
from semloc_jax.geometry import rigid
from semloc_jax.localization import mask_source
from semloc_jax.localization.priors import PosePrior
from semloc_jax.localization.run import FrameLocalizer, LocalizeConfig
from semloc_jax.maps import read_map
from semloc_jax.residuals.view import view

Z = {0.68: 0.9945, 0.95: 1.96, 0.997: 2.9677}
"""Standard deviations that hold these shares of a normal distribution."""


def _made_up(rng) -> tuple[BoundaryResiduals, np.ndarray]:
    """Ten straight contours in one image whose boundaries a smooth field and pixels displace; the pose's error.

    The pose is solved linearly, as the solver would for residuals that are small against the ramp.
    """
    start, angle = rng.uniform([0, 0], [900, 600], (10, 2)), rng.uniform(0, np.pi, 10)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    uv = (start[:, None] + np.arange(0, 96, 6.0)[:, None] * along[:, None]).reshape(-1, 2)
    normal = np.repeat(np.stack([-along[:, 1], along[:, 0]], axis=-1), 16, axis=0)
    # A turn moves the image sideways, a step moves it away from its middle, and so on: six smooth fields.
    x, y = ((uv - [450.0, 300.0]) / 300.0).T
    fields = [(x, y), (1 + 0 * x, y * x), (x * y, 1 + y), (-y, x), (0.5 * x, 1 - y), (1 + x * x, 0.3 * y)]
    slope = 60.0 * np.stack([normal[:, 0] * a + normal[:, 1] * b for a, b in fields], axis=-1)
    apart = np.linalg.norm(uv[:, None] - uv[None], axis=-1)
    K = (normal @ normal.T) * 0.03 * np.exp(-apart / 20.0) + 0.2 * np.eye(len(uv))
    error = np.linalg.cholesky(K) @ rng.normal(size=len(uv))
    weight = np.full(len(uv), 6.0 / 240.0)
    normal_matrix = (slope.T * weight) @ slope + np.eye(6)
    xi = -np.linalg.solve(normal_matrix, slope.T @ (weight * error) + rng.normal(size=6))
    left = error + slope @ xi
    number = np.repeat(np.arange(10), 16)
    return BoundaryResiduals(slope, left, left / 30.0, weight, uv, normal, 0 * number, number), xi


def test_six_sigmas_are_right_where_the_field_is_known():
    """200 made-up images: 68, 95 and 99.7 % within 3 points, and the naive inverse is far too careful."""
    rng, shares, naive = np.random.default_rng(0), [], []
    for _ in range(200):
        residuals, xi = _made_up(rng)
        found = sandwich_covariance(residuals, np.ones(6))
        shares.append(np.abs(xi) / np.sqrt(np.diag(found.covariance)))
        naive.append(np.abs(xi) / np.sqrt(np.diag(found.naive)))
    for share, limit in Z.items():
        assert np.mean(np.array(shares) < limit) == pytest.approx(share, abs=0.03)
    assert np.mean(np.array(naive) < 1.0) > 0.8


@pytest.mark.slow
def test_coverage_on_hundreds_of_simulated_scenes(tmp_path):
    """Poses in masks with a network's faults, on roads that nothing was chosen on: no share is below what is promised.

    The sigmas are less than half of the naive ones and still careful: 81 % of 300 scenes are within one of them, 98 %
    within two. Scaled to be right on average, the naive ones would be no worse.
    """
    prior, config, stated, naive, errors = ExpectedConfig().prior_sigma, LocalizeConfig(), [], [], []
    settings = config.frame
    for seed in (61, 62, 63):
        few = SimulationConfig(num_frames=10, rate_hz=1.0, width_px=640, height_px=400, has_images=False)
        drive = simulate("road", seed, tmp_path / str(seed), few)
        road_map = read_map(drive.map_path)
        for frame in drive.frames:
            for solve in noisy_solves(drive, road_map, frame, 10):
                T, inputs = solve.T_local, solve.inputs
                seen = view(inputs.samples, T, inputs.rig, inputs.channel_of_label, settings.polish_view)
                texture = inputs.textures.level(settings.polish_align.levels[-1])
                residuals = boundary_residuals(T, inputs.rig, seen, texture, inputs.usable, settings.polish_align)
                found = sandwich_covariance(residuals, prior)
                error = pose_errors(solve.T_map_base[None], drive.truth_at(frame)[None])
                errors.append([error["longitudinal_m"][0], error["lateral_m"][0], np.deg2rad(error["heading_deg"][0])])
                for rows, C in ((stated, found.covariance), (naive, found.naive)):
                    rows.append(np.sqrt(np.diag(C))[TANGENT_OF_DIRECTION])
    errors, stated, naive = (np.array(part) for part in (errors, stated, naive))
    z = np.abs(errors) / stated
    coverage = {share: float(np.mean(z < limit)) for share, limit in Z.items()}
    print(f"{len(errors)} scenes, coverage {coverage}, naive / stated sigma {np.median(naive / stated):.2f}")
    for share, found in coverage.items():
        assert share - 0.03 <= found <= share + 0.15
    assert np.median(naive / stated) > 2.0


def _two_modes():
    Ts = np.stack([np.eye(4), rigid.exp(np.array([4.0, 0.3, 0.0, 0.0, 0.0, 0.05]))])
    C = np.stack([np.diag(np.array([0.1, 0.05, 0.02, 0.01, 0.01, 0.01]) ** 2) * scale for scale in (1.0, 9.0)])
    return Ts, C


def test_a_broad_mode_weighs_by_its_volume():
    """Three times as wide in all six directions is 3^6 times the mass at the same score: ln 729 nats even it out."""
    Ts, C = _two_modes()
    np.testing.assert_allclose(laplace_mixture([5.0, 5.0], Ts, C).weight, [729 / 730, 1 / 730], rtol=1e-9)
    np.testing.assert_allclose(laplace_mixture([5.0, 5.0 + np.log(729.0)], Ts, C).weight, [0.5, 0.5], rtol=1e-9)
    with pytest.raises(SemlocError, match="at least one pose"):
        laplace_mixture([], np.zeros((0, 4, 4)), np.zeros((0, 6, 6)))


def test_moments_and_intervals_are_those_of_samples():
    """100,000 draws of the mixture: mean, covariance and the 90 % interval along the road within a percent."""
    Ts, C = _two_modes()
    mixture = laplace_mixture([5.0, 5.0 + np.log(729.0) + np.log(3.0)], Ts, C)
    rng = np.random.default_rng(4)
    second = rng.random(100_000) < mixture.weight[1]
    means, covariances = mixture.about_best()
    draws = np.where(second[:, None], *(
        rng.multivariate_normal(means[k], covariances[k], len(second)) for k in (1, 0)
    ))  # fmt: skip
    mean, covariance = mixture.moments()
    np.testing.assert_allclose(mean, draws.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(np.diag(covariance), draws.var(axis=0), rtol=0.02)
    low, high = mixture.interval(0, 0.9)
    assert np.mean((draws[:, 0] > low) & (draws[:, 0] < high)) == pytest.approx(0.9, abs=0.005)
    assert high > 3.5 and low < 0.0
    best = mixture.log_density(mixture.Ts_map_base[0])
    assert best > mixture.log_density(rigid.exp(np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0]))) + 10.0
    with pytest.raises(SemlocError, match=r"such as 0\.95"):
        mixture.interval(0, 95.0)


@pytest.mark.slow
def test_the_posterior_of_a_frame(simulated_road):
    """One localized frame: the heaviest mode is at the truth, all weights sum to one, sigmas are centimetres."""
    drive = open_sequence(simulated_road)
    frame, source = drive.frames[2], mask_source("sem", drive)
    masks, rig = source.masks(frame), source.seen_by(frame.rig.select(source.cameras))
    localizer = FrameLocalizer(read_map(drive.map_path), source.table)
    T = drive.truth_at(frame)
    heading = float(np.arctan2(T[1, 0], T[0, 0]))
    result = localizer.localize(frame, masks, PosePrior(T[0, 3] + 0.5, T[1, 3] - 0.3, heading, 1.0, 0.05), rig)
    mixture = frame_mixture(localizer, result, masks, rig, ExpectedConfig().prior_sigma)
    assert mixture.weight.sum() == pytest.approx(1.0)
    error = pose_errors(mixture.Ts_map_base[:1], T[None])
    assert abs(error["lateral_m"][0]) < 0.02 and abs(error["longitudinal_m"][0]) < 0.10
    sigma_m = np.sqrt(np.diag(mixture.covariance[0]))[:2]
    assert np.all((sigma_m > 1e-4) & (sigma_m < 0.3))
