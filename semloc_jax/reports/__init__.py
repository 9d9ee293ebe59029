"""The folder of a run: tables, metrics and pictures, for the command line and notebooks alike (room).

What every report takes: `out`, the folder to write (None for a new one in results/; a stopped lesson goes on in
its own), `resume`, that of a run that was killed, to go on with, `settings` or `config` (None for the defaults), and
`options`, what config.yaml keeps besides these.
"""

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
