"""`semloc obstacles` on the shared lot: cones, locks and signs of many frames within centimetres."""

import csv
import json

import pytest

from semloc_jax.cli.main import main
from semloc_jax.learning.obstacle_lesson import judged
from semloc_jax.perception.networks.obstacle_net import ObstacleNet
from semloc_jax.reports.obstacle_learning import obstacle_views

pytestmark = pytest.mark.usefixtures("single_precision")


@pytest.fixture
def lot(data_dir):
    """The shared lot: four fisheyes, 40 frames, searching and backing in."""
    folder = data_dir / "lot_seed4"
    if not folder.is_dir():
        pytest.skip(f"no drive lot_seed4 in {data_dir}")
    return folder


def _numbers(folder):
    return {m["key"]: m["value"] for m in json.loads((folder / "metrics.json").read_text())["metrics"]}


def test_obstacles_of_a_few_frames(lot, tmp_path, capsys):
    assert main(["obstacles", str(lot), "--masks", "sem_net", "--frames", ":6", "--out", str(tmp_path)]) == 0
    assert _numbers(tmp_path)["final.false"] == 0
    rows = list(csv.DictReader((tmp_path / "obstacles.csv").open()))
    assert {"t", "track", "class", "x_m", "yaw_rad", "x_odom_m", "sigma_x_m", "existence"} <= set(rows[0])
    final = list(csv.DictReader((tmp_path / "obstacles_final.csv").open()))
    told = json.loads((tmp_path / "obstacles.geojson").read_text())["features"]
    assert len(told) == len(final) > 0
    assert main(["obstacles", str(lot), "--frames", "900:"]) == 1
    assert "no frames chosen of 40" in capsys.readouterr().err


@pytest.mark.slow
def test_obstacles_of_a_lot(lot, tmp_path):
    assert main(["obstacles", str(lot), "--masks", "sem_net", "--out", str(tmp_path)]) == 0
    numbers = _numbers(tmp_path)
    assert numbers["searching.fused.x"] < 5.0 and numbers["searching.fused.y"] < 8.0  # cm
    assert numbers["searching.fused.y"] < 0.5 * numbers["searching.single.y"]
    assert numbers["final.false"] == 0 and numbers["final.recall_near"] > 0.8
    final = list(csv.DictReader((tmp_path / "obstacles_final.csv").open()))
    assert {row["class"] for row in final} >= {"cone", "ground_lock"}


@pytest.mark.slow
def test_the_shipped_network_on_a_lot_it_never_saw(lot, tmp_path):
    """Sixteen frames at noon: boxes of single pictures, then obstacles over frames, none of them of nothing."""
    scores = judged(ObstacleNet.load(), obstacle_views(lot, slice(0, 16, 4)), (0.0, 6.0))
    assert scores["cone"].num_true > 10 and scores["cone"].average_precision > 0.75
    words = ["obstacles", str(lot), "--front", "net", "--masks", "sem_net", "--frames", ":16", "--out", str(tmp_path)]
    assert main(words) == 0
    numbers = _numbers(tmp_path)
    assert numbers["searching.fused.x"] < 5.0 and numbers["searching.fused.y"] < 8.0  # cm
    assert numbers["final.false"] == 0 and numbers["false.fused"] == 0 and numbers["searching.fused.num"] > 15


def test_options_that_do_not_fit_are_told(lot, capsys):
    assert main(["obstacles", str(lot), "--weights", "obstacles.weights"]) == 2
    assert "--weights is for --front net" in capsys.readouterr().err
    assert main(["obstacles", str(lot), "--front", "net", "--input", "fisheye"]) == 2
    assert "looks at the cylinder" in capsys.readouterr().err
