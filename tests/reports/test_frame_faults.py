"""`semloc localize --fault`: every fault is a row, what does not fit is told, and false frames are counted."""

import csv
from types import SimpleNamespace

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.analysis import frame_faults
from semloc_jax.analysis.frame_faults import FrameFaultOutcome
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.drive_inputs import Inputs
from semloc_jax.reports import frame_faults as report
from semloc_jax.reports import run_inputs


def test_rows_are_written_the_worst_told_and_false_frames_counted(tmp_path, monkeypatch):
    """Two false frames count; those under a fault that no frame can see do not."""

    def localized(row, *_):
        if row.fault == "distortion":
            raise SemlocError("fault 'distortion': this camera has none")
        false = {"focal": 2}.get(row.fault, 3 if row.apart else 0) if row.severity in (0, 2) else 0
        return FrameFaultOutcome(
            *(row.fault, row.severity, row.size, row.family, row.apart),
            frames=10,
            false=false,
            beyond_alert=0,
            refused_right=1,
            max_lateral_m=0.01,
            max_longitudinal_m=0.02,
            max_heading_deg=0.03,
            reason="poor fit",
            right=8,
            localized=7,
        )

    monkeypatch.setattr(frame_faults, "frame_fault", localized)
    monkeypatch.setattr(run_inputs, "fingerprint", lambda *_: {})
    inputs = Inputs(SimpleNamespace(name="made"), None, None, None)
    wanted = "none,focal,distortion,camera_yaw"
    folder, told, false = report.report_frame_faults(inputs, wanted, None, slice(None), LocalizeConfig(), tmp_path)
    rows = list(csv.DictReader((folder / "faults.csv").open()))
    fits = [row for row in frame_faults.frame_rows(wanted) if row.fault != "distortion"]
    assert [(row["fault"], int(row["severity"])) for row in rows] == [(row.fault, row.severity) for row in fits]
    counted = [row for row in fits if row.severity and not row.apart]
    assert false == 2 and f"{len(counted)} rows: 2 of {7 * len(counted)} localized frames false" in told
    assert told.count("left out: fault 'distortion'") == 1
    assert "focal" in (folder / "faults.md").read_text()
