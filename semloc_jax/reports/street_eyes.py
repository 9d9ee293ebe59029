"""The report of eyes that random streets have taught: what `semloc learn eyes --simulated` writes (room: reports;
host).

In: EyesConfig. Out: eyes.weights, eyes.onnx, classes.csv, loss.csv, loss.png, held_out.png, scenes/manifest.json.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from semloc_jax.learning.eyes.batches import LabelledImage
from semloc_jax.learning.eyes.street_lesson import ClassScore, StreetLesson, taught_on_streets
from semloc_jax.learning.eyes.teach import EyesConfig
from semloc_jax.perception.networks.eyes import Eyes
from semloc_jax.perception.networks.onnx_graph import write_onnx
from semloc_jax.reports.eyes import BEST
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.lesson import LessonReport, watched_loss
from semloc_jax.reports.tables import write_csv
from semloc_jax.viz.style import save, sheet

_PICTURES = 24
_COLOURS = ((0, 229, 255), (255, 79, 163), (179, 136, 255), (118, 255, 3), (255, 138, 128), (40, 80, 255))


def report_street_eyes(config: EyesConfig, begin: Eyes | None = None, out: Path | None = None) -> LessonReport:
    """Teach eyes on random streets, judge them by scenes held out, write everything.

    Args:
        config: `streets` of it.
        begin: eyes to go on with; None for new ones.
    """
    folder = make_folder(out)
    with watched_loss(folder, "learn eyes", config.streets.training.num_steps) as on_step:
        lesson = taught_on_streets(config.streets, folder, begin, on_step)
    _write_network(folder, lesson)
    write_csv(
        folder / "classes.csv",
        ("class", "recall", "precision", "error_px", "within_1", "within_2", "within_3"),
        [(s.name, *(f"{v:.4f}" for v in (s.recall, s.precision, s.error_px, *s.within))) for s in lesson.scores],
    )
    save(_looks(lesson.eyes, lesson.held_out), folder / "held_out.png")
    write_record(folder, config, {"simulated": True})
    return LessonReport(folder, classes_table(lesson.scores))


def _write_network(folder: Path, lesson: StreetLesson) -> None:
    lesson.eyes.save(folder / BEST)
    make = lesson.eyes.config
    write_onnx(folder / "eyes.onnx", lesson.eyes.network, make.num_outputs, make.num_inputs)


def classes_table(scores: Sequence[ClassScore]) -> str:
    """Scores of every class on the scenes held out."""
    lines = [
        "| class | recall of cells | precision | error near borders, median [px] | within 1 / 2 / 3 sigma [%] |",
        "|---|---|---|---|---|",
    ]
    for score in scores:
        within = " / ".join(f"{100.0 * share:.0f}" for share in score.within)
        lines.append(
            f"| {score.name} | {100.0 * score.recall:.0f} % | {100.0 * score.precision:.0f} % | {score.error_px:.2f} "
            f"| {within} |"
        )
    return "\n".join(lines)


def _looks(eyes: Eyes, images: Sequence[LabelledImage]) -> np.ndarray:
    """Some pictures held out, the border that is told of each class in its colour."""
    chosen = images[:: max(len(images) // _PICTURES, 1)][:_PICTURES]
    tiles = []
    for image in chosen:
        said = eyes.said(image.picture.astype(np.float32) / 255.0)
        tile = np.ascontiguousarray(image.picture)
        for k in range(said.signed_px.shape[-1]):
            inside = cv2.resize(said.signed_px[..., k], tile.shape[1::-1], interpolation=cv2.INTER_LINEAR) < 0.0
            contours, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(tile, contours, -1, _COLOURS[k % len(_COLOURS)], 1, cv2.LINE_AA)
        tiles.append(tile)
    return sheet(tiles, columns=4)
