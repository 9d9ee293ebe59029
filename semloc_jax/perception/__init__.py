"""Images become masks, masks become cost maps (room: perception; host).

In: images or mask files. Out: class ids, structs.CostMaps.
"""

from semloc_jax.perception.class_table import Channel, ClassTable, TableReport, load_class_table, preset_names, table_of
from semloc_jax.perception.classical_paint import ClassicalPaintSegmenter
from semloc_jax.perception.cost_maps import CostMapConfig, cost_maps
from semloc_jax.perception.ground_view import GroundView
from semloc_jax.perception.mask_offset import MaskOffset, estimate_mask_offset
from semloc_jax.perception.masks import read_mask
from semloc_jax.perception.paint_candidates import PaintConfig

__all__ = [
    "Channel",
    "ClassTable",
    "TableReport",
    "load_class_table",
    "preset_names",
    "table_of",
    "read_mask",
    "MaskOffset",
    "estimate_mask_offset",
    "CostMapConfig",
    "cost_maps",
    "ClassicalPaintSegmenter",
    "PaintConfig",
    "GroundView",
]
