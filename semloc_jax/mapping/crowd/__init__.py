"""Many drives make one map and keep it alive (room: mapping; host).

In: packed drives, a base map. Out: a map that is better than any of them, and what has changed.
"""
