"""`semloc explain`: tables, files, pictures, and what happens when the map is really changed."""

import csv
import json

import pytest

from semloc_jax.cli.main import FAILED, LOST, OK, USAGE, main


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--shift-cm", "0"], USAGE, "--shift-cm: expected 0 to 100"),
        (["--every", "0"], USAGE, "1 or more"),
        (["--frame", "3"], FAILED, "no frame 3; it has 3 frames"),
    ],
)
def test_what_cannot_be_asked_is_refused(simulated_road, tmp_path, capsys, words, code, message):
    assert main(["explain", str(simulated_road), *words, "--out", str(tmp_path / "out")]) == code
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_frame_is_explained_and_checked(simulated_road, tmp_path, capsys):
    out = tmp_path / "out"
    words = [
        "--masks",
        "sem",
        "--frame",
        "1",
        "--shift-cm",
        "3",
        "--check",
        "2",
        "--posterior",
        "--scatter",
        "2",
        "--out",
        str(out),
    ]
    assert main(["explain", str(simulated_road), *words, "--out", str(out)]) == OK
    said = capsys.readouterr().out
    assert "most missed:" in said and "in all" in said and "localized again with" in said
    assert "95 % interval of lateral: -" in said and "2 draws of a network's noise: RMS error" in said
    with (out / "explain.csv").open() as file:
        rows = list(csv.DictReader(file))
    record = json.loads((out / "explain.json").read_text())
    assert sum(row["share_lateral"] for row in record["holders"]) == pytest.approx(1.0, abs=1e-3)
    assert len(rows) == len(record["holders"]) + len(record["classes"])
    assert len(record["checks"]) == 2
    for check in record["checks"]:
        foretold = next(row for row in record["holders"] if row["id"] == check["id"])
        assert check["shifted"][1] == pytest.approx(foretold["shifted_lateral_m"], abs=0.02)
    for name in ("explain.png", "explain_map.png"):
        assert (out / name).stat().st_size > 10000
    assert "shift_cm: 3" in (out / "config.yaml").read_text()


@pytest.mark.slow
def test_a_drive_is_explained_and_a_lost_frame_is_told(simulated_road, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["explain", str(simulated_road), "--masks", "sem", "--every", "1", "--out", str(out)]) == OK
    assert "explained 3 of 3 frames" in capsys.readouterr().out
    with (out / "drive.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert 0.5 < sum(float(row["share"]) for row in rows) <= 1.001
    words = ["--masks", "sem", "--prior", "truth", "--verdict.max-cost", "0.0001", "--out", str(tmp_path / "lost")]
    assert main(["explain", str(simulated_road), *words]) == LOST
    assert "is not localized" in capsys.readouterr().out
