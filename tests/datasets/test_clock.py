"""Times of any unit become seconds, and streams that do not belong together are told apart before work starts."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.datasets import open_drive, overlap_report
from semloc_jax.datasets.clock import seconds, unit_of_column
from semloc_jax.errors import SemlocError

FACTOR = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


@pytest.mark.parametrize("unit", FACTOR)
@pytest.mark.parametrize("start_s", [0, 1_700_000_000])
@pytest.mark.parametrize("step_s", [0.005, 0.033, 0.1, 1.0])
def test_units_are_told_from_clocks_and_steps(unit, start_s, step_s):
    wanted = start_s + step_s * np.arange(50)
    found, told = seconds(wanted * FACTOR[unit], "x")
    assert told == unit
    np.testing.assert_allclose(found, wanted, rtol=0, atol=3e-7)


def test_the_name_of_the_column_decides():
    names = {"t_ns": "ns", "time [ms]": "ms", "timestamp_us": "us", "t": None, "time (s)": "s", "stamps": None}
    assert {name: unit_of_column(name) for name in names} == names
    assert seconds(np.array([0.0, 40.0, 80.0]), "x", "t_s")[1] == "s"
    assert seconds(np.array([0.0, 40.0, 80.0]), "x")[1] == "ms"


def test_nanoseconds_keep_their_digits():
    stamps = np.array([1_403_636_579_763_555_584, 1_403_636_579_813_555_456])
    found, _ = seconds(stamps, "x", "t_ns")
    assert found[1] - found[0] == pytest.approx(0.049999872, abs=3e-7)


def test_what_is_no_time_is_refused():
    with pytest.raises(SemlocError, match="not a finite number"):
        seconds(np.array([1.0, np.nan]), "x")
    with pytest.raises(SemlocError, match="name the unit in the column"):
        seconds(np.array([1.0, 1.00000001]), "x")


def test_streams_of_a_drive_belong_together(simulated_road):
    report = overlap_report(open_drive(simulated_road))
    assert report.problems == ()
    assert {span.name for span in report.spans} == {"frames", "fixes", "odometry", "imu", "truth"}
    assert all(span.covered == 1.0 for span in report.spans)
    rate = {span.name: span.rate_hz for span in report.spans}
    assert (rate["frames"], rate["fixes"], rate["imu"]) == pytest.approx((2.0, 5.0, 100.0), rel=1e-3)
    assert "fixes: " in report.to_text() and "covers 100% of the frames" in report.to_text()


def test_streams_apart_and_gaps_are_named(simulated_road):
    drive = open_drive(simulated_road)
    late = replace(drive, gnss=replace(drive.gnss, time_s=drive.gnss.time_s + 1e6))
    (problem,) = overlap_report(late).problems
    assert "have no time in common" in problem and "other clocks, other units, or another drive" in problem
    assert overlap_report(late).apart("fixes") and not overlap_report(late).apart("odometry")
    keep = (drive.imu.time_s < -2.5) | (drive.imu.time_s > -0.5)
    imu = replace(drive.imu, time_s=drive.imu.time_s[keep], gyro_radps=drive.imu.gyro_radps[keep],
                  accel_mps2=drive.imu.accel_mps2[keep])  # fmt: skip
    assert any("imu: a gap of" in problem for problem in overlap_report(replace(drive, imu=imu)).problems)
    half = replace(drive.gnss, time_s=drive.gnss.time_s - drive.gnss.time_s[0] + drive.frames[1].time_s - 0.1)
    assert any("cover 67%" in p for p in overlap_report(replace(drive, gnss=half)).problems)
