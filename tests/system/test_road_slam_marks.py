"""How well the forest of Road-SLAM tells marks apart: simulated marks of another seed, and those of rendered drives.

`python -m pytest -m slow -s tests/system/test_road_slam_marks.py` prints the tables of FIGURES.
"""

import numpy as np
import pytest
import shapely

from semloc_jax.datasets import open_drive
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.mapping.literature.mark_forest import MarkForest, simulated_marks
from semloc_jax.mapping.literature.mark_views import MarkViews
from semloc_jax.maps import read_map
from semloc_jax.maps.contours import painted_polygon
from semloc_jax.simulation.mark_samples import MarkKind
from semloc_jax.structs import ElementClass
from tests.mapping.mark_scores import f1_scores

pytestmark = pytest.mark.slow
_SURE = 0.7
"""A piece that lies less than this on paint of one class joins several, and has no class."""


@pytest.fixture(scope="module")
def forest():
    pytest.importorskip("sklearn", reason="scikit-learn, the extra roadslam, is not installed")
    return MarkForest.grown()


def told(title, true, found):
    scores = f1_scores(true, found)
    print(f"\n{title}: {len(true)} marks\nclass            n  precision   recall       F1")
    for kind, (num, precision, recall, f1) in scores.items():
        print(f"{kind.name.lower():<12}{num:6d}{precision:11.3f}{recall:9.3f}{f1:9.3f}")
    mean = float(np.mean([row[3] for row in scores.values() if row[0]]))
    print(f"mean F1 {mean:.3f}, right {np.mean(true == found):.3f}")
    return mean


def true_kind(label, style):
    if label == ElementClass.LANE_MARKING and style == "dashed":
        return MarkKind.DASHED_LANE
    named = {ElementClass.ROAD_MARK: MarkKind.ARROW, ElementClass.CROSSWALK: MarkKind.CROSSWALK}
    return named.get(label, MarkKind.OTHER)


def rendered(forest, folder, masks_name, step):
    """Classes of the whole pieces of a drive by its map, and by the forest."""
    drive = open_drive(folder)
    views = MarkViews(drive, mask_source(masks_name, drive))
    elements = [e for e in read_map(drive.map_path).elements if not e.is_logical and painted_polygon(e).area > 0]
    tree = shapely.STRtree([painted_polygon(e) for e in elements])
    kinds = np.array([int(true_kind(e.label, e.style)) for e in elements])
    true, marks = [], []
    for frame in drive.frames[::step]:
        T = drive.truth_at(frame)
        for mark in views.of(frame).marks:
            if not mark.is_whole or mark.size_m[0] > forest.config.marks.max_length_m:
                continue
            xy = mark.xy @ T[:2, :2].T + T[:2, 3]
            point, polygon = tree.query(shapely.points(xy), predicate="dwithin", distance=0.15)
            share = np.array([len(np.unique(point[kinds[polygon] == int(kind)])) for kind in MarkKind]) / len(xy)
            if share.max() < _SURE and share.sum() > 1 - _SURE:
                continue
            true.append(int(np.argmax(share)) if share.max() >= _SURE else int(MarkKind.NONE))
            marks.append(mark)
    return np.array(true), forest.kinds(marks)


def test_marks_of_another_seed(forest):
    marks, true = simulated_marks(100, seed=1)
    assert told("simulated, held out", true, forest.kinds(marks)) >= 0.95


@pytest.mark.parametrize("name", ["rendered_road", "rendered_garage"])
def test_arrows_of_rendered_drives_are_found(forest, data_dir, name):
    """What it takes for arrows beside them is in the table: entrance bars of slots are dashes by their shape."""
    if not (data_dir / name).is_dir():
        pytest.skip(f"no drive {name} in {data_dir}")
    true, found = rendered(forest, data_dir / name, "sem", 3)
    told(f"{name}, sem", true, found)
    is_arrow = true == int(MarkKind.ARROW)
    assert is_arrow.sum() >= 5
    assert np.mean(found[is_arrow] == int(MarkKind.ARROW)) >= 0.9
