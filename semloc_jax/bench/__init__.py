"""The benchmark that anyone can run: one problem, our solver and every peer that is installed (room: bench; host).

In: nothing but a seed. Out: CPU time, success rates, memory and ratios. One file for each peer behind one protocol.
"""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "problem": (
            "FULL_LEVELS",
            "make_problem",
        ),
        "ours": (
            "SemlocPeer",
            "paths",
            "config_of",
            "evidence_of",
        ),
    },
)
