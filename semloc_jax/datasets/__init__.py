"""Recorded and simulated drives behind one face."""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "base": (
            "Drive",
            "Frame",
        ),
        "detect": ("open_drive",),
        "drive": ("read_drive",),
        "folder": ("read_folder",),
        "bags.reader": ("read_bag",),
        "bags.writer": ("write_bag",),
        "pandaset.reader": (
            "PandaSetDrive",
            "read_pandaset",
        ),
        "gnss": (
            "GnssPrior",
            "gnss_prior",
        ),
        "overlap": (
            "OverlapReport",
            "overlap_report",
        ),
        "sensors": (
            "GnssTrack",
            "Imu",
            "WheelOdometry",
        ),
    },
)
