"""Weights, kernel and noise of the localizer learned through its own solve, eyes taught by the map (room: learning)."""

from semloc_jax.learning.accuracy import Accuracy, localizer_accuracy
from semloc_jax.learning.calibrate import calibrated
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.fit import Fit, fit
from semloc_jax.learning.loss import frame_loss, pose_nll
from semloc_jax.learning.parameters import Learned, Parameters, learned_config, learned_values
from semloc_jax.learning.scenes import TrainingFrame, training_frame, training_frames

__all__ = [
    "Accuracy",
    "Fit",
    "Learned",
    "LearningConfig",
    "Parameters",
    "TrainingFrame",
    "calibrated",
    "localizer_accuracy",
    "fit",
    "frame_loss",
    "learned_config",
    "learned_values",
    "pose_nll",
    "training_frame",
    "training_frames",
]
