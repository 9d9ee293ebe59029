"""One real image of a motorway camera in its two maps: what a single frame accepts, by how unsure the prior is.

Run alone it prints the table: pytest -m slow -s tests/system/test_gantry_image.py
"""

import numpy as np
import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.evaluation import pose_errors
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.inputs.priors import prior_source
from semloc_jax.localization.frame_by_frame import localize_frames
from semloc_jax.maps import read_map

NUM_SEEDS = {0.5: 10, 2.0: 40, 5.0: 10, 10.0: 10}
"""By sigma of the prior [m]. A frame or two of ten are at the limit, and rounding of another processor decides them."""
LATERAL_M, LONGITUDINAL_M, HEADING_DEG = 0.5, 1.0, 2.0
"""Beyond these a pose is false; the reference itself is good to 0.2 m and 0.3 deg."""
LEAST_SHARE = {("map_true_dashes.geojson", 0.5): 0.9, ("map_true_dashes.geojson", 2.0): 0.9}
LEAST_SHARE["map_true_dashes.geojson", 5.0] = 0.6


def row(drive, semantic_map, source, sigma_m):
    """Accepted, false, and the scatter of what is accepted and right (lateral [m], heading [deg])."""
    results = []
    for seed in range(NUM_SEEDS[sigma_m]):
        results += localize_frames(drive, semantic_map, source, prior_source("truth", drive, sigma_m, seed=seed))
    accepted = [result for result in results if result.localized]
    if not accepted:
        return 0, 0, 0.0, 0.0
    poses = np.stack([result.T_map_base for result in accepted])
    errors = pose_errors(poses, np.stack([drive.truth_at(result.frame) for result in accepted]))
    limits = {"lateral_m": LATERAL_M, "longitudinal_m": LONGITUDINAL_M, "heading_deg": HEADING_DEG}
    right = np.all([np.abs(errors[key]) <= limit for key, limit in limits.items()], axis=0)
    scatter = [float(np.std(errors[key][right])) if right.any() else 0.0 for key in ("lateral_m", "heading_deg")]
    return len(accepted), int((~right).sum()), *scatter


@pytest.mark.slow
@pytest.mark.parametrize("map_name", ["map_true_dashes.geojson", "highway_north_without_last_geometry.xodr"])
def test_no_prior_leads_to_a_false_pose(data_dir, map_name):
    folder = data_dir / "providentia_a9_s40"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    drive, semantic_map = open_drive(folder / "drive"), read_map(folder / map_name)
    source = mask_source("classical", drive)
    print(f"\n{map_name}\n| sigma of the prior | accepted | false | scatter |\n|---|---|---|---|")
    for sigma_m, num_seeds in NUM_SEEDS.items():
        accepted, false, lateral_m, heading_deg = row(drive, semantic_map, source, sigma_m)
        print(f"| {sigma_m:g} m | {accepted} of {num_seeds} | {false} | {lateral_m:.3f} m, {heading_deg:.2f} deg |")
        assert false == 0
        assert accepted >= LEAST_SHARE.get((map_name, sigma_m), 0.0) * num_seeds
