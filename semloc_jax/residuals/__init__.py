"""The bridge: map samples seen by cameras, compared with the evidence (room: residuals; pure JAX).

In: the containers of structs. Out: residuals, their fused normal equations, robust costs. It knows neither river.
"""
