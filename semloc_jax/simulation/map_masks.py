"""Exact masks of a map as cameras see it, without a drive (room: simulation; host).

In: a SemanticMap, Rig, T_map_base. Out: masks in the class ids of the preset `drive`.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8

from semloc_jax.cameras import Rig
from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import SemanticMap
from semloc_jax.simulation.map_scene import build_map_world
from semloc_jax.simulation.render import PixelRays
from semloc_jax.simulation.render_classes import MaskRenderer
from semloc_jax.simulation.route import drivable

_AHEAD_M = 60.0
"""The road under the vehicle is taken to go on straight this far."""


def render_masks(
    semantic_map: SemanticMap, rig: Rig, T_map_base: Float[np.ndarray, "4 4"]
) -> list[UInt8[np.ndarray, "h w"]]:
    """The mask of every camera of a vehicle at `T_map_base`: what a perfect network would say.

    Nothing but the map is in the picture: no traffic, no houses. What stands hides what is behind it.

    Args:
        semantic_map: The map; elements are solid, paint lies on the road through its points.
        rig: Cameras.
        T_map_base: Vehicle pose in the map frame.

    Returns:
        Class ids of the preset `drive`, one mask for each camera.

    Raises:
        SemlocError: nothing of the map is near.

    >>> mask = sj.render_masks(street, rig, sj.planar_pose(2.0, 0.1, 0.01))[0]
    >>> names = sj.load_class_table("drive").id_names
    >>> mask.shape, sorted({names[int(number)] for number in np.unique(mask)})
    ((400, 640), ['lane_solid', 'road', 'sky', 'stop_line', 'terrain'])
    """
    forward = T_map_base[:2, 0] / np.linalg.norm(T_map_base[:2, 0])
    route = T_map_base[:2, 3] + np.linspace(0.0, _AHEAD_M, 61)[:, None] * forward
    path = drivable(route, 10.0)
    world = build_map_world(semantic_map, (), path, _AHEAD_M, 10.0, 0.0, np.random.default_rng(0))
    parked = CLASS_IDS["vehicle"]
    solids = tuple(solid for solid in world.scene.solids if solid.class_id != parked)
    scene = replace(world.scene, solids=solids, traffic=lambda time_s: ())
    return [
        MaskRenderer(scene, PixelRays(camera), T_base_cam).classes(np.asarray(T_map_base) @ T_base_cam, 0.0)
        for camera, T_base_cam in zip(rig.cameras, np.asarray(rig.T_base_cam), strict=True)
    ]
