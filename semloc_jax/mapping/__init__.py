"""The map grows: a map made from a drive, without one that somebody else made (room: mapping; host).

In: a drive with masks, wheels and gyro. Out: BeliefMap, trajectory and metrics of `semloc map`.
"""
