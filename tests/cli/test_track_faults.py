"""`semloc track --fault`: what is wrong with the drive reaches the run; unknown faults are one line."""

import numpy as np

from semloc_jax.analysis import fault_matrix
from semloc_jax.analysis.fault_matrix import FaultOutcome
from semloc_jax.cli.main import FAILED, main
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.drive_inputs import Inputs
from semloc_jax.reports.track_faults import write_matrix


def test_an_unknown_fault_is_one_line(simulated_road, tmp_path, capsys):
    assert (
        main(["track", str(simulated_road), "--masks", "sem", "--fault", "earthquake", "--out", str(tmp_path)])
        == FAILED
    )
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "fault 'earthquake': not known; expected one of none, gnss_dropout" in said


def test_the_matrix_is_written_row_by_row_and_counts_false_frames(tmp_path, monkeypatch):
    """Each fault once; the one that the drive does not allow is left out and said."""

    def run(names, drive, semantic_map, masks, make, seed):
        (name,) = names
        if name == "kidnapped":
            raise SemlocError("fault 'kidnapped': drive made goes on for 3 m only; expected more than 30 m")
        yield FaultOutcome(name, 0.9, 0.5, np.nan, 0.1, 0.01, 0.02, 0.03, 0.04, int(name == "occlusion"))

    monkeypatch.setattr(fault_matrix, "fault_matrix", run)
    text, num_false = write_matrix(Inputs(None, None, None, None), lambda m, log: None, tmp_path, seed=0)
    assert num_false == 1
    lines = (tmp_path / "faults.csv").read_text().splitlines()
    names = [line.split(",")[0] for line in lines[1:]]
    assert names[:2] == ["none", "gnss_dropout"] and "kidnapped" not in names and len(names) == 11
    assert "left out: fault 'kidnapped'" in text
    assert (
        "| occlusion | 90% | - | 0.1 s | 1.0 cm, 2.0 cm, 0.03 deg | 0.04 m | 1 |"
        in (tmp_path / "faults.md").read_text()
    )
