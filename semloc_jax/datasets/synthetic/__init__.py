"""Seeded drives, made from nothing or on a map: exact masks, masks like a network's, images, sensors, maps, truth."""

from semloc_jax.datasets.synthetic.degrade import Degradation, degrade
from semloc_jax.datasets.synthetic.map_drive import simulate_on_map
from semloc_jax.datasets.synthetic.map_errors import MapErrors
from semloc_jax.datasets.synthetic.route import RouteWish
from semloc_jax.datasets.synthetic.sensor_logs import SensorErrors
from semloc_jax.datasets.synthetic.simulate import SimulationConfig, simulate

__all__ = [
    "Degradation",
    "MapErrors",
    "RouteWish",
    "SensorErrors",
    "SimulationConfig",
    "degrade",
    "simulate",
    "simulate_on_map",
]
