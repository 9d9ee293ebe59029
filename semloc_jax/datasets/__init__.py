"""Recorded and simulated drives behind one face."""

from semloc_jax.datasets.base import Frame, Sequence
from semloc_jax.datasets.detect import open_sequence
from semloc_jax.datasets.drive import read_drive
from semloc_jax.datasets.folder import read_folder
from semloc_jax.datasets.gnss import GnssPrior, gnss_prior
from semloc_jax.datasets.pandaset import PandaSetSequence, read_pandaset
from semloc_jax.datasets.sensors import GnssTrack, Imu, WheelOdometry

__all__ = [
    "Frame",
    "GnssPrior",
    "GnssTrack",
    "Imu",
    "PandaSetSequence",
    "Sequence",
    "WheelOdometry",
    "gnss_prior",
    "open_sequence",
    "read_drive",
    "read_folder",
    "read_pandaset",
]
