"""Seeded drives made from nothing: exact masks, masks like a network's, images, sensors, maps and truth."""

from semloc_jax.datasets.synthetic.degrade import Degradation, degrade
from semloc_jax.datasets.synthetic.map_errors import MapErrors
from semloc_jax.datasets.synthetic.sensor_logs import SensorErrors
from semloc_jax.datasets.synthetic.simulate import SimulationConfig, simulate

__all__ = ["Degradation", "MapErrors", "SensorErrors", "SimulationConfig", "degrade", "simulate"]
