"""Recordings of ROS 1 and ROS 2 (bag, db3, mcap) (room: datasets; host).

In: a bag. Out: Sequence; and back.
"""

from semloc_jax.datasets.bags.reader import is_bag, read_bag
from semloc_jax.datasets.bags.writer import write_bag

__all__ = ["is_bag", "read_bag", "write_bag"]
