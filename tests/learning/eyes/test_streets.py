"""Random streets as lessons: labels of exact masks, scenes on disk, what is held out, a lesson from begin to end."""

import json
from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.errors import SemlocError
from semloc_jax.learning.eyes.batches import CropConfig
from semloc_jax.learning.eyes.street_lesson import class_scores, taught_on_streets
from semloc_jax.learning.eyes.streets import HELD_OUT, TEACHES, StreetsConfig, drawn_scenes, labelled, scenes
from semloc_jax.learning.training import TrainingConfig
from semloc_jax.perception import load_class_table
from semloc_jax.perception.networks.eyes import CELL_PX, REACH_PX, Eyes, Said
from semloc_jax.simulation.streets.views import FINER, StreetView

TABLE = load_class_table("street")
CROPS = CropConfig(size=1, crop_px=(64, 64))
SMALL = StreetsConfig(2, 0, 1, 1, (64, 64), 1, TrainingConfig(num_steps=2, save_every=1), CROPS)


def test_labels_are_exact_within_the_blur_of_a_border():
    """A strip of paint from column 20 to column 31 of the picture, borders included: from 19.5 to 31.5."""
    ids = np.full((64 * FINER, 96 * FINER), CLASS_IDS["road"], np.uint8)
    ids[:, 20 * FINER : 32 * FINER] = CLASS_IDS["crosswalk"]
    image = labelled(StreetView((np.zeros((64, 96, 3), np.uint8),), ids), TABLE)[0]
    u = CELL_PX * np.arange(48) + 0.5 * (CELL_PX - 1)
    expected = np.maximum(19.5 - u, u - 31.5)
    np.testing.assert_allclose(image.signed_px[0, 16], np.clip(expected, -REACH_PX, REACH_PX), atol=0.06)
    assert np.all(image.signed_px[1:] == REACH_PX) and image.known.all()


def test_classes_of_scenes_are_those_that_eyes_tell():
    names = ("lane_solid", "pole", "sign", "traffic_light", "pillar", "vehicle")
    for k, name in enumerate((*names, "ego", "arrow", "slot_line")):
        ids = np.full((64, 64), CLASS_IDS["road"], np.uint8)
        ids[20:40, 20:40] = CLASS_IDS[name]
        image = labelled(StreetView((np.zeros((32, 32, 3), np.uint8),), ids), TABLE)[0]
        shown = [j for j in range(6) if (image.signed_px[j] < 0).any()]
        assert shown == [{6: 5, 7: 0, 8: 0}.get(k, k)]


def test_the_last_scenes_of_each_kind_are_held_out():
    parts = [(entry.is_garage, entry.part) for entry in scenes(StreetsConfig(6, 3, held_out=4))]
    assert parts == [(False, TEACHES)] * 2 + [(False, HELD_OUT)] * 4 + [(True, TEACHES)] * 2 + [(True, HELD_OUT)]
    with pytest.raises(SemlocError, match="fewer streets held out than there are"):
        StreetsConfig(4, held_out=4)


def test_scenes_are_drawn_once(tmp_path):
    first = [views for _, views in drawn_scenes(SMALL, 3, tmp_path)]
    times = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
    again = [views for _, views in drawn_scenes(SMALL, 3, tmp_path)]
    assert len(times) == 2 and times == {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
    np.testing.assert_array_equal(first[1][0].pictures[0], again[1][0].pictures[0])
    listed = json.loads((tmp_path / "manifest.json").read_text())
    assert listed["seed"] == 3 and [scene["part"] for scene in listed["scenes"]] == [TEACHES, HELD_OUT]
    with pytest.raises(SemlocError, match="drawn with other settings"):
        next(drawn_scenes(replace(SMALL, looks=2), 3, tmp_path))


def test_scores_of_what_has_not_learned():
    """It sees nothing: no recall, and distances that are wrong by tens of pixels within a sigma as large."""
    ids = np.full((128, 128), CLASS_IDS["road"], np.uint8)
    ids[:, 40:80] = CLASS_IDS["lane_solid"]
    images = labelled(StreetView((np.zeros((64, 64, 3), np.uint8),), ids), TABLE)
    scores = class_scores(Eyes.new(TABLE, 0), images)
    assert [score.name for score in scores][::5] == ["road_paint", "moving"]
    assert scores[0].recall == 0.0 and scores[0].error_px == pytest.approx(20.0, abs=8.0)


def test_sigmas_are_judged_by_what_is_told(monkeypatch):
    """Borders that are told 1 px off with 1.5 px, eight cells with a border that is not there, and half of the strip of
    which nobody knows: its large sigmas are of no border that is told."""
    ids = np.full((128, 128), CLASS_IDS["road"], np.uint8)
    ids[:, 60:68] = CLASS_IDS["lane_solid"]
    images = labelled(StreetView((np.zeros((64, 64, 3), np.uint8),), ids), TABLE)
    signed = np.moveaxis(images[0].signed_px.astype(np.float32), 0, -1)
    told, log_sigma = signed + 1.0, np.full_like(signed, np.log(1.5))
    told[14:], log_sigma[14:] = 30.0, np.log(60.0)
    told[0, np.flatnonzero(signed[0, :, 0] > 12.0)[:8], 0] = 0.0
    near = int((np.abs(told[..., 0]) < 8.0).sum())
    assert 50 < near < 200
    monkeypatch.setattr(Eyes, "said", lambda self, picture: Said(told, log_sigma, 0.0 * told))
    score = class_scores(Eyes.new(TABLE, 0), images)[0]
    assert score.within == pytest.approx([1.0 - 8 / near] * 3)
    assert score.error_px > 10.0


@pytest.mark.slow
def test_a_lesson_that_stopped_goes_on(tmp_path):
    losses: dict[int, float] = {}
    whole = taught_on_streets(SMALL, tmp_path / "a", on_step=losses.__setitem__)
    (tmp_path / "b").mkdir()
    (tmp_path / "a" / "scenes").rename(tmp_path / "b" / "scenes")
    again = taught_on_streets(SMALL, tmp_path / "b")
    assert sorted(losses) == [1, 2] and all(np.isfinite(list(losses.values())))
    picture = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    np.testing.assert_array_equal(whole.eyes.said(picture).signed_px, again.eyes.said(picture).signed_px)
    assert whole.eyes.card["taught"]["pictures"] == 1 and "road_paint" in whole.eyes.card["held_out"]
