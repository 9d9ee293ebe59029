"""Images become masks, masks become cost maps (room: perception; host).

In: images or mask files. Out: class ids, structs.CostMaps.
"""

from semloc_jax.perception.class_table import Channel, ClassTable, TableReport, load_class_table, preset_names
from semloc_jax.perception.cost_maps import CostMapConfig, cost_maps
from semloc_jax.perception.masks import read_mask

__all__ = [
    "Channel",
    "ClassTable",
    "CostMapConfig",
    "TableReport",
    "cost_maps",
    "load_class_table",
    "preset_names",
    "read_mask",
]
