"""Ground floor: rigid motions, geodesy, polylines, planes, similarity fits (room: geometry).

In: arrays. Out: arrays. It does not depend on cameras, maps or vehicles.
"""
