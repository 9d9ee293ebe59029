"""Poses from explicit shapes that are associated with the landmarks of a compact map (room: alignment; host).

In: primitives of masks, landmarks, a prior. Out: a pose, its covariance, what was matched (Xiao 2018; MLVHM 2020).
"""
