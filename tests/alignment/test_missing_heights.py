"""A map without heights on a hilly road: what lies far away counts less, and the sigmas hold."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.localization.frame_by_frame import localize_frames
from semloc_jax.maps import SemanticMap, read_map, sampling
from semloc_jax.simulation import SimulationConfig, road, simulate
from semloc_jax.simulation.surface import rolling_surface


def _hills(rng: np.random.Generator):
    """Crests and sags of about 800 m radius, twice as high as those of other simulated roads."""
    surface = rolling_surface(rng, grade=0.04)
    return replace(surface, amplitude_m=2.0 * surface.amplitude_m)


def _flattened(hilly: SemanticMap) -> SemanticMap:
    """The map without heights; what stands keeps its height over the road."""

    def flat(points: np.ndarray, is_painted: bool) -> np.ndarray:
        road_m = hilly.ground.plane(points[0, :2], 15.0).height_at(points[:1, :2])
        return np.column_stack([points[:, :2], np.zeros(len(points)) if is_painted else points[:, 2] - road_m])

    return hilly.with_elements(
        replace(e, points=flat(e.points, e.is_painted), has_height=False) for e in hilly.elements
    )


def _errors(drive, semantic_map) -> tuple[np.ndarray, np.ndarray]:
    """Error along, across [m] and in heading [deg] of each frame, `[n 3]`, and the normalised squared errors `[n]`."""
    errors, squares = [], []
    for result in localize_frames(drive, semantic_map, "sem_net", "truth"):
        truth, found = drive.truth_at(result.frame), result.T_map_base
        step = truth[:2, 3] - found[:2, 3]
        turn = np.arctan2(truth[1, 0], truth[0, 0]) - np.arctan2(found[1, 0], found[0, 0])
        error = np.append(found[:2, :2].T @ step, (turn + np.pi) % (2 * np.pi) - np.pi)
        covariance = result.modes[0].covariance[np.ix_([0, 1, 5], [0, 1, 5])]
        errors.append(error * [1.0, 1.0, np.degrees(1.0)])
        squares.append(error @ np.linalg.solve(covariance, error) / 3.0)
    return np.array(errors), np.array(squares)


@pytest.mark.slow
def test_unknown_heights_count_less_where_they_matter(tmp_path, monkeypatch):
    monkeypatch.setattr(road, "rolling_surface", _hills)
    config = SimulationConfig(num_frames=40, rate_hz=1.0, width_px=640, height_px=400, has_images=False)
    drive = simulate("road", 21, tmp_path, config)
    flat = _flattened(read_map(drive.map_path))
    error, nees = _errors(drive, flat)
    monkeypatch.setattr(sampling, "height_sigmas", lambda elements: np.zeros((len(elements), 3)))
    ignored, ignored_nees = _errors(drive, flat)
    rms, ignored_rms = np.sqrt(np.mean(error**2, axis=0)), np.sqrt(np.mean(ignored**2, axis=0))
    assert (rms < [0.12, 0.025, 0.12]).all()
    assert (rms < [0.95, 0.99, 1.0] * ignored_rms).all()
    assert np.mean(nees) < 0.7 < 0.9 < np.mean(ignored_nees)
