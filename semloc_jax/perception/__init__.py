"""Images become masks, masks become cost maps (room: perception; host).

In: images or mask files. Out: class ids, structs.CostMaps.
"""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "class_table": (
            "Channel",
            "ClassTable",
            "TableReport",
            "load_class_table",
            "preset_names",
            "table_of",
        ),
        "masks": ("read_mask",),
        "mask_offset": (
            "MaskOffset",
            "estimate_mask_offset",
        ),
        "cost_maps": ("CostMapConfig",),
        "classical_paint": ("ClassicalPaintSegmenter",),
        "paint_candidates": ("PaintConfig",),
        "ground_view": ("GroundView",),
    },
)
