"""The rendered road in small masks and with lines, dashes and poles alone, localized frame by frame.

Figures of every third frame are in `notebooks/figures/tracking.md`:
`SEMLOC_EVERY=3 python -m pytest -m slow -s tests/system/test_small_and_sparse.py` prints them.
"""

import json
import os
import shutil

import cv2
import numpy as np
import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.evaluation import pose_errors
from semloc_jax.inputs.priors import prior_source
from semloc_jax.localization.frame_by_frame import localize_frames
from semloc_jax.maps import read_map

pytestmark = [pytest.mark.data, pytest.mark.slow]

_SPARSE = ("lane_solid", "lane_dashed", "pole")
_ROAD, _TREES = 1, 5
_AS_WHAT = {_ROAD: (12, 13, 14, 15, 16), _TREES: (21, 22, 23, 24, 25, 26, 27)}
"""Ids of the drive that are painted over, by what takes their place."""


def by_majority(mask, width, height):
    """A smaller mask; each pixel has the class that most of what it covers has."""
    shares = {
        id_: cv2.resize((mask == id_).astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        for id_ in np.unique(mask)
    }
    return np.array(list(shares), np.uint8)[np.argmax(list(shares.values()), axis=0)]


def copy_of(road_dir, folder, is_small, is_sparse):
    """The drive without images, its masks smaller or with lines and poles alone, and the map as they are."""
    masks = sorted((road_dir / "sem_net").rglob("*.png"))
    folder.mkdir()
    for path in road_dir.iterdir():
        if path.is_file():
            shutil.copy(path, folder)
    other = np.arange(256, dtype=np.uint8)
    for as_what, ids in _AS_WHAT.items():
        other[list(ids)] = as_what
    for path in masks:
        mask = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        mask = by_majority(mask, 400, 250) if is_small else mask
        target = folder / path.relative_to(road_dir)
        target.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(target), other[mask] if is_sparse else mask)
    if is_sparse:
        content = json.loads((folder / "map.geojson").read_text())
        content["features"] = [f for f in content["features"] if f["properties"]["class"] in _SPARSE]
        (folder / "map.geojson").write_text(json.dumps(content))
    return open_drive(folder)


@pytest.mark.parametrize(
    ("is_small", "is_sparse", "least_accepted"), [(True, False, 0.8), (False, True, 0.75), (True, True, 0.7)]
)
def test_no_pose_is_false_and_most_are_accepted(road_dir, tmp_path, is_small, is_sparse, least_accepted):
    drive = copy_of(road_dir, tmp_path / "road", is_small, is_sparse)
    every = int(os.environ.get("SEMLOC_EVERY", "10"))
    semantic_map = read_map(drive.map_path)
    prior = prior_source("truth", drive, 1.0, 3.0) if is_sparse else prior_source("gnss", drive)
    found = localize_frames(drive, semantic_map, "sem_net", prior, slice(None, None, every))
    truth = np.stack([drive.truth_at(result.frame) for result in found])
    errors = pose_errors(np.stack([result.T_map_base for result in found]), truth)
    off = np.abs(np.column_stack([errors["lateral_m"], errors["longitudinal_m"], errors["heading_deg"]]))
    accepted = np.array([result.localized for result in found])
    print(f"small {is_small}, sparse {is_sparse}: {accepted.sum()} of {len(found)}, medians {np.median(off, axis=0)}")
    assert (off[accepted] < [0.5, 1.0, 2.0]).all(), "false"
    assert accepted.mean() >= least_accepted
    assert (np.median(off, axis=0) < [0.02, 0.06, 0.06]).all()
