"""PandaSet: a real drive with six cameras, labelled lidar points and boxes."""

from semloc_jax.datasets.pandaset.build import build_map, calibrated
from semloc_jax.datasets.pandaset.reader import PandaSetDrive, is_pandaset, read_pandaset

__all__ = ["PandaSetDrive", "build_map", "calibrated", "is_pandaset", "read_pandaset"]
