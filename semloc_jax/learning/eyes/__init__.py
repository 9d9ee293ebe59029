"""Networks taught by the map (room: learning).

In: drives, a map. Out: Eyes whose masks and distances to borders place the drives better than what they began with.
"""
