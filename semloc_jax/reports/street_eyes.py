"""The report of eyes that random streets have taught: what `semloc learn eyes --simulated` writes (room: reports;
host).

In: EyesConfig. Out: eyes.weights, eyes.onnx, classes.csv, loss.csv, loss.png, held_out.png, scenes/manifest.json.
"""

import csv
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from semloc_jax.learning.eyes.batches import LabelledImage
from semloc_jax.learning.eyes.street_lesson import ClassScore, StreetLesson, taught_on_streets
from semloc_jax.learning.eyes.teach import EyesConfig
from semloc_jax.perception.networks.eyes import Eyes
from semloc_jax.perception.networks.onnx_graph import write_onnx
from semloc_jax.reports.eyes import BEST, EyesReport
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.tables import write_csv
from semloc_jax.storage import append_line
from semloc_jax.viz.eyes import draw_curve
from semloc_jax.viz.style import save

LOSSES = "loss.csv"
_EVERY = 20
"""Steps whose mean loss is one line of the curve."""
_PICTURES = 24
_COLOURS = ((0, 229, 255), (255, 79, 163), (179, 136, 255), (118, 255, 3), (255, 138, 128), (40, 80, 255))


def report_street_eyes(config: EyesConfig, begin: Eyes | None = None, out: Path | None = None) -> EyesReport:
    """Teach eyes on random streets, judge them by scenes held out, write everything.

    Args:
        config: `streets` of it.
        begin: eyes to go on with; None for new ones.
        out: folder to write, where a lesson that stopped goes on; None for a new one in results/.
    """
    folder = make_folder(out)
    recent: list[float] = []
    with tqdm(total=config.streets.training.num_steps, unit="step", desc="learn eyes", disable=None) as bar:

        def on_step(step: int, loss: float) -> None:
            recent.append(loss)
            bar.update(step - bar.n)
            if step % _EVERY == 0:
                append_line(folder / LOSSES, f"{step},{np.mean(recent):.5f}")
                recent.clear()

        lesson = taught_on_streets(config.streets, folder, begin, on_step)
    _write_network(folder, lesson)
    write_csv(
        folder / "classes.csv",
        ("class", "recall", "precision", "error_px", "within_1", "within_2", "within_3"),
        [(s.name, *(f"{v:.4f}" for v in (s.recall, s.precision, s.error_px, *s.within))) for s in lesson.scores],
    )
    save(draw_curve(*_curve(folder / LOSSES)), folder / "loss.png")
    save(_looks(lesson.eyes, lesson.held_out), folder / "held_out.png")
    write_record(folder, config, {"simulated": True})
    return EyesReport(folder, classes_table(lesson.scores))


def _write_network(folder: Path, lesson: StreetLesson) -> None:
    lesson.eyes.save(folder / BEST)
    make = lesson.eyes.config
    write_onnx(folder / "eyes.onnx", lesson.eyes.network, make.num_outputs, make.num_inputs)


def _curve(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Steps and mean losses; of a step that was made twice, after a stop, the last."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    by_step = {int(step): float(loss) for step, loss in csv.reader(lines)}
    steps = sorted(by_step)
    return np.array(steps), np.array([by_step[step] for step in steps])


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
    columns = 4
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    return np.vstack([np.hstack(tiles[k : k + columns]) for k in range(0, len(tiles), columns)])
