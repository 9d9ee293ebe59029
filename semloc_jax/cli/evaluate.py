"""`semloc evaluate`: errors of a trajectory against a reference, with an optional gate (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from semloc_jax.cli.main import LOST, OK


@dataclass(frozen=True)
class Options:
    """Errors of a trajectory against a reference in the vehicle frame of the reference, unaligned unless --align asks.

    Both are TUM, KITTI or npy files. With --baseline the exit code is 3 when a metric got worse than it allows.
    """

    estimate: tyro.conf.Positional[Path]
    """Estimated trajectory."""
    reference: tyro.conf.Positional[Path]
    """True trajectory."""
    max_difference_s: float = 0.02
    """Poses belong together when their times differ by no more than this."""
    align: Literal["none", "se2", "se3"] = "none"
    """Take one rigid motion out first, in the plane or in space: for trajectories in a frame of their own."""
    baseline: Path | None = None
    """A metrics.json to compare with."""
    out: Path | None = None
    """Write metrics.json (and errors.png) into this folder."""


def run(options: Options) -> int:
    """Print the metrics, write them where asked, compare them with the baseline."""
    import numpy as np

    from semloc_jax import evaluation

    estimate = evaluation.read_trajectory(options.estimate)
    reference = evaluation.read_trajectory(options.reference)
    if options.align != "none":
        estimate, motion = evaluation.aligned(estimate, reference, options.align, options.max_difference_s)
        turn_deg = np.rad2deg(np.arccos(np.clip(0.5 * np.trace(motion[:3, :3]) - 0.5, -1.0, 1.0)))
        print(f"aligned ({options.align}): turned by {turn_deg:.4f} deg, moved by {np.round(motion[:3, 3], 4)} m")
    metrics = evaluation.evaluate(estimate, reference, options.max_difference_s)
    print(evaluation.format_metrics(metrics))
    if options.out is not None:
        from semloc_jax.viz import save, trajectory

        options.out.mkdir(parents=True, exist_ok=True)
        evaluation.write_metrics(metrics, options.out / "metrics.json")
        save(trajectory.errors_over_time(estimate, reference, options.max_difference_s), options.out / "errors.png")
    if options.baseline is None:
        return OK
    verdicts = evaluation.compare(metrics, evaluation.read_metrics(options.baseline))
    print(evaluation.format_verdicts(verdicts))
    return OK if evaluation.is_passed(verdicts) else LOST
