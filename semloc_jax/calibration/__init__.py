"""A vehicle's sensors calibrated by its own drives, and what these cannot tell (room: calibration)."""

from semloc_jax.calibration.config import CalibrationPriors, FrameFactors, SelfCalibrationConfig
from semloc_jax.calibration.frames import StartPoses, motion_between
from semloc_jax.calibration.observability import CalibrationDirection, Knowledge, Observability, Parameter
from semloc_jax.calibration.self_calibration import SelfCalibration, calibrate_from, mount_change, self_calibrate

__all__ = [
    "CalibrationPriors",
    "CalibrationDirection",
    "FrameFactors",
    "Observability",
    "Parameter",
    "SelfCalibration",
    "SelfCalibrationConfig",
    "Knowledge",
    "StartPoses",
    "calibrate_from",
    "motion_between",
    "mount_change",
    "self_calibrate",
]
