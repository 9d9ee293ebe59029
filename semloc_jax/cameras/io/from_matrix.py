"""A camera from the numbers that a calibration prints: K, size, distortion (room: cameras; JAX).

In: camera matrix [px], image size [px], distortion coefficients. Out: Camera.
The numbers may be traced: a pose found with the camera can be differentiated by them.
"""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from semloc_jax.cameras.base import Camera
from semloc_jax.cameras.io.fields import intrinsics_of, numbers, perspective, resolution
from semloc_jax.cameras.models import find_model
from semloc_jax.errors import SemlocError

_WHERE = "camera_from_K"
_CALLED = {0: "none", 4: "radtan", 5: "radtan", 8: "rational", 12: "rational", 14: "rational"}
"""Distortion model that OpenCV means by a number of coefficients."""


def camera_from_K(
    K: Float[ArrayLike, "3 3"] | Sequence[Sequence[Any]],
    size: Sequence[float | int] | np.ndarray,
    distortion: Float[ArrayLike, " k"] | Sequence[Any] | None = None,
    model: str | None = None,
) -> Camera:
    """The camera of a camera matrix.

    Args:
        K: `[[fx 0 cx] [0 fy cy] [0 0 1]]` in pixels; the centre of the top-left pixel is (0, 0), as in OpenCV.
        size: Width and height of the image [px].
        distortion: None for none; k1 k2 p1 p2 [k3] as OpenCV's `calibrateCamera` prints them (8, 12 or 14 numbers: its
            rational model); k1 k2 k3 k4 of a fisheye with `model="equidistant"`.
        model: `none`, `radtan`, `equidistant`, `rational`, `angle_polynomial`; None takes what OpenCV means by the
            number of coefficients. Four numbers may be either: a fisheye has to be named.

    Raises:
        SemlocError: K has skew or is no camera matrix, the numbers do not fit the model, or the distortion is traced by
            jit (the radius up to which it is valid has to be found from its values; close over it).

    >>> camera = sj.camera_from_K([[500, 0, 319.5], [0, 500, 199.5], [0, 0, 1]], (640, 400), (-0.1, 0.02, 0, 0))
    >>> uv, valid = camera.project(np.array([0.0, 0.0, 10.0]))  # a point 10 m ahead lies at the principal point
    >>> [float(x) for x in uv], bool(valid)
    ([319.5, 199.5], True)
    """
    coefficients = () if distortion is None else distortion
    count = len(coefficients)
    if model is None and count not in _CALLED:
        raise SemlocError(f"{_WHERE}: given {count} numbers of distortion; expected 4, 5, 8, 12 or 14 numbers")
    model = (model or _CALLED[count]).strip().lower()
    if not (_is_traced(K) or _is_traced(coefficients)):
        matrix = numbers(K, (9,), f"{_WHERE}: K")
        return perspective(intrinsics_of(matrix, _WHERE), resolution(size, _WHERE), model, coefficients, _WHERE)
    if [len(row) for row in K] != [3, 3, 3]:
        raise SemlocError(f"{_WHERE}: K of rows {[len(row) for row in K]}; expected [3 3]")
    return _traced_camera((K[0][0], K[1][1], K[0][2], K[1][2], *size), model, coefficients, count)


def _traced_camera(pixels: tuple, model: str, coefficients: Any, count: int) -> Camera:
    """As `perspective`, without a look at the values, which are not known yet."""
    row = find_model("pinhole", model)
    if row is None or count not in row.counts:
        raise SemlocError(
            f"{_WHERE}: model '{model}' with {count} coefficients cannot be traced; expected none, radtan with 4 or 5 "
            "or equidistant with 4"
        )
    try:
        return row.camera.of_numbers(pixels, tuple(coefficients))
    except jax.errors.ConcretizationTypeError as error:
        raise SemlocError(
            f"{_WHERE}: the distortion is traced by jit; expected values. Close over it, or differentiate without jit "
            "around the call"
        ) from error


def _is_traced(values: Any) -> bool:
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))
