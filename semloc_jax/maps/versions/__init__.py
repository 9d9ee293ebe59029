"""Versions of a map: content hashes by tile, exact differences, history, the way back (room: maps; host).

In: maps, differences. Out: differences, maps that are equal to the byte, the list of versions.
"""
