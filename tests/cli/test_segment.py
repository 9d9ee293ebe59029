"""`semloc segment`: masks by a network, going on after an interruption, and used by `localize`."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from semloc_jax.cli.main import FAILED, LOST, OK, USAGE, main
from semloc_jax.datasets import open_drive
from semloc_jax.inputs.mask_source import mask_source

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.perception.onnx_files import red_and_blue_apart, red_or_blue

PRESET = {"mean": [0, 0, 0], "std": [1, 1, 1], "class_table": "table.yaml", "model": "net.onnx"}
TABLE = """name: colours
ids: {nothing: 0, red: 1, blue: 2}
channels:
  - {name: paint, masks: [red], classes: [lane_marking]}
"""


@pytest.fixture
def preset(tmp_path):
    """A network that calls red what is red, and its preset."""
    red_or_blue(tmp_path / "net.onnx", size=(120, 76))
    (tmp_path / "table.yaml").write_text(TABLE)
    (tmp_path / "preset.yaml").write_text(yaml.safe_dump(PRESET))
    return tmp_path / "preset.yaml"


def segment(drive, preset, out, *words):
    return main(["segment", str(drive), "--preset", str(preset), "--out", str(out), *words])


def test_masks_are_made_once_and_go_on(simulated_road, preset, tmp_path, capsys):
    out = tmp_path / "masks"
    assert segment(simulated_road, preset, out, "--frames", "0") == OK
    assert sorted(path.name for path in (out / "front").iterdir()) == ["000000.png"]
    before = (out / "front" / "000000.png").stat().st_mtime_ns
    assert segment(simulated_road, preset, out) == OK
    said = capsys.readouterr().out
    assert "made 2 masks" in said and "1 were there; 0 failed" in said
    assert "lane_marking" in said and "not in the table" in said
    assert f"--masks {out}" in said
    assert (out / "front" / "000000.png").stat().st_mtime_ns == before
    mask = cv2.imread(str(out / "front" / "000002.png"), cv2.IMREAD_UNCHANGED)
    assert mask.shape == (300, 480) and set(np.unique(mask)) <= {0, 1, 2}


def test_masks_of_a_folder_are_used_with_their_table(simulated_road, preset, tmp_path):
    out = tmp_path / "masks"
    assert segment(simulated_road, preset, out) == OK
    drive = open_drive(simulated_road)
    for frame in drive.frames:  # the colours of a street are not red or blue enough for a test of the table
        cv2.imwrite(str(out / "front" / f"{frame.id}.png"), np.uint8(frame.mask("sem", "front") == 10))
    source = mask_source(str(out), drive)
    assert source.table.name == "colours"
    assert source.masks(drive.frames[1])[0].sum() == (drive.frames[1].mask("sem", "front") == 10).sum()


def test_another_network_in_the_same_folder_is_refused(simulated_road, preset, tmp_path, capsys):
    out = tmp_path / "masks"
    assert segment(simulated_road, preset, out, "--frames", "0") == OK
    assert segment(simulated_road, preset, out, "--stretch") == FAILED
    assert "made with another letterbox; give another --out, or --overwrite" in capsys.readouterr().err
    assert segment(simulated_road, preset, out, "--stretch", "--overwrite", "--frames", "0") == OK


def test_an_image_that_cannot_be_read_does_not_end_the_run(simulated_road, preset, tmp_path, capsys):
    import shutil

    drive = shutil.copytree(simulated_road, tmp_path / "drive")
    image = next(path for path in (drive / "rgb" / "front").iterdir() if path.stem == "000001")
    image.write_bytes(b"damaged")
    assert segment(drive, preset, tmp_path / "masks") == LOST
    assert "made 2 masks" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ([], USAGE, "give --model FILE.onnx"),
        (["--model", "none.onnx"], FAILED, "no such file"),
        (["--model", "net"], USAGE, "--masks net' runs it"),
        (["--model", "round_1.weights"], USAGE, "--masks round_1.weights' runs it"),
        (["--model", __file__], FAILED, "what its class ids mean is not known; give --class-table"),
        (["--model", "none.onnx", "--class-table", "cityscapes"], FAILED, "no such file"),
        (["--model", "none.onnx", "--size", "10"], USAGE, "--size '10': expected two numbers such as 1024x512"),
        (["--preset", "none.yaml"], FAILED, "no such file"),
        (["--model", "x.onnx", "--class-table", "cityscape"], FAILED, "did you mean 'cityscapes'?"),
    ],
)
def test_bad_options_are_one_line(simulated_road, capsys, words, code, message):
    assert main(["segment", str(simulated_road), *words]) == code
    said = capsys.readouterr().err.strip()
    assert message in said and len(said.splitlines()) == 1


def test_twinlite_needs_nothing_but_its_file_and_its_table(simulated_road, tmp_path, capsys):
    """Its input, its normalisation and its two outputs are known: no preset to write, and no masks of zeros."""
    model = red_and_blue_apart(tmp_path / "twinlite.onnx")
    words = ["--model", str(model), "--class-table", "twinlite", "--frames", "0", "--out", str(tmp_path / "masks")]
    assert main(["segment", str(simulated_road), *words]) == OK
    assert "images as twinlite takes them (640x360)" in capsys.readouterr().out
    mask = cv2.imread(str(tmp_path / "masks" / "front" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert mask.any() and mask.max() <= 3


def test_the_output_of_a_network_can_be_named(simulated_road, tmp_path, capsys):
    model = red_and_blue_apart(tmp_path / "net.onnx")
    words = ["--model", str(model), "--class-table", "lane_paint", "--frames", "0", "--out", str(tmp_path / "masks")]
    assert main(["segment", str(simulated_road), *words]) == FAILED
    assert "--output NAME" in capsys.readouterr().err
    assert main(["segment", str(simulated_road), *words, "--output", "ll"]) == OK
