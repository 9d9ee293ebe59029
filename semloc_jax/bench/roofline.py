"""How far an evaluation is from what one core can do (room: bench; host).

In: this core; CPU time of an evaluation. Out: measured peaks, counted work, the share of the peak that is reached.
An evaluation is one pass over the points: cost, gradient and Gauss-Newton Hessian of one pose at one level.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from semloc_jax.bench import machine

FLOP_A_POINT = {
    "move into the camera: 3 x (3 multiply, 3 add)": 18,
    "pinhole: reciprocal, 2 multiply, 2 x (multiply, add)": 7,
    "texel: scale, clip twice, split": 14,
    "taps to float, bilinear value and gradient": 24,
    "Tukey weight and cost": 11,
    "gradient by the point in the camera": 9,
    "lever arm: cross product": 9,
    "weighting of the row": 8,
    "21 + 6 + 1 sums of products": 56,
    "rotation of the row, amortised": 24,
}
"""The smallest number of operations we found, counted by hand; a fused multiply-add is two."""
BYTES_A_POINT = 3 * 4 + 4 + 4 + 4
"""Point, class, weight and one packed texel of four taps."""


@dataclass(frozen=True)
class Roofs:
    """Measured peaks of one core."""

    matmul_gflops: float
    """float32 matrix product: every lane multiplies and adds."""
    stream_gbps: float
    """Copy that does not fit any cache, bytes read and written."""
    cache_gbps: float
    """Copy that stays in the second-level cache."""
    gather_mps: float
    """Million texels a second, read at random places of textures as large as the problem's."""


def flop_a_point() -> int:
    """Operations of one point in one evaluation."""
    return sum(FLOP_A_POINT.values())


def measure_roofs(seconds: float = 0.2) -> Roofs:
    """Peaks of the core that this process is pinned to.

    Args:
        seconds: Least CPU time spent on each.
    """
    import jax
    import jax.numpy as jnp

    rng = np.random.default_rng(0)
    a = rng.random((768, 768), np.float32)
    product = np.empty_like(a)
    matmul_s = _best(lambda: np.matmul(a, a, out=product), seconds)
    big, small = np.zeros(2**25, np.float32), np.zeros(2**16, np.float32)
    big_copy, small_copy = big.copy(), small.copy()
    stream_s = _best(lambda: np.copyto(big_copy, big), seconds)
    cache_s = _best(lambda: np.copyto(small_copy, small), seconds)
    texels = jnp.asarray(rng.integers(0, 2**32, 3 * (16000 + 2 * 64000 + 256000), dtype=np.uint32))
    index = jnp.asarray(rng.integers(0, len(texels), 2**16, dtype=np.int32))
    gather = jax.jit(lambda texels, index: texels.at[index].get(mode="promise_in_bounds"))
    gather_s = _best(lambda: jax.block_until_ready(gather(texels, index)), seconds)
    return Roofs(
        matmul_gflops=2 * 768**3 / matmul_s * 1e-9,
        stream_gbps=2 * big.nbytes / stream_s * 1e-9,
        cache_gbps=2 * small.nbytes / cache_s * 1e-9,
        gather_mps=len(index) / gather_s * 1e-6,
    )


def roofs_of(core: int | None) -> Roofs:
    """Peaks of a core, measured by a process of its own that is pinned to it."""
    words = [sys.executable, "-m", "semloc_jax.bench.roofline", *([] if core is None else [str(core)])]
    done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True, env=os.environ | machine.ONE_THREAD)
    return Roofs(**json.loads(done.stdout))


def _best(call: Callable[[], object], seconds: float) -> float:
    """CPU time of one call [s]: the least of groups that are long enough to be timed."""
    call()
    begin, group, times = time.process_time(), 1, []
    while time.process_time() - begin < seconds or len(times) < 3:
        start = time.process_time()
        for _ in range(group):
            call()
        spent = time.process_time() - start
        if spent < seconds / 20:
            group *= 2
            continue
        times.append(spent / group)
    return min(times)


def floor_us(roofs: Roofs, num_points: int) -> dict[str, float]:
    """Least time of an evaluation [us] by each of the roofs alone."""
    return {
        "arithmetic": num_points * flop_a_point() / roofs.matmul_gflops * 1e-3,
        "cache": num_points * BYTES_A_POINT / roofs.cache_gbps * 1e-3,
        "texels": num_points / roofs.gather_mps,
    }


def placed(roofs: Roofs, num_points: int, evaluation_us: dict[str, float]) -> list[dict[str, float | str]]:
    """Where each path lies: time of an evaluation, GFLOP/s of counted work, share of the matrix peak.

    Args:
        roofs: Measured peaks.
        num_points: Points of the problem.
        evaluation_us: CPU time of an evaluation by path [us].
    """
    work = num_points * flop_a_point()
    return [
        {
            "path": name,
            "evaluation_us": us,
            "gflops": work / us * 1e-3,
            "share_of_peak": work / us * 1e-3 / roofs.matmul_gflops,
        }
        for name, us in evaluation_us.items()
    ]


def as_data(roofs: Roofs, num_points: int, evaluation_us: dict[str, float]) -> dict:
    """The roofline as plain data for a JSON file."""
    return {
        "roofs": asdict(roofs),
        "flop_a_point": flop_a_point(),
        "bytes_a_point": BYTES_A_POINT,
        "points": num_points,
        "floor_us": floor_us(roofs, num_points),
        "paths": placed(roofs, num_points, evaluation_us),
    }


def lines(data: dict) -> str:
    """The roofline as text."""
    roofs, floor = data["roofs"], data["floor_us"]
    head = (
        f"one core: {roofs['matmul_gflops']:.0f} GFLOP/s (float32 matrix product), {roofs['cache_gbps']:.0f} GB/s in "
        f"cache, {roofs['stream_gbps']:.0f} GB/s from memory, {roofs['gather_mps']:.0f} M texels/s\n"
        f"an evaluation of {data['points']} points: {data['flop_a_point']} FLOP and {data['bytes_a_point']} bytes a "
        f"point; at least {floor['arithmetic']:.2f} us by arithmetic, {floor['cache']:.2f} by cache, "
        f"{floor['texels']:.2f} by texels"
    )
    rows = [
        f"{path['evaluation_us']:8.2f} us {path['gflops']:7.1f} GFLOP/s {100 * path['share_of_peak']:5.1f} %  "
        f"{path['path']}"
        for path in data["paths"]
    ]
    return "\n".join([head, *rows])


if __name__ == "__main__":
    machine.pin(int(sys.argv[1]) if len(sys.argv) > 1 else None)
    print(json.dumps(asdict(measure_roofs())))
