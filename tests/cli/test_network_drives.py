"""`localize` and `track` with a network that runs on the images: what it sees of the map, and where the vehicle is."""

import logging
import shutil

import cv2
import numpy as np
import pytest
import yaml

from semloc_jax.cli.main import OK, main
from semloc_jax.datasets import open_drive
from semloc_jax.evaluation import pose_errors, read_trajectory
from semloc_jax.inputs.drive_inputs import InputOptions, open_inputs
from tests.perception.onnx_files import red_or_blue

pytest.importorskip("onnxruntime")
TABLE = """name: colours
ids: {nothing: 0, lane: 1, post: 2}
channels:
  - {name: lane, masks: [lane], classes: [lane_marking]}
  - {name: post, masks: [post], classes: [pole]}
"""
LANES, POLE = (10, 11), 20


@pytest.fixture(scope="module")
def coloured(simulated_road, tmp_path_factory):
    """The simulated drive with images that show lanes red and poles blue, and a network that knows these colours."""
    folder = tmp_path_factory.mktemp("coloured")
    drive = shutil.copytree(simulated_road, folder / "drive")
    for frame in open_drive(simulated_road).frames:
        mask = frame.mask("sem", "front")
        image = np.zeros((*mask.shape, 3), np.uint8)
        image[np.isin(mask, LANES), 2], image[mask == POLE, 0] = 255, 255
        (drive / "rgb" / "front" / f"{frame.id}.jpg").unlink()
        cv2.imwrite(str(drive / "rgb" / "front" / f"{frame.id}.png"), image)
    red_or_blue(folder / "net.onnx", size=None)
    (folder / "table.yaml").write_text(TABLE)
    preset = {"mean": [0, 0, 0], "std": [1, 1, 1], "class_table": "table.yaml"}
    (folder / "net.yaml").write_text(yaml.safe_dump(preset))
    return folder


def test_the_classes_that_the_masks_show_are_told(coloured, caplog):
    with caplog.at_level(logging.INFO):
        inputs = open_inputs(InputOptions(coloured / "drive", masks=str(coloured / "net.onnx")))
    said = " ".join(record.getMessage() for record in caplog.records)
    assert "show of the map: lane_marking (" in said
    assert "do not show: " in said and "sign" in said.split("do not show: ")[1]
    frame = inputs.drive.frames[1]
    exact = open_drive(coloured / "drive").frames[1].mask("sem", "front")
    assert np.array_equal(inputs.masks.masks(frame)[0] == 1, np.isin(exact, LANES))


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["localize", "track"])
def test_the_vehicle_is_found_with_the_masks_of_a_network(coloured, simulated_road, tmp_path, verb):
    words = [verb, str(coloured / "drive"), "--masks", str(coloured / "net.onnx"), "--overlays", "0"]
    words += ["--hypotheses", "256"] if verb == "localize" else ["--fusion", "kalman", "--min-tracking-share", "0"]
    assert main([*words, "--out", str(tmp_path)]) == OK
    found = read_trajectory(tmp_path / "trajectory.tum")
    truth = read_trajectory(simulated_road / "poses_body.tum")
    errors = pose_errors(found.T_map_base, truth.interpolate(found.time_s))
    assert len(found) >= 2
    assert np.abs(errors["lateral_m"]).max() < 0.10 and np.abs(errors["heading_deg"]).max() < 0.3
