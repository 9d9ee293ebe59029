"""From residuals to poses: one pose, many hypotheses, modes (room: solvers; pure JAX).

In: evidence and a prior. Out: PoseEstimate, Modes. Optimistix and lineax are used here only.
"""
