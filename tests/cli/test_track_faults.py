"""`semloc track --fault`: what is wrong with the drive reaches the run; a suite goes on after a kill."""

import csv
from types import SimpleNamespace

import numpy as np

from semloc_jax.analysis import fault_matrix
from semloc_jax.analysis.fault_matrix import FaultOutcome, JudgedRun
from semloc_jax.cli.main import FAILED, main
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.drive_inputs import Inputs
from semloc_jax.reports.fault_tables import read_outcomes, taken_up
from semloc_jax.reports.track_faults import write_suite
from semloc_jax.simulation.hostile import suite


def test_an_unknown_fault_is_one_line(simulated_road, tmp_path, capsys):
    for fault in ("earthquake", "focal:2,earthquake"):
        call = ["track", str(simulated_road), "--masks", "sem", "--fault", fault, "--out", str(tmp_path)]
        assert main(call) == FAILED
        said = capsys.readouterr().err.strip().splitlines()[-1]
        assert "fault 'earthquake': not known; expected" in said


def test_the_suite_is_written_line_by_line_and_goes_on_after_a_kill(tmp_path, monkeypatch):
    """Each fault once; the one that the drive does not allow is left out and said; what is done is not run again."""
    asked = []

    def run(row, drive, semantic_map, masks, make, seed):
        asked.append(row.name)
        if row.fault == "kidnapped":
            raise SemlocError("fault 'kidnapped': drive made goes on for 3 m only; expected more than 30 m")
        false = 2 * (row.name == "occlusion:2") + 5 * bool(row.apart)
        outcome = FaultOutcome(
            *(row.fault, row.severity, row.size, row.family, row.apart),
            frames=40,
            tracking=30,
            false=false,
            beyond_alert=0,
            refused_right=4,
            noticed_s=np.nan,
            recovered_s=0.1,
            max_lateral_m=0.01,
            max_longitudinal_m=0.02,
            max_heading_deg=0.03,
            max_any_m=0.04,
            reason="poor fit, at 3 m",
        )
        errors, level = np.array([[0.01, 0.02, 0.1]]), np.array([[0.1, 0.1, 0.5]])
        judged = JudgedRun(np.zeros(1), np.ones(1, bool), np.ones(1, bool), errors, level, 0.3 * level)
        return outcome, judged

    monkeypatch.setattr(fault_matrix, "run_fault", run)
    inputs = Inputs(SimpleNamespace(name="made"), None, None, None)
    rows = suite("none,map_shifted,occlusion,kidnapped,focal")
    for part in (rows[:5], rows):
        text, num_false = write_suite(inputs, lambda m, log: None, part, tmp_path, seed=0)
    assert num_false == 2 and "2 of them false" in text and "map_shifted, 15 false" in text
    assert "left out: fault 'kidnapped'" in text and text.count("left out") == 1
    lines = [line[:2] for line in csv.reader((tmp_path / "faults.csv").open())][1:]
    assert len(lines) == 10 and asked.count("none") == 1 and len(asked) == 13
    assert "| occlusion | 3 s | 30 of 40 | 2 | 4 | - | 0.1 s |" in (tmp_path / "faults.md").read_text()
    assert (tmp_path / "stanford.png").stat().st_size > 5000
    with (tmp_path / "faults.csv").open("a") as file:
        file.write("focal,9,cut by a ki")
    outcomes = read_outcomes(tmp_path / "faults.csv", FaultOutcome)
    assert len(outcomes) == 10 and np.isnan(outcomes[0].noticed_s) and outcomes[0].reason == "poor fit, at 3 m"
    taken_up(tmp_path / "faults.csv", FaultOutcome)
    assert len((tmp_path / "faults.csv").read_text().splitlines()) == 11
    # One frame of each fault, those of faults that nothing can see apart.
    assert len((tmp_path / "faults_frames.csv").read_text().splitlines()) == 11
