"""Ground floor: rigid motions, geodesy, polylines, planes, similarity fits (room: geometry).

In: arrays. Out: arrays. Knows nothing of cameras, maps or vehicles.
"""
