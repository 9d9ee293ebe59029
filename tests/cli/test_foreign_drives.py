"""The verbs on drives of other kinds: bags and folders, with what is wrong told before the work starts."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest

from semloc_jax.cli.main import FAILED, OK, main
from semloc_jax.datasets import open_drive, write_bag
from semloc_jax.evaluation import pose_errors, read_trajectory
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.maps import read_map
from semloc_jax.reports.metrics import shift_text

pytest.importorskip("rosbags")
CLOCK_S = 1.7e9


@pytest.fixture(scope="module")
def bag(simulated_road, tmp_path_factory):
    drive = open_drive(simulated_road)
    path = tmp_path_factory.mktemp("bag") / "drive"
    return write_bag(drive, path, "mcap", read_map(drive.map_path).origin, compressed=True, clock_offset_s=CLOCK_S)


def words(bag, map_path, tmp_path, *more):
    return ["localize", str(bag), "--map", str(map_path), "--masks", "sem", "--class-table", "drive", "--overlays", "0",
            "--hypotheses", "256", "--out", str(tmp_path / "out"), *more]  # fmt: skip


@pytest.mark.slow
def test_a_bag_is_localized_to_centimetres(simulated_road, bag, tmp_path):
    assert main(words(bag, simulated_road / "map.geojson", tmp_path)) == OK
    found = read_trajectory(tmp_path / "out" / "trajectory.tum")
    truth = read_trajectory(simulated_road / "poses_body.tum")
    np.testing.assert_allclose(found.time_s, truth.time_s + CLOCK_S, rtol=0, atol=3e-7)
    errors = pose_errors(found.T_map_base, truth.T_map_base)
    assert np.abs(errors["lateral_m"]).max() < 0.05
    assert np.abs(errors["longitudinal_m"]).max() < 0.2


def test_masks_inside_a_bag_are_those_of_the_folder(simulated_road, bag, tmp_path):
    """Also where a compilation cache is there, in which offsets of mask files are remembered."""
    folder = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    try:
        recorded, drive = open_drive(bag), open_drive(simulated_road)
        ours, theirs = mask_source("sem_net", recorded, table="drive"), mask_source("sem_net", drive)
    finally:
        jax.config.update("jax_compilation_cache_dir", folder)
    assert ours.offset_px == theirs.offset_px
    for a, b in zip(recorded.frames, drive.frames, strict=True):
        assert np.array_equal(ours.masks(a)[0], theirs.masks(b)[0])


def test_a_map_of_another_place_is_told_before_the_work(simulated_road, bag, tmp_path, capsys):
    document = json.loads((simulated_road / "map.geojson").read_text())
    key = next(key for key in document["frame"] if "lat" in key)
    document["frame"][key] += 1.0
    (tmp_path / "map.geojson").write_text(json.dumps(document))
    assert main(words(bag, tmp_path / "map.geojson", tmp_path)) == FAILED
    assert "fixes are 111 km outside of map" in capsys.readouterr().err


def test_fixes_of_another_time_are_told_before_the_work(simulated_road, tmp_path, capsys):
    drive = open_drive(simulated_road)
    late = replace(drive, gnss=replace(drive.gnss, time_s=drive.gnss.time_s + 3600.0))
    origin = read_map(drive.map_path).origin
    bag = write_bag(late, tmp_path / "late", "mcap", origin, compressed=True, clock_offset_s=CLOCK_S)
    assert main(words(bag, drive.map_path, tmp_path)) == FAILED
    assert "have no time in common" in capsys.readouterr().err


def test_a_missing_class_table_is_one_line(simulated_road, bag, tmp_path, capsys):
    options = [w for w in words(bag, simulated_road / "map.geojson", tmp_path) if w not in ("--class-table", "drive")]
    assert main(options) == FAILED
    assert "give --class-table" in capsys.readouterr().err


def test_a_calibration_from_elsewhere(simulated_road, bag, tmp_path, capsys):
    given = ["check-calib", str(bag), "--calib", str(simulated_road / "calib.yaml"), "--out", str(tmp_path)]
    assert main(given) == OK
    assert "front: BrownConradyCamera 480x300 px" in capsys.readouterr().out


def test_a_shift_that_stays_is_told():
    rng = np.random.default_rng(0)
    steady = np.array([1.8, -0.9]) + 0.001 * rng.normal(size=(20, 2))
    assert "+1.8" in shift_text(steady) and "-0.9" in shift_text(steady) and "datum" in shift_text(steady)
    assert shift_text(steady[:4]) is None
    assert shift_text(1.5 * rng.normal(size=(40, 2))) is None  # it wanders
    assert shift_text(np.full((20, 2), 0.1)) is None
