"""`semloc evaluate`: known errors come out as numbers, a lost baseline as exit code 3."""

import json

import numpy as np
import pytest

from semloc_jax.cli.main import FAILED, LOST, OK, USAGE, main
from semloc_jax.evaluation import Trajectory, read_metrics, write_tum


def _write(path, lateral_m=0.0, start_s=0.0):
    T = np.tile(np.eye(4), (30, 1, 1))
    T[:, 0, 3] = np.arange(30)
    T[:, 1, 3] = lateral_m
    write_tum(Trajectory(start_s + 0.1 * np.arange(30), T), path)
    return str(path)


@pytest.fixture
def truth(tmp_path):
    return _write(tmp_path / "truth.tum")


def test_metrics_and_picture_are_written(truth, tmp_path, capsys):
    estimate = _write(tmp_path / "estimate.tum", lateral_m=0.2)
    assert main(["evaluate", estimate, truth, "--out", str(tmp_path / "new" / "folder")]) == OK
    metrics = {m.key: m for m in read_metrics(tmp_path / "new" / "folder" / "metrics.json")}
    assert metrics["lateral.median"].value == pytest.approx(0.2)
    assert metrics["lateral.bias"].value == pytest.approx(0.2)
    assert metrics["inside.local_street"].value == 1.0
    assert (tmp_path / "new" / "folder" / "errors.png").stat().st_size > 5000
    assert "0.2000" in capsys.readouterr().out


def test_the_gate_ends_with_exit_code_3(truth, tmp_path, capsys):
    good, bad = _write(tmp_path / "good.tum", 0.05), _write(tmp_path / "bad.tum", 0.4)
    assert main(["evaluate", good, truth, "--out", str(tmp_path)]) == OK
    gate = ["--baseline", str(tmp_path / "metrics.json")]
    assert main(["evaluate", good, truth, *gate]) == OK
    assert main(["evaluate", bad, truth, *gate]) == LOST
    said = capsys.readouterr().out
    assert "worse   lateral.median" in said


@pytest.mark.parametrize(("align", "is_left"), [("none", True), ("se2", False), ("se3", False)])
def test_one_motion_is_taken_out_where_asked(truth, tmp_path, capsys, align, is_left):
    """An S-shaped way turned by 20 deg and moved by 30 m: only the aligned errors vanish."""
    time_s = 0.1 * np.arange(30)
    T = np.tile(np.eye(4), (30, 1, 1))
    T[:, :3, 3] = np.stack([np.arange(30.0), np.sin(0.3 * np.arange(30)), 0.2 * np.cos(0.5 * np.arange(30))], axis=1)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(0.35), -np.sin(0.35)], [np.sin(0.35), np.cos(0.35)]]
    turn[:2, 3] = 30.0, -4.0
    write_tum(Trajectory(time_s, T), tmp_path / "true.tum")
    write_tum(Trajectory(time_s, turn @ T), tmp_path / "own.tum")
    words = [str(tmp_path / "own.tum"), str(tmp_path / "true.tum"), "--align", align, "--out", str(tmp_path)]
    assert main(["evaluate", *words]) == OK
    metrics = {m.key: m.value for m in read_metrics(tmp_path / "metrics.json")}
    assert (metrics["translation.max"] > 10.0) == is_left
    assert is_left or (metrics["translation.max"] < 1e-6 and metrics["heading.max"] < 1e-6)
    assert ("turned by 20.0535 deg" in capsys.readouterr().out) != is_left


def test_different_clocks_and_broken_files_are_explained(truth, tmp_path, capsys):
    late = _write(tmp_path / "late.tum", start_s=50.0)
    assert main(["evaluate", late, truth]) == FAILED
    assert "expected the same clock" in capsys.readouterr().err
    (tmp_path / "words.tum").write_text("this is no trajectory\n")
    assert main(["evaluate", str(tmp_path / "words.tum"), truth]) == FAILED
    assert "not a table of numbers" in capsys.readouterr().err
    assert main(["evaluate", "made.osm", truth]) == USAGE
    assert "a map and a trajectory cannot be compared" in capsys.readouterr().err
    (tmp_path / "metrics.json").write_text(json.dumps([1, 2]))
    assert main(["evaluate", truth, truth, "--baseline", str(tmp_path / "metrics.json")]) == FAILED
    assert "not a metrics file" in capsys.readouterr().err


def test_two_maps_are_compared(tmp_path, capsys):
    from semloc_jax.maps import MapElement, SemanticMap, write_map

    lines = [[[10.0 * k, 0.0, 0.0], [10.0 * k + 4.0, 0.0, 0.0]] for k in range(4)]
    for name, shift in (("made.gpkg", 0.05), ("true.geojson", 0.0)):
        dashes = [
            MapElement(f"d{k}", "lane_marking", np.add(line, [0.0, shift, 0.0]), width_m=0.15, style="dashed")
            for k, line in enumerate(lines)
        ]
        write_map(SemanticMap(tuple(dashes)), tmp_path / name)
    words = ["evaluate", str(tmp_path / "made.gpkg"), str(tmp_path / "true.geojson"), "--out", str(tmp_path / "out")]
    assert main(words) == OK
    metrics = {m.key: m.value for m in read_metrics(tmp_path / "out" / "metrics.json")}
    assert metrics["map.dash.f1"] == 1.0
    assert metrics["map.dash.rms_across"] == pytest.approx(0.05)
    assert (tmp_path / "out" / "maps.png").stat().st_size > 5000
    assert main([*words, "--align", "se2", "--baseline", str(tmp_path / "out" / "metrics.json")]) == OK
    assert "moved by [ 0.   -0.05] m" in capsys.readouterr().out
    assert main([*words, "--align", "se3"]) == USAGE
