"""The files of a calibration: corrected cameras, sigmas, what could not be told (room: calibration; host).

In: the result of a calibration, the calibration file it started from. Out: calib.yaml (or the files that there
were), observability.csv, calibration.json, report.txt.
"""

import csv
import json
from pathlib import Path

import numpy as np

from semloc_jax.calibration.ground_points import GroundCalibration
from semloc_jax.calibration.observability import Observability, to_text
from semloc_jax.calibration.road_calibration import RoadCalibration
from semloc_jax.calibration.self_calibration import SelfCalibration
from semloc_jax.cameras import Rig
from semloc_jax.cameras.io.corrected import write_corrected
from semloc_jax.evaluation import Trajectory, write_tum
from semloc_jax.storage import write_text, writing


def report_text(result: SelfCalibration) -> str:
    """The result as text: sigmas, verdicts, vehicle, what was missing."""
    v, seen = result.vehicle, result.observability
    bias = np.rad2deg(v["gyro_bias"])
    lines = [
        f"{len(result.frames)} frames, {result.inlier_ratio:.0%} of the visible map within {result.level_px:g} px",
        to_text(seen),
        f"odometer scale {v['odometer_scale']:.5f} +- {seen.parameter('odometer_scale').sigma:.5f} "
        "(true speed over measured speed)",
        f"gyroscope bias {bias:+.4f} +- {seen.parameter('gyro_bias').sigma:.4f} deg/s",
        f"fixes lie {v['gnss_east']:+.2f} +- {seen.parameter('gnss_east').sigma:.2f} m east and "
        f"{v['gnss_north']:+.2f} +- {seen.parameter('gnss_north').sigma:.2f} m north of the map",
        *(f"note: {note}" for note in result.notes),
    ]
    if not result.converged:
        lines.append("note: the last level did not converge; raise --max-steps or start from a better calibration")
    return "\n".join(lines)


def ground_text(result: GroundCalibration) -> str:
    """The result of a ground-point calibration as text."""
    held, held_before = np.mean(result.held_out_m), np.mean(result.held_out_before_m)
    folds = ", ".join(f"{value:.3f}" for value in result.held_out_m)
    return "\n".join(
        [
            f"{len(result.distances_m)} ground points: mean disagreement {result.before_m:.4f} m before, "
            f"{result.after_m:.4f} m after",
            f"points that were held out: {held_before:.4f} m before, {held:.4f} m after (folds {folds})",
            to_text(result.observability),
        ]
    )


def road_text(result: RoadCalibration) -> str:
    """The result of a calibration by the road as text."""
    scale, bias = result.odometer_scale, np.rad2deg(result.gyro_bias_radps)
    return "\n".join(
        [
            f"{len(result.frames)} frames, {result.num_lines} painted lines that several images show, "
            f"{result.num_across} of them several cameras, {result.num_spots} spots that two pictures show",
            f"sights of a line lie {100 * result.before_m:.1f} cm from it before, {100 * result.after_m:.1f} cm after "
            "(root mean square, to 8 m)",
            to_text(result.observability),
            f"odometer scale {scale:.5f} (true speed over measured speed), gyroscope bias {bias:+.4f} deg/s",
            *(() if result.converged else ("note: the last solve did not converge; start from a better calibration",)),
        ]
    )


def write_report(result: SelfCalibration, source: Path, folder: Path) -> tuple[Path, ...]:
    """Write the corrected calibration in the layout of `source`, tables and text; returns the calibration files."""
    content = {
        "vehicle": result.vehicle,
        "inlier_ratio": result.inlier_ratio,
        "converged": result.converged,
        "notes": list(result.notes),
    }
    files = _written(result.rig, result.observability, report_text(result), content, source, folder)
    time_s = np.array([frame.time_s for frame in result.frames])
    write_tum(Trajectory(time_s, result.T_map_base), folder / "trajectory.tum")
    return files


def write_ground_report(result: GroundCalibration, source: Path, folder: Path) -> tuple[Path, ...]:
    """`write_report` of a ground-point calibration."""
    content = {
        "before_m": result.before_m,
        "after_m": result.after_m,
        "held_out_before_m": list(result.held_out_before_m),
        "held_out_m": list(result.held_out_m),
    }
    return _written(result.rig, result.observability, ground_text(result), content, source, folder)


def write_road_report(result: RoadCalibration, source: Path, folder: Path) -> tuple[Path, ...]:
    """`write_report` of a calibration by the road."""
    content = {
        "odometer_scale": result.odometer_scale,
        "gyro_bias_radps": result.gyro_bias_radps,
        "before_m": result.before_m,
        "after_m": result.after_m,
        "converged": result.converged,
    }
    files = _written(result.rig, result.observability, road_text(result), content, source, folder)
    time_s = np.array([frame.time_s for frame in result.frames])
    write_tum(Trajectory(time_s, result.T_odom_base), folder / "trajectory.tum")
    return files


def _written(
    rig: Rig, observability: Observability, text: str, content: dict[str, object], source: Path, folder: Path
) -> tuple[Path, ...]:
    """What every calibration leaves: its files, the table of what is observable, text, and numbers as JSON."""
    files = write_corrected(rig, source, folder)
    _write_observability(observability, folder)
    write_text(folder / "report.txt", text + "\n")
    content = {**content, "not_observable": _hidden(observability)}
    write_text(folder / "calibration.json", json.dumps(content, indent=1) + "\n")
    return files


def _hidden(observability: Observability) -> list[dict[str, object]]:
    return [
        {"direction": d.text, "verdict": str(d.verdict), "sigma_left": round(d.ratio, 4), "reason": d.reason}
        for d in observability.directions
        if d.reason
    ]


def _write_observability(observability: Observability, folder: Path) -> None:
    with (
        writing(folder / "observability.csv") as partial,
        partial.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(("parameter", "unit", "change", "sigma", "prior_sigma", "verdict"))
        for p in observability.parameters:
            numbers = (f"{value:.6g}" for value in (p.change, p.sigma, p.prior_sigma))
            writer.writerow((p.name, p.unit, *numbers, str(p.verdict)))
