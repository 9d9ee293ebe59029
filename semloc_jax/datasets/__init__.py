"""Recorded and simulated drives behind one face."""

from semloc_jax.datasets.bags import read_bag, write_bag
from semloc_jax.datasets.base import Drive, Frame
from semloc_jax.datasets.detect import open_drive
from semloc_jax.datasets.drive import read_drive
from semloc_jax.datasets.folder import read_folder
from semloc_jax.datasets.gnss import GnssPrior, gnss_prior
from semloc_jax.datasets.overlap import OverlapReport, overlap_report
from semloc_jax.datasets.pandaset import PandaSetDrive, read_pandaset
from semloc_jax.datasets.sensors import GnssTrack, Imu, WheelOdometry

__all__ = [
    "Frame",
    "GnssPrior",
    "GnssTrack",
    "Imu",
    "OverlapReport",
    "PandaSetDrive",
    "Drive",
    "WheelOdometry",
    "gnss_prior",
    "open_drive",
    "overlap_report",
    "read_bag",
    "read_drive",
    "read_folder",
    "read_pandaset",
    "write_bag",
]
