"""`semloc localize` on a simulated drive: files, numbers, exit codes, and one line for every bad input."""

import csv
import json
import shutil

import numpy as np
import pytest
import yaml

from semloc_jax.cli.main import FAILED, INTERRUPTED, LOST, OK, USAGE, main
from semloc_jax.evaluation import Trajectory, pose_errors, read_trajectory, write_tum

SMALL = ["--hypotheses", "256", "--overlays", "1"]


def _rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def localized(simulated_road, tmp_path_factory):
    """The results of one run over two of three frames."""
    out = tmp_path_factory.mktemp("results")
    words = [
        "localize",
        str(simulated_road),
        "--masks",
        "sem",
        "--prior",
        "gnss",
        "--frames",
        "::2",
        "--cameras",
        "front",
    ]
    assert main([*words, *SMALL, "--out", str(out)]) == OK
    return out


def test_the_trajectory_is_the_truth_to_centimetres(localized, simulated_road):
    found = read_trajectory(localized / "trajectory.tum")
    truth = read_trajectory(simulated_road / "poses_body.tum")
    np.testing.assert_allclose(found.time_s, truth.time_s[::2], atol=1e-9)
    errors = pose_errors(found.T_map_base, truth.T_map_base[::2])
    assert np.abs(errors["lateral_m"]).max() < 0.05
    assert np.abs(errors["longitudinal_m"]).max() < 0.2
    assert np.abs(errors["heading_deg"]).max() < 0.2


def test_every_frame_and_mode_has_its_row(localized):
    frames = _rows(localized / "frames.csv")
    assert [row["frame"] for row in frames] == ["000000", "000002"]
    assert all(row["localized"] == "1" and float(row["coverage"]) > 0.2 for row in frames)
    assert all(abs(float(row["error_lateral_m"])) < 0.05 for row in frames)
    modes = _rows(localized / "hypotheses.csv")
    for frame in frames:
        own = [row for row in modes if row["frame"] == frame["frame"]]
        assert [int(row["rank"]) for row in own] == list(range(len(own)))
        assert sum(float(row["weight"]) for row in own) == pytest.approx(1.0, abs=1e-4)
        assert (own[0]["x_m"], own[0]["qz"]) == (frame["x_m"], frame["qz"])


RESUMED = ["--masks", "sem", "--prior", "gnss", "--frames", "::2", "--cameras", "front", *SMALL]


def test_a_killed_run_goes_on_where_it_stopped(localized, simulated_road, tmp_path):
    out = shutil.copytree(localized, tmp_path / "killed")
    lines = (localized / "results.jsonl").read_text().splitlines(keepends=True)
    (out / "results.jsonl").write_text(lines[0] + lines[1][:100])  # the line that was being written
    (out / "frames.csv").unlink()
    assert main(["localize", str(simulated_road), *RESUMED, "--resume", str(out)]) == OK
    for name in ("frames.csv", "hypotheses.csv"):
        whole, resumed = _rows(localized / name), _rows(out / name)
        assert [{**row, "time_ms": ""} for row in whole] == [{**row, "time_ms": ""} for row in resumed]
    assert (out / "trajectory.tum").read_bytes() == (localized / "trajectory.tum").read_bytes()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--masks", "sem_net"], "began with other masks"),
        (["--seed", "3"], "began with other settings, options"),
        (["--verdict.max-cost", "0.5"], "began with other settings"),
        (["--map", "errors"], "began with other map"),
        (["--frames", "1:"], "frame 000000, which is not chosen; give the --frames of the run"),
    ],
)
def test_a_run_is_resumed_with_the_same_only(localized, simulated_road, tmp_path, capsys, words, text):
    out = shutil.copytree(localized, tmp_path / "killed")
    assert main(["localize", str(simulated_road), *RESUMED, *words, "--resume", str(out)]) == FAILED
    assert text in capsys.readouterr().err.splitlines()[-1]


def test_an_interrupt_leaves_what_was_found(simulated_road, tmp_path, monkeypatch):
    from semloc_jax.localization import frame_by_frame

    def interrupted(*args):
        yield next(iterate(*args))
        raise KeyboardInterrupt

    iterate = frame_by_frame.iterate_frames
    monkeypatch.setattr(frame_by_frame, "iterate_frames", interrupted)
    assert main(["localize", str(simulated_road), *RESUMED, "--out", str(tmp_path)]) == INTERRUPTED
    assert [row["frame"] for row in _rows(tmp_path / "frames.csv")] == ["000000"]


def test_metrics_and_pictures_are_written(localized):
    metrics = {m["key"]: m["value"] for m in json.loads((localized / "metrics.json").read_text())["metrics"]}
    assert metrics["frames.reference"] == 2
    assert metrics["estimated"] == 1.0
    assert metrics["lateral.max"] < 0.05
    assert len(list((localized / "overlays").glob("*.png"))) == 1
    assert (localized / "errors.png").stat().st_size > 5000


def test_the_record_tells_how_and_reads_back(localized, simulated_road, tmp_path):
    record = yaml.safe_load((localized / "config.yaml").read_text())
    assert {"command", "time", "versions", "device"} <= set(record["run"])
    assert record["run"]["versions"]["jax"]
    assert (record["masks"], record["hypotheses"], record["frames"]) == ("sem", 256, "::2")
    assert record["search"]["num_hypotheses"] == 256
    again = tmp_path / "again"
    assert (
        main(["localize", str(simulated_road), "--config", str(localized / "config.yaml"), "--out", str(again)]) == OK
    )
    np.testing.assert_allclose(
        read_trajectory(again / "trajectory.tum").T_map_base,
        read_trajectory(localized / "trajectory.tum").T_map_base,
        atol=1e-6,
    )


def test_a_prior_that_is_far_off_ends_lost_with_exit_code_3(simulated_road, tmp_path, capsys):
    truth = read_trajectory(simulated_road / "poses_body.tum")
    T = truth.T_map_base.copy()
    T[:, :3, 3] += 25.0 * T[:, :3, 1]
    write_tum(Trajectory(truth.time_s, T), tmp_path / "wrong.tum")
    words = ["--prior", str(tmp_path / "wrong.tum"), "--masks", "sem", "--frames", "0", *SMALL]
    assert main(["localize", str(simulated_road), *words, "--out", str(tmp_path / "out")]) == LOST
    assert "localized 0 of 1 frames" in capsys.readouterr().out
    assert len(read_rows := _rows(tmp_path / "out" / "frames.csv")) == 1
    assert read_rows[0]["localized"] == "0"
    assert read_rows[0]["reasons"]
    metrics = {m["key"]: m["value"] for m in json.loads((tmp_path / "out" / "metrics.json").read_text())["metrics"]}
    assert metrics["estimated"] == 0.0
    lines = (tmp_path / "out" / "trajectory.tum").read_text().splitlines()
    assert all(line.startswith("#") for line in lines)


def test_without_a_wish_results_go_to_a_folder_by_time(simulated_road, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--masks", "sem", "--frames", "0", "--hypotheses", "256", "--overlays", "0"]
    assert main(["localize", str(simulated_road), *words]) == OK
    (folder,) = (path for path in (tmp_path / "results").iterdir() if not path.is_symlink())
    assert (tmp_path / "results" / "latest").resolve() == folder
    assert (folder / "trajectory.tum").is_file()
    assert not (folder / "overlays").exists()


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--frames", "a:b"], USAGE, "--frames 'a:b': expected a Python slice"),
        (["--hypothess", "3"], USAGE, "did you mean '--hypotheses'?"),
        (["--verdict.max-cots", "3"], USAGE, "did you mean '--verdict.max-cost'?"),
        (["--hypotheses", "many"], USAGE, "--hypotheses"),
        (["--frames", "7:9"], FAILED, "no frames chosen of 3"),
        (["--masks", "semantic"], FAILED, "masks 'semantic': drive road has no such folder; expected one of sem"),
        (["--cameras", "front,left"], FAILED, "camera 'left': not in the calibration; expected one of front"),
        (["--map", "nowhere.osm"], FAILED, "map nowhere.osm: no such file"),
        (["--prior", "nowhere.tum"], FAILED, "prior 'nowhere.tum'"),
        (["--class-table", "cityscape"], FAILED, "did you mean 'cityscapes'?"),
        (["--class-table", "lane_paint"], FAILED, "do not fit class table"),
    ],
)
def test_bad_options_are_one_line(simulated_road, tmp_path, capsys, words, code, message):
    assert main(["localize", str(simulated_road), *words, "--out", str(tmp_path / "out")]) == code
    said = capsys.readouterr().err
    assert message in said
    assert len(said.strip().splitlines()) == 1
    assert "internal error" not in said


def test_a_missing_drive_is_one_line(capsys):
    assert main(["localize", "no/such/drive"]) == FAILED
    assert "no such folder" in capsys.readouterr().err


@pytest.fixture
def broken(simulated_road, tmp_path):
    """A copy of the drive to damage."""
    return shutil.copytree(simulated_road, tmp_path / "drive")


def test_a_truncated_mask_costs_its_frame_and_is_one_line(broken, tmp_path, capsys, caplog):
    path = broken / "sem" / "front" / "000001.png"
    path.write_bytes(path.read_bytes()[:200])
    words = ["localize", str(broken), "--masks", "sem", "--frames", "1", "--out", str(tmp_path / "out")]
    assert main(words) == LOST
    assert "not localized: frame 000001 (NO_EVIDENCE" in capsys.readouterr().out
    assert caplog.text.count("000001.png: cannot be decoded") == 1


def test_an_empty_map_and_a_map_of_other_classes_are_one_line(broken, tmp_path, capsys):
    document = json.loads((broken / "map.geojson").read_text())
    features = document["features"]
    for chosen, message in (
        ([], "no element that a camera could see"),
        ([f for f in features if f["properties"]["class"] == "curb"], "no element"),
    ):
        path = tmp_path / "map.geojson"
        path.write_text(json.dumps(document | {"features": chosen}))
        assert main(["localize", str(broken), "--map", str(path), "--out", str(tmp_path / "out")]) == FAILED
        assert message in capsys.readouterr().err


def test_a_drive_without_fixes_asks_for_a_prior(broken, tmp_path, capsys):
    (broken / "gps.csv").unlink()
    assert main(["localize", str(broken), "--out", str(tmp_path / "out")]) == FAILED
    assert "give --prior truth or --prior FILE.tum" in capsys.readouterr().err


def test_an_output_folder_that_cannot_be_made_is_one_line(simulated_road, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["localize", str(simulated_road), "--out", str(tmp_path / "file" / "out")]) == FAILED
    assert "give --out a folder that can be written" in capsys.readouterr().err


def test_the_way_of_the_literature_writes_the_same_files(simulated_road, localized, tmp_path):
    words = ["localize", str(simulated_road), "--masks", "sem", "--prior", "truth", "--prior-sigma-xy-m", "0.3"]
    words += ["--prior-sigma-yaw-deg", "1", "--frames", "::2", "--cameras", "front", "--min-localized-share", "0"]
    assert main([*words, "--method", "icp", "--overlays", "1", "--out", str(tmp_path)]) == OK
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in localized.iterdir()}
    rows = _rows(tmp_path / "frames.csv")
    assert rows[0].keys() == _rows(localized / "frames.csv")[0].keys()
    assert all(abs(float(row["error_lateral_m"])) < 0.2 for row in rows)
    assert all(float(row["sigma_lateral_m"]) > 0.0 for row in rows)
    assert yaml.safe_load((tmp_path / "config.yaml").read_text())["method"] == "icp"


def test_options_of_the_literature_that_do_not_fit_are_refused(simulated_road, tmp_path, capsys):
    words = ["localize", str(simulated_road), "--masks", "sem", "--out", str(tmp_path)]
    assert main([*words, "--ipm-points", "points.csv"]) == USAGE
    assert "only --method icp" in capsys.readouterr().err
    assert main([*words, "--method", "icp", "--fault", "all"]) == USAGE
    points = tmp_path / "points.csv"
    rows = ["left,0,0,15,2", "left,9,0,15,-2", "left,9,9,6,-2", "left,0,9,6,2"]
    points.write_text("\n".join(["camera,u_px,v_px,x_m,y_m", *rows]) + "\n")
    assert main([*words, "--method", "icp", "--ipm-points", str(points)]) == FAILED
    assert "points of camera left" in capsys.readouterr().err
