"""Numerical self-tests of this machine: does compiled code compute what it should (room: bench).

In: nothing. Out: Check results with a remedy for each failure.
"""

from dataclasses import dataclass

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.cameras import KannalaBrandtCamera
from semloc_jax.geometry import lie

JIT_SIZES = ((np.float64, 16384), (np.float32, 32768))
"""Above these numbers of rows jax 0.10.2 computes wrong sums on CPU (jax-ml/jax#39103)."""
WRONG_JAX = {
    "0.10.2": "computes silently wrong results on CPU (jax-ml/jax#39103)",
    "0.11.0": "is hundreds of times slower in scatter-add on GPU",
    "0.11.1": "makes CPU loops that write into big arrays quadratic",
}
REINSTALL = "pip install 'jax>=0.10.1,!=0.10.2,!=0.11.0,!=0.11.1'"


@dataclass(frozen=True)
class Check:
    """One thing that was checked: what, whether it is right, what was found and, if wrong, what to do."""

    name: str
    is_ok: bool
    found: str
    remedy: str = ""


def run_checks() -> list[Check]:
    """Every self-test, in the order in which a person would ask."""
    checks = [check_jax_version(jax.__version__)]
    checks += [check_compiled_sum(dtype, rows + 1) for dtype, rows in JIT_SIZES]
    return [*checks, check_motion(), check_fisheye(), check_mask_codec()]


def check_jax_version(version: str) -> Check:
    """Whether this release of JAX is one that computes right and fast."""
    fault = WRONG_JAX.get(version)
    return Check("jax release", fault is None, f"{version} {fault or 'has no known fault'}", REINSTALL if fault else "")


def check_compiled_sum(dtype: type, rows: int) -> Check:
    """Squared lengths of many vectors times one matrix, compiled, against NumPy: the case of jax-ml/jax#39103."""
    rng = np.random.default_rng(0)
    # The matrix is one for all rows and a constant of the program: with one matrix a row the fault does not show.
    matrix = rng.normal(size=(3, 3)).astype(dtype)
    vectors = rng.normal(size=(rows, 3)).astype(dtype)
    expected = np.sum((vectors.astype(np.float64) @ matrix.astype(np.float64).T) ** 2, axis=1)
    with jax.enable_x64(dtype == np.float64):
        function = jax.vmap(lambda x: jnp.sum((jnp.asarray(matrix) @ x) ** 2))
        given = jnp.asarray(vectors)
        results = {"compiled": np.asarray(jax.jit(function)(given)), "eager": np.asarray(function(given))}
    scale = np.maximum(np.abs(expected), 1.0)
    errors = {name: float(np.max(np.abs(result - expected) / scale)) for name, result in results.items()}
    tolerance = 1e-12 if dtype == np.float64 else 1e-4
    found = ", ".join(f"{name} {error:.1e}" for name, error in errors.items())
    return Check(
        f"compiled sums of {rows} rows, {np.dtype(dtype).name}",
        max(errors.values()) < tolerance,
        f"largest relative error: {found}",
        f"compiled code is wrong on this machine: {REINSTALL}",
    )


def check_motion() -> Check:
    """exp and log of rigid motions are inverse to each other in float32, through the compiler."""
    xi = np.random.default_rng(1).uniform(-1.0, 1.0, size=(257, 6)).astype(np.float32)
    back = np.asarray(jax.jit(lambda value: lie.log(lie.exp(value)))(jnp.asarray(xi)))
    error = float(np.abs(back - xi).max())
    return Check("rigid motions", error < 1e-5, f"largest log(exp(xi)) - xi {error:.1e}", "reinstall jaxlie and jax")


def check_fisheye() -> Check:
    """The fisheye projection agrees with OpenCV."""
    camera = KannalaBrandtCamera(
        fx=300.0, fy=301.0, cx=320.0, cy=240.0, width=640.0, height=480.0,
        k1=0.05, k2=-0.01, k3=0.002, k4=-0.0003, max_theta_rad=1.6,
    )  # fmt: skip
    points = np.random.default_rng(2).uniform([-2, -2, 0.5], [2, 2, 5], size=(100, 3))
    K = np.array([[300.0, 0.0, 320.0], [0.0, 301.0, 240.0], [0.0, 0.0, 1.0]])
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), K, np.array([0.05, -0.01, 0.002, -0.0003])
    )
    uv, _ = camera.project(jnp.asarray(points, jnp.float32))
    error_px = float(np.abs(np.asarray(uv) - expected[:, 0]).max())
    return Check("fisheye against OpenCV", error_px < 0.01, f"largest difference {error_px:.1e} px", "reinstall opencv")


def check_mask_codec() -> Check:
    """Class ids survive being written to a PNG file and read again."""
    mask = np.random.default_rng(3).integers(0, 256, size=(33, 47), dtype=np.uint8)
    written, data = cv2.imencode(".png", mask)
    same = written and np.array_equal(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), mask)
    return Check(
        "mask files", bool(same), "ids unchanged" if same else "ids changed", "reinstall opencv-python-headless"
    )
