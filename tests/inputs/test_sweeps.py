"""A map made of some sweeps of PandaSet: who made it is told apart from who is localized; bad slices are one line."""

import json

import numpy as np
import pytest

from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.cameras import Rig
from semloc_jax.cli.localize import Options
from semloc_jax.cli.main import FAILED, USAGE, main
from semloc_jax.datasets import Frame
from semloc_jax.inputs import sweeps
from semloc_jax.inputs.drive_inputs import open_inputs
from semloc_jax.reports import metrics
from semloc_jax.structs import ElementClass, SolveStatus


@pytest.fixture(scope="module")
def pandaset(data_dir):
    path = data_dir / "pandaset_002"
    if not path.is_dir():
        pytest.skip(f"no pandaset_002 in {data_dir}")
    return path


def test_map_and_frames_of_chosen_sweeps(pandaset):
    inputs = open_inputs(Options(pandaset, map="sweeps:40:80:4"))
    assert inputs.is_map_made
    assert [frame.variant for frame in inputs.drive.frames[40:44]] == [sweeps.MAP_SWEEP] + 3 * [sweeps.OTHER_SWEEP]
    assert sum(frame.variant == sweeps.MAP_SWEEP for frame in inputs.drive.frames) == 10
    assert sum(element.label == ElementClass.LANE_MARKING for element in inputs.map.elements) > 5
    assert (inputs.masks.name, inputs.masks.cameras) == ("classical", ("front_camera",))


@pytest.mark.parametrize(
    ("value", "code", "message"),
    [
        ("sweeps:a:b", USAGE, "--map sweeps: 'a:b': expected a Python slice"),
        ("sweeps:200:", FAILED, "no sweeps chosen of 80; give e.g. --map sweeps:::2"),
        ("sweeps:0:2", FAILED, "use more sweeps"),
    ],
)
def test_bad_sweeps_are_one_line(pandaset, tmp_path, capsys, value, code, message):
    assert main(["localize", str(pandaset), "--map", value, "--out", str(tmp_path / "out")]) == code
    said = capsys.readouterr().err
    assert message in said
    assert len(said.strip().splitlines()) == 1
    assert "internal error" not in said


def test_other_drives_have_no_sweeps(simulated_road, tmp_path, capsys):
    assert main(["localize", str(simulated_road), "--map", "sweeps:::2", "--out", str(tmp_path / "out")]) == FAILED
    assert "drive road has no labelled points; give --map FILE" in capsys.readouterr().err


def test_metrics_of_each_variant_are_apart(tmp_path):
    no_cameras, found, truth = Rig([], np.zeros((0, 4, 4)), []), [], {}
    for index in range(6):
        frame = Frame(index, str(index), float(index), "even" if index % 2 == 0 else "odd", no_cameras, {})
        T = np.eye(4)
        T[1, 3] = 0.1 if index % 2 == 0 else 0.3
        found.append(LocalizationResult(frame, T, T, SolveStatus.CONVERGED, index != 5, (), (), {}))
        truth[frame.id] = np.eye(4)
    said = metrics.write_metrics_of(found, truth, tmp_path)
    assert "even: frames.reference 3 frames" in said
    written = (tmp_path / "metrics.json").read_text()
    values = {m["key"]: m["value"] for m in json.loads(written)["metrics"]}
    assert values["even.lateral.median"] == pytest.approx(0.1)
    assert values["odd.lateral.median"] == pytest.approx(0.3)
    assert (values["even.estimated"], values["odd.estimated"]) == (1.0, pytest.approx(2 / 3))
