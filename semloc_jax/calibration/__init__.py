"""A vehicle's sensors calibrated by its own drives, and what these cannot tell (room: calibration)."""

from semloc_jax.calibration.config import CalibrationPriors, FrameFactors, SelfCalibrationConfig
from semloc_jax.calibration.observability import CalibrationDirection, Knowledge, Observability, Parameter
from semloc_jax.calibration.self_calibration import SelfCalibration, self_calibrate

__all__ = [
    "CalibrationPriors",
    "CalibrationDirection",
    "FrameFactors",
    "Observability",
    "Parameter",
    "SelfCalibration",
    "SelfCalibrationConfig",
    "Knowledge",
    "self_calibrate",
]
