"""Random views on an upright cylinder of what stands on parking lots: what a network is taught on (room: simulation).

In: seeds. Out: pictures uint8[h w 3] as `CylinderView` shows them, with box, foot and class of each obstacle in them.
"""
