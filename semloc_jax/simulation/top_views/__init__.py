"""Random top views of parking slots with their marking points: what a network is taught on (room: simulation; host).

In: seeds. Out: pictures uint8[n n 3] as a surround view would show them, and the points in them.
"""
