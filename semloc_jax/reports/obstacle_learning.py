"""The report of a network for obstacles: what `semloc learn obstacles` writes (room: reports; host).

In: ObstacleLearningConfig, drives that judge. Out: obstacles.weights, obstacles.onnx, metrics.json, scores.csv,
loss.csv, pictures.
"""

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from semloc_jax.datasets import open_drive
from semloc_jax.evaluation import Metric, format_metrics, write_metrics
from semloc_jax.evaluation.average_precision import BoxScore
from semloc_jax.inputs.mask_source import best_masks, mask_source
from semloc_jax.learning.obstacle_drives import ObstacleDrive
from semloc_jax.learning.obstacle_lesson import (
    ObstacleLearningConfig,
    ShownObstacles,
    judged,
    mean_precision,
    taught,
    threshold_of,
    unseen_views,
)
from semloc_jax.perception.networks.dense_net import DenseNet
from semloc_jax.perception.networks.obstacle_net import CONFIG, FAR, NEAR, OUTPUTS, PX_PER_RAD, ObstacleNet
from semloc_jax.perception.networks.onnx_graph import write_onnx
from semloc_jax.perception.networks.weights import read_card, save_weights
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.lesson import RANDOM, LessonReport, watched_loss
from semloc_jax.reports.tables import write_csv
from semloc_jax.viz.obstacles import draw_boxes
from semloc_jax.viz.style import save, sheet

WEIGHTS = "obstacles.weights"
RANGES_M = ((0.0, np.inf), (0.0, 3.0), (3.0, 6.0), (6.0, 10.0))
_PICTURES = 12


def report_obstacle_learning(
    config: ObstacleLearningConfig,
    held_out: Sequence[Path] = (),
    frames: slice = slice(None),
    begin_with: Path | None = None,
    out: Path | None = None,
) -> LessonReport:
    """Teach the network, judge it by pictures and drives it never saw, write everything.

    Args:
        config: pictures and steps.
        held_out: drives with images and exact masks that show obstacles; none of them teaches.
        frames: of those drives.
        begin_with: weights of an earlier lesson to go on from, with other pictures and steps.
    """
    folder = make_folder(out)
    with watched_loss(folder, "learn obstacles", config.training.num_steps) as on_step:
        network = taught(config, folder / "checkpoint", on_step, begin_with)
    random_views = unseen_views(config)
    net = ObstacleNet(network, threshold_of(network, random_views, config.precision))
    metrics: list[Metric] = []
    rows: list[tuple] = []
    for name, pictures in [(RANDOM, random_views), *((path.name, obstacle_views(path, frames)) for path in held_out)]:
        scores = {limits: judged(net, pictures, limits) for limits in RANGES_M}
        metrics += _metrics(name, scores[RANGES_M[0]])
        rows += [_row(name, limits, kind, own) for limits, of in scores.items() for kind, own in of.items()]
        save(_drawn(net, pictures), folder / f"{name}.png")
    _write_network(folder, net, config, metrics, begin_with)
    columns = ("set", "from_m", "to_m", "class", "num_true", "ap50", "recall", "precision")
    write_csv(folder / "scores.csv", columns, rows)
    write_metrics(metrics, folder / "metrics.json")
    write_record(folder, config, {"held_out": [str(path) for path in held_out], "begin_with": str(begin_with or "")})
    said = f"{sum(leaf.size for leaf in jax.tree.leaves(network))} parameters, threshold {net.threshold:g}"
    return LessonReport(folder, "\n".join([said, format_metrics(metrics), f"results: {folder}"]))


def obstacle_views(path: Path, frames: slice) -> list[ShownObstacles]:
    """The views of a drive with the true boxes of its exact masks."""
    drive = open_drive(path)
    shows = ObstacleDrive(drive, mask_source(best_masks(drive), drive, None, None))
    return [one for frame in drive.frames[frames] for one in shows.at(frame)]


def _metrics(name: str, scores: dict[str, BoxScore]) -> list[Metric]:
    found = [Metric(f"{name}.ap50", mean_precision(scores), "share", "higher")]
    for kind, own in scores.items():
        if own.num_true:
            found.append(Metric(f"{name}.{kind}.ap50", own.average_precision, "share", "higher"))
            found.append(Metric(f"{name}.{kind}.num", float(own.num_true), "boxes", "report"))
    return found


def _row(name: str, limits: tuple[float, float], kind: str, own: BoxScore) -> tuple:
    shares = (own.average_precision, own.recall, own.precision)
    told = ["" if np.isnan(share) else f"{share:.4f}" for share in shares]
    return (name, f"{limits[0]:g}", f"{limits[1]:g}", kind, own.num_true, *told)


def _write_network(
    folder: Path,
    net: ObstacleNet,
    config: ObstacleLearningConfig,
    metrics: Sequence[Metric],
    begin_with: Path | None,
) -> None:
    lesson = {
        "pictures": config.num_pictures,
        "steps": config.training.num_steps,
        "rate": config.training.rate,
        "level_share": config.training.level_share,
        "far_share": config.far_share,
        "batch": config.batch,
        "seed": config.training.seed,
    }
    before = [] if begin_with is None else list(read_card(begin_with).get("lessons", ()))
    card = {
        "kind": "obstacles of parking lots on an upright cylinder",
        "outputs": OUTPUTS,
        "px_per_rad": PX_PER_RAD,
        "threshold": net.threshold,
        "threshold_by": f"the lowest one with a precision of {config.precision:g} on random views",
        "taught_on": "windows of random views, no real picture, no drive",
        "looks_at": [{"rows": look.rows, "scale": round(look.scale, 4)} for look in (NEAR, FAR)],
        "lessons": [*before, lesson],
        "figures": {metric.key: round(metric.value, 4) for metric in metrics if np.isfinite(metric.value)},
        "limits": "rendered views only; cameras 0.5 to 1.5 m over the road; things up to 10 m away of at least 4 x 8 "
        "px; where things stand whose foot is hidden is not told",
    }
    save_weights(folder / WEIGHTS, net.network, card)
    network: DenseNet = net.network
    write_onnx(folder / "obstacles.onnx", network, CONFIG.num_outputs, CONFIG.num_inputs, output="obstacles")


def _drawn(net: ObstacleNet, pictures: Sequence[ShownObstacles]) -> np.ndarray:
    """Some pictures with what was found in them, those with most to find first."""
    chosen = sorted(pictures, key=lambda one: -int(one.is_asked.sum()))[:_PICTURES]
    tiles = [draw_boxes(one.picture, net(one.picture), one.box, one.is_asked) for one in chosen]
    return sheet(tiles)
