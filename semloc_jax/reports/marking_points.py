"""The report of a network for marking points: what `semloc learn slots` writes (room: reports; host).

In: SlotLearningConfig, drives that judge. Out: slots.weights, slots.onnx, metrics.json, scores.csv, loss.csv, pictures.
"""

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from semloc_jax.datasets import open_drive
from semloc_jax.evaluation import Metric, format_metrics, write_metrics
from semloc_jax.inputs.mask_source import best_masks, mask_source
from semloc_jax.learning.marking_drives import MarkingDrive, ShownPoints
from semloc_jax.learning.marking_lesson import SlotLearningConfig, judged, taught, threshold_of, unseen_pictures
from semloc_jax.learning.marking_points import PointScore
from semloc_jax.perception.networks.dense_net import DenseNet
from semloc_jax.perception.networks.marking_net import CONFIG, METRES_PER_PX, OUTPUTS, MarkingNet
from semloc_jax.perception.networks.onnx_graph import write_onnx
from semloc_jax.perception.networks.weights import read_card, save_weights
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.lesson import RANDOM, LessonReport, watched_loss
from semloc_jax.reports.tables import write_csv
from semloc_jax.viz.slots import draw_points
from semloc_jax.viz.style import save, sheet

WEIGHTS = "slots.weights"
_PICTURES = 12


def report_marking_points(
    config: SlotLearningConfig,
    held_out: Sequence[Path] = (),
    frames: slice = slice(None),
    begin_with: Path | None = None,
    out: Path | None = None,
) -> LessonReport:
    """Teach the network, judge it by pictures and drives it never saw, write everything.

    Args:
        config: pictures and steps.
        held_out: drives with images, exact masks, a map with slots and true poses; none of them teaches.
        frames: of those drives.
        begin_with: weights of an earlier lesson to go on from, with other pictures and steps.
    """
    folder = make_folder(out)
    with watched_loss(folder, "learn slots", config.training.num_steps) as on_step:
        network = taught(config, folder / "checkpoint", on_step, begin_with)
    sets = {RANDOM: unseen_pictures(config), **{path.name: _of_drive(path, frames) for path in held_out}}
    scores = {name: judged(network, pictures) for name, pictures in sets.items()}
    threshold = threshold_of(scores[RANDOM], config.precision)
    metrics = [metric for name, of in scores.items() for metric in _metrics(name, of[threshold])]
    _write_network(folder, network, threshold, config, metrics, begin_with)
    rows = [
        (name, f"{limit:.2f}", own.num_true, own.num_found, f"{own.recall:.4f}", f"{own.precision:.4f}", *_errors(own))
        for name, of in scores.items()
        for limit, own in of.items()
    ]
    columns = ("set", "threshold", "num_true", "num_found", "recall", "precision", "mean_cm", "mean_deg")
    write_csv(folder / "scores.csv", columns, rows)
    net = MarkingNet(network, threshold)
    for name, pictures in sets.items():
        chosen = pictures[:: max(len(pictures) // _PICTURES, 1)][:_PICTURES]
        save(_drawn(net, chosen), folder / f"{name}.png")
    write_metrics(metrics, folder / "metrics.json")
    write_record(folder, config, {"held_out": [str(path) for path in held_out], "begin_with": str(begin_with or "")})
    said = f"{sum(leaf.size for leaf in jax.tree.leaves(network))} parameters, threshold {threshold:g}"
    return LessonReport(folder, "\n".join([said, format_metrics(metrics), f"results: {folder}"]))


def _of_drive(path: Path, frames: slice) -> list[ShownPoints]:
    drive = open_drive(path)
    shows = MarkingDrive(drive, mask_source(best_masks(drive), drive, None, None))
    return [shows.at(frame) for frame in drive.frames[frames]]


def _errors(own: PointScore) -> tuple[str, str]:
    if not own.off_m:
        return "", ""
    return f"{100.0 * np.mean(own.off_m):.2f}", f"{np.rad2deg(np.mean(own.off_rad)):.2f}"


def _metrics(name: str, own: PointScore) -> list[Metric]:
    found = [
        Metric(f"{name}.recall", own.recall, "share", "higher"),
        Metric(f"{name}.precision", own.precision, "share", "higher"),
        Metric(f"{name}.points", float(own.num_true), "points", "report"),
    ]
    if own.off_m:
        found.append(Metric(f"{name}.mean", float(100.0 * np.mean(own.off_m)), "cm"))
        found.append(Metric(f"{name}.direction", float(np.rad2deg(np.mean(own.off_rad))), "deg"))
    return found


def _write_network(
    folder: Path,
    network: DenseNet,
    threshold: float,
    config: SlotLearningConfig,
    metrics: Sequence[Metric],
    begin_with: Path | None,
) -> None:
    lesson = {
        "pictures": config.num_pictures,
        "steps": config.training.num_steps,
        "rate": config.training.rate,
        "batch": config.batch,
        "seed": config.training.seed,
    }
    before = [] if begin_with is None else _lessons(read_card(begin_with))
    card = {
        "kind": "marking points of parking slots",
        "outputs": OUTPUTS,
        "metres_per_px": METRES_PER_PX,
        "threshold": threshold,
        "threshold_by": f"the lowest one with a precision of {config.precision:g} on random top views",
        "taught_on": f"random top views of {config.size_px} px, eight positions, no real picture, no drive",
        "lessons": [*before, lesson],
        "figures": {metric.key: round(metric.value, 4) for metric in metrics},
        "limits": "rendered top views only; polished floors and worn paint cost points; backs of slots look like "
        "mouths where both ends of a divider are painted alike; at the end of a row the direction may lie between "
        "the divider and the entrance; occupied or free is not told",
    }
    save_weights(folder / WEIGHTS, network, card)
    write_onnx(folder / "slots.onnx", network, CONFIG.num_outputs, output="points")


def _lessons(card: dict) -> list[dict]:
    """Those of earlier weights, as their card has them; cards of one lesson had its values beside all others."""
    return list(card.get("lessons", [{key: card[key] for key in ("steps", "batch", "seed") if key in card}]))


def _drawn(net: MarkingNet, pictures: Sequence[ShownPoints]) -> np.ndarray:
    """Some pictures side by side: truth as rings, what was found as arrows."""
    tiles = [draw_points(one.picture, METRES_PER_PX, net(one.picture, METRES_PER_PX), one.uv_m) for one in pictures]
    return sheet(tiles, columns=4)
