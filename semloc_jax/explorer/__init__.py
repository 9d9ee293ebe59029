"""A local page on which one drags the pose of a frame and sees what the solver sees (room: explorer).

In: a drive, its map, masks. Out: a page at 127.0.0.1: `serve` until it is interrupted, `ExplorerServer` from Python.
"""

from semloc_jax.explorer.placement import Placement
from semloc_jax.explorer.server import ExplorerServer, serve
from semloc_jax.explorer.session import ExplorerSession

__all__ = ["ExplorerServer", "ExplorerSession", "Placement", "serve"]
