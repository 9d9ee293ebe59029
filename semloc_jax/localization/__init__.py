"""Time goes forward in a map: frames one by one, or a whole drive tracked (room)."""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "localizer": (
            "Localizer",
            "TrackConfig",
        ),
        "pipeline": ("Pipeline",),
        "track_state": (
            "TrackResult",
            "TrackStatus",
        ),
        "integrity": (
            "IntegrityConfig",
            "protection_levels",
        ),
    },
)
