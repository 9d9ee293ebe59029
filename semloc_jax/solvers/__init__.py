"""Least squares that knows no residual: one Levenberg-Marquardt, problems, structures, GNC (room: solvers; pure JAX).

In: variables and factors. Out: Solution with the normal equations at the optimum. A sparse problem is factorised by
scipy on the host.
"""
