"""The folder of a run: tables, metrics and pictures, for the command line and notebooks alike (room)."""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "pictures": (
            "calibration_panels",
            "element_panels",
        ),
        "eyes": ("EyesDrives", "report_eyes"),
        "explain_tables": ("explained_elements",),
        "obstacles": ("report_obstacles",),
        "slots": ("report_slots",),
        "surround": ("SurroundSettings", "report_surround"),
    },
)
