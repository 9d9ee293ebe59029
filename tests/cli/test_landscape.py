"""`semloc landscape`: the lowest cost lies at the true pose; wrong grids are refused."""

import csv

import pytest

from semloc_jax.cli.main import FAILED, OK, USAGE, main


def test_the_lowest_cost_is_at_the_truth(simulated_road, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["--masks", "sem", "--frame", "1", "--extent", "2,1", "--steps", "21,21", "--out", str(out)]
    assert main(["landscape", str(simulated_road), *words]) == OK
    with (out / "minima.csv").open() as file:
        rows = list(csv.DictReader(file))
    best = next(row for row in rows if row["class"] == "all" and row["rank"] == "1")
    assert float(best["x"]) == pytest.approx(0.0, abs=0.15)
    assert float(best["y"]) == pytest.approx(0.0, abs=0.03)
    lanes = next(row for row in rows if row["class"] == "lane_marking" and row["rank"] == "1")
    assert float(lanes["y"]) == pytest.approx(0.0, abs=0.05)
    assert (out / "landscape.png").stat().st_size > 10000
    assert "minimum 1:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--over", "x,x"], USAGE, "expected two different ones of x, y, z, roll, pitch, yaw"),
        (["--over", "x,heading"], USAGE, "expected two different ones"),
        (["--extent", "4"], USAGE, "two positive extents"),
        (["--steps", "a,b"], USAGE, "expected two numbers"),
        (["--frame", "3"], FAILED, "no frame 3; it has 3 frames"),
        (["--level", "9"], FAILED, "levels 0 (coarse) to 3"),
        (["--basin", "--window", "5,3"], USAGE, "three numbers such as 5,3,10"),
        (["--basin", "--starts", "0"], USAGE, "at least one start"),
    ],
)
def test_wrong_grids_are_refused(simulated_road, tmp_path, capsys, words, code, message):
    assert main(["landscape", str(simulated_road), *words, "--out", str(tmp_path / "out")]) == code
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_the_basin_of_a_frame_is_drawn_and_written(simulated_road, tmp_path, capsys):
    """From within a metre nearly every start finds the pose; the table says where each stood and where it ended."""
    out = tmp_path / "out"
    words = ["--masks", "sem", "--frame", "1", "--basin", "--starts", "32", "--window", "1,1,2", "--out", str(out)]
    assert main(["landscape", str(simulated_road), *words]) == OK
    with (out / "basin.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 32 and sum(int(row["success"]) for row in rows) >= 29
    found = [row for row in rows if row["success"] == "1"]
    assert max(abs(float(row["end_lateral_m"])) for row in found) <= 0.2
    assert max(abs(float(row["start_lateral_m"])) for row in rows) > 0.7
    assert (out / "basin.png").stat().st_size > 10000
    assert "one finds the pose in" in capsys.readouterr().out


@pytest.mark.slow
def test_a_region_without_a_pose_as_good_is_proven_and_written(simulated_road, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["--masks", "sem", "--frame", "0", "--basin", "--starts", "8", "--prove", "--out", str(out)]
    assert main(["landscape", str(simulated_road), *words]) == OK
    with (out / "proof.csv").open() as file:
        rows = list(csv.DictReader(file))
    widest = rows[0]
    assert float(widest["ramp_px"]) == 160.0
    assert float(widest["outer_longitudinal_m"]) > 2.0 and float(widest["outer_lateral_m"]) > 0.5
    assert all(float(row["outer_lateral_m"]) > float(row["inner_lateral_m"]) for row in rows)
    assert "ramp of 160 px: no pose as good as the minimum within ±" in capsys.readouterr().out


@pytest.mark.slow
def test_the_stages_of_the_search_are_drawn(simulated_road, tmp_path, capsys):
    """Every stage leaves fewer hypotheses; the picture shows them."""
    out = tmp_path / "out"
    assert main(["landscape", str(simulated_road), "--masks", "sem", "--stages", "--out", str(out)]) == OK
    said = capsys.readouterr().out
    left = [int(line.split()[-2]) for line in said.splitlines() if line.startswith("stage ")]
    assert "1024 proposals" in said and len(left) == 4 and left == sorted(left, reverse=True)
    assert (out / "search.png").stat().st_size > 10000
