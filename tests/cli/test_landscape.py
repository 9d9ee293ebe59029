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
    ],
)
def test_wrong_grids_are_refused(simulated_road, tmp_path, capsys, words, code, message):
    assert main(["landscape", str(simulated_road), *words, "--out", str(tmp_path / "out")]) == code
    assert message in capsys.readouterr().err
