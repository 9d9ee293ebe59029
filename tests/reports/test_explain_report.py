"""What `semloc explain` writes and prints of an explanation, without solving anything."""

import csv
import dataclasses
import json

import numpy as np
import pytest

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.analysis.explain_check import ElementEffect
from semloc_jax.analysis.explain_drive import element_roles
from semloc_jax.analysis.explanation import Explanation, Holder
from semloc_jax.cli.main import LOST, OK, main
from semloc_jax.reports import explain
from semloc_jax.reports.explain_tables import check_table, explained_elements, role_table
from semloc_jax.structs import ElementClass, SolveStatus

SIGMA = np.array([0.05, 0.02, np.radians(0.1)])


def holder(name, label, share, removed_m=0.01, grows=1.1):
    """An element with this share of every direction, or a part of the prior."""
    linear = np.array([0.04, -0.01, np.radians(0.05)])
    return Holder(
        name,
        label,
        np.array([10.0, 2.0, 0.0]),
        40,
        12.0,
        0.8,
        0.5,
        np.full(3, share),
        grows * SIGMA,
        np.eye(3) * share,
        np.full(3, share),
        np.array([0.0, 1.0, 0.0]),
        0.06,
        linear,
        0.5 * linear,
        np.array([removed_m, 0.0, 0.0]),
    )


@pytest.fixture
def found():
    pole = holder("lamp_7", ElementClass.POLE, 0.6, removed_m=0.08, grows=3.0)
    line = holder("line_2", ElementClass.LANE_MARKING, 0.3)
    prior = holder("prior", None, 0.1)
    return Explanation(np.eye(4), np.zeros(3), True, 3.0, SIGMA, 0.1, (pole, line, prior), (pole, line))


def test_the_table_names_the_strongest_the_most_missed_and_the_irreplaceable(found):
    meaning, lines = explained_elements(found, 1).split("\n\n", 1)
    assert all(word in meaning for word in ("share:", "if wrong:", "if missing:", "[cm]", "[deg]"))
    lines = lines.split("\n")
    assert "lamp_7" in lines[2] and "60.0" in lines[2]
    # 4 cm and 1 cm by the derivative, half of it by the solver, 6 cm up to where the kernel holds.
    assert [f"{value:+.1f}" for value in (2.0, -0.5, 4.0, -1.0)] == lines[2].split()[6:8] + lines[2].split()[9:11]
    assert lines[2].split()[-1] == "6.0"
    assert lines[3].startswith("... 1 more") and "30.0" in lines[3]
    text = "\n".join(lines)
    assert "sigma: longitudinal 5.0 cm, lateral 2.0 cm, heading 0.10 deg" in text
    assert "most missed: lamp_7: without it the pose moves +8.0 cm longitudinal" in text
    assert "no stand-in: lamp_7" in text and "no stand-in: line_2" not in text


def test_names_that_are_cut_are_marked_and_no_derivative_holds_for_kilometres(found):
    far = dataclasses.replace(found.holders[0], id="signal_post_0_right", linear_to_m=56.0)
    line = explained_elements(dataclasses.replace(found, holders=(far, *found.holders[1:])), 1).split("\n")[6]
    assert line.startswith("pole           signal_post_0_rig~ ") and line.split()[-1] == ">100"


def test_checks_and_roles_are_one_line_each(found):
    moved = np.array([0.03, 0.0, 0.0])
    checks = [ElementEffect(found.holders[0], moved, moved, False)]
    (line,) = check_table(checks).split("\n")[1:]
    assert line.startswith("lamp_7") and "+2.0  -0.5" in line and "+3.0  +0.0" in line
    assert line.endswith("no longer localized")
    text = role_table(element_roles([found, found]), 2, 5)
    assert "60.0 %" in text and "no stand-in: lamp_7 in 2 of 2 frames" in text


def test_the_verb_writes_every_holder_and_both_pictures(simulated_road, tmp_path, monkeypatch, capsys, found):
    def localized(self, frame, masks, prior, rig):
        return LocalizationResult(frame, np.eye(4), np.eye(4), SolveStatus.CONVERGED, True, (), (), {})

    monkeypatch.setattr(FrameLocalizer, "localize", localized)
    monkeypatch.setattr(explain, "explain_frame", lambda *args: found)
    out = tmp_path / "out"
    words = ["explain", str(simulated_road), "--masks", "sem", "--frame", "1", "--out", str(out)]
    assert main(words) == OK
    with (out / "explain.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["id"] for row in rows] == ["lamp_7", "line_2", "prior", "lamp_7", "line_2"]
    assert float(rows[0]["shifted_longitudinal_m"]) == 0.02 and float(rows[0]["linear_heading_deg"]) == 0.05
    record = json.loads((out / "explain.json").read_text())
    assert sum(row["share_lateral"] for row in record["holders"]) == pytest.approx(1.0)
    assert record["most_missed"] == "lamp_7" and record["shift_m"] == 0.1
    assert all((out / name).stat().st_size > 5000 for name in ("explain.png", "explain_map.png"))
    assert "most missed: lamp_7" in capsys.readouterr().out


def test_a_frame_without_a_pose_writes_nothing(simulated_road, tmp_path, monkeypatch, capsys):
    def lost(self, frame, masks, prior, rig):
        reasons = ("cost 0.9 above 0.75",)
        return LocalizationResult(frame, np.eye(4), np.eye(4), SolveStatus.POOR_FIT, False, reasons, (), {})

    monkeypatch.setattr(FrameLocalizer, "localize", lost)
    words = ["explain", str(simulated_road), "--masks", "sem", "--out", str(tmp_path / "out")]
    assert main(words) == LOST
    assert "is not localized: cost 0.9 above 0.75" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()
