"""Seeded drives, made from nothing or on a map: exact masks, masks like a network's, images, sensors, maps, truth."""

from semloc_jax.simulation.degrade import Degradation, degrade
from semloc_jax.simulation.faults import FaultSizes, with_fault
from semloc_jax.simulation.map_drive import simulate_on_map
from semloc_jax.simulation.map_errors import MapErrors
from semloc_jax.simulation.map_masks import render_masks
from semloc_jax.simulation.route import RouteWish
from semloc_jax.simulation.sensor_logs import SensorErrors
from semloc_jax.simulation.simulate import SimulationConfig, is_begun, simulate

__all__ = [
    "Degradation",
    "FaultSizes",
    "MapErrors",
    "RouteWish",
    "SensorErrors",
    "SimulationConfig",
    "degrade",
    "is_begun",
    "render_masks",
    "simulate",
    "simulate_on_map",
    "with_fault",
]
