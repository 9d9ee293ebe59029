"""`semloc slots` on the shared lot: slots of many frames within centimetres, searching."""

import csv
import json

import numpy as np
import pytest

from semloc_jax.cli.main import main
from semloc_jax.datasets import open_drive
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.learning.marking_drives import MarkingDrive
from semloc_jax.learning.marking_lesson import judged
from semloc_jax.perception.networks.marking_net import MarkingNet

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


def test_slots_of_four_frames(lot, tmp_path, capsys):
    assert main(["slots", str(lot), "--masks", "sem_net", "--frames", ":4", "--out", str(tmp_path)]) == 0
    numbers = _numbers(tmp_path)
    assert numbers["false.fused"] == 0 and numbers["final.false"] == 0
    assert numbers["searching.fused.x"] < 8.0 and numbers["searching.fused.y"] < 5.0  # cm
    rows = list(csv.DictReader((tmp_path / "slots.csv").open()))
    assert {"t", "track", "type", "x_m", "yaw_rad", "x_odom_m", "occupied", "sigma_x_m", "existence"} <= set(rows[0])
    assert len(list(csv.DictReader((tmp_path / "slots_final.csv").open()))) >= 6
    assert main(["slots", str(lot), "--frames", "900:"]) == 1
    assert "no frames chosen of 40" in capsys.readouterr().err
    assert main(["slots", str(lot), "--window", "0"]) == 1
    assert "expected at least 1 frame" in capsys.readouterr().err
    assert main(["slots", str(lot), "--weights", "slots.weights"]) == 2
    assert "--weights is for --front net" in capsys.readouterr().err


@pytest.mark.slow
def test_slots_of_a_lot(lot, tmp_path):
    assert main(["slots", str(lot), "--masks", "sem_net", "--frames", ":16", "--out", str(tmp_path)]) == 0
    numbers = _numbers(tmp_path)
    assert numbers["searching.fused.x"] < 5.0 and numbers["searching.fused.y"] < 5.0  # cm
    assert numbers["false.fused"] == 0 and numbers["final.false"] == 0 and numbers["final.recall_near"] == 1.0
    final = list(csv.DictReader((tmp_path / "slots_final.csv").open()))
    width_m = np.array([float(row["width_m"]) for row in final])
    np.testing.assert_allclose(width_m, 2.42, atol=0.12)
    # A lock stands in two of the slots.
    assert sum(row["obstacle"] == "ground_lock" for row in final) == 2


@pytest.mark.slow
def test_the_shipped_network_on_a_lot_it_never_saw(lot, tmp_path):
    """Ten frames: single points at the threshold of its card, then slots over frames by the same rule as from masks."""
    drive, net = open_drive(lot), MarkingNet.load()
    shows = MarkingDrive(drive, mask_source("sem", drive))
    found = judged(net.network, [shows.at(frame) for frame in drive.frames[::4]], (net.threshold,))[net.threshold]
    assert found.num_true > 25
    assert found.recall >= 0.9 and found.precision >= 0.9
    assert np.mean(found.off_m) < 0.04  # m
    words = ["slots", str(lot), "--front", "net", "--masks", "sem_net", "--frames", ":12", "--out", str(tmp_path)]
    assert main(words) == 0
    numbers = _numbers(tmp_path)
    assert numbers["searching.fused.x"] < 5.0 and numbers["searching.fused.y"] < 5.0  # cm
    assert numbers["false.fused"] == 0 and numbers["final.false"] == 0
