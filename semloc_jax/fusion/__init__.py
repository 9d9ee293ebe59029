"""Motion, measured poses and satellite fixes become one pose over time (room)."""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "prediction": ("MotionLog",),
        "measurements": (
            "PoseMeasurement",
            "GnssMeasurement",
            "SingleFrameFusion",
        ),
        "inertial_fusion": ("InertialFusion",),
        "kalman": ("KalmanFusion",),
        "window": (
            "SlidingWindow",
            "WindowConfig",
        ),
    },
)
