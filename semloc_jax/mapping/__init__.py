"""The map grows: a map made from a drive, without one that somebody else made (room: mapping; host).

In: a drive with masks, wheels and gyro. Out: BeliefMap, trajectory and metrics of `semloc map`.
"""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "chain": ("Chain", "drive_chain"),
        "chain_graph": ("ChainGraphConfig", "Loops", "Start", "solve_chain"),
        "gauge": ("gauge_of",),
        "looking": ("RoadLookConfig",),
        "mapper": ("MapConfig", "make_map"),
        "slot_sights": ("SlotSightConfig",),
        "place_search": ("View", "lead_nats", "search_places"),
    },
)
