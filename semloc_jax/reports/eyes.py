"""The report of a network that a map has taught: what `semloc learn eyes` writes (room: reports; host).

In: drives with a map. Out: weights, ONNX, rounds.json, report.md, pictures.
"""

import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from semloc_jax.errors import UsageError
from semloc_jax.inputs.drive_inputs import InputOptions, Inputs, open_inputs
from semloc_jax.learning.eyes.batches import LabelledImage
from semloc_jax.learning.eyes.lessons import Lesson
from semloc_jax.learning.eyes.teach import EyesConfig, Round, best_round, taught, taught_table
from semloc_jax.perception.network import NetworkPreset, NetworkSegmenter
from semloc_jax.perception.networks.eyes import Eyes
from semloc_jax.perception.networks.onnx_graph import write_onnx
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.lesson import LessonReport, step_bar
from semloc_jax.storage import write_text
from semloc_jax.viz.eyes import RoundLook, draw_looks, draw_rounds, draw_taught
from semloc_jax.viz.style import save

_LOG = logging.getLogger(__name__)
BEST = "eyes.weights"
_LOOKED_AT = 5


class EyesDrives(NamedTuple):
    """What teaches and what judges.

    Args:
        learned_from: drives that teach.
        held_out: the drive that judges; None for the first that teaches.
        map: map of all of them, see `InputOptions`.
        masks: what there is at the beginning.
        frames: which frames teach.
        held_out_frames: which frames judge; they do not teach.
        cameras: names; None for the default of the drive.
        prior: of the drives that teach.
        network: another network whose scores the eyes see; None for eyes of their own.
        begin: eyes to go on with; None for new ones.
    """

    learned_from: tuple[Path, ...]
    held_out: Path | None = None
    map: str | None = None
    masks: str = "classical"
    frames: slice = slice(None)
    held_out_frames: slice = slice(None, None, 10)
    cameras: tuple[str, ...] | None = None
    prior: str | None = None
    network: NetworkPreset | None = None
    begin: Eyes | None = None


def report_eyes(drives: EyesDrives, config: EyesConfig | None = None, out: Path | None = None) -> LessonReport:
    """Teach, judge each round, write everything.

    Raises:
        UsageError: there is nothing to learn from, or all frames that could teach judge.
        SemlocError: no pose is good enough to teach, or the drive held out has no truth.
    """
    if not drives.learned_from:
        raise UsageError("no drives to learn from; expected DRIVE ..., with images and a map")
    config = config or EyesConfig()
    judge = drives.held_out or drives.learned_from[0]
    inputs = {path: _open(path, drives) for path in dict.fromkeys((*drives.learned_from, judge))}
    held_out = _lesson(inputs[judge], inputs[judge].drive.frames[drives.held_out_frames])
    judging = {frame.id for frame in held_out.frames}
    lessons = [
        _lesson(inputs[path], _teaching(inputs[path], drives, judging if path == judge else set()))
        for path in drives.learned_from
    ]
    folder = make_folder(out)
    helper = None if drives.network is None else NetworkSegmenter(drives.network)

    def on_round(k: int, found: Round) -> None:
        _LOG.info("%s", round_row(k, found))

    def on_labels(images: Sequence[LabelledImage]) -> None:
        chosen = [images[i] for i in np.unique(np.linspace(0, len(images) - 1, _LOOKED_AT).astype(int))]
        alike = [image for image in chosen if image.picture.shape == chosen[0].picture.shape]
        save(draw_taught(alike, taught_table(lessons, drives.begin)), folder / "labels.png")

    rounds = taught(lessons, held_out, config, folder, on_round, helper, drives.begin, step_bar, on_labels)
    best = best_round(rounds)
    if best:
        rounds[best].eyes.save(folder / BEST)
        make = rounds[best].eyes.config
        write_onnx(folder / "eyes.onnx", rounds[best].eyes.network, make.num_outputs, make.num_inputs)
    text = rounds_table(rounds, best)
    _write_json(folder / "rounds.json", rounds, best)
    write_text(folder / "report.md", text + "\n")
    write_record(folder, config, {"masks": drives.masks, "map": drives.map, "held_out": str(judge)})
    save(draw_rounds([found.score for found in rounds]), folder / "rounds.png")
    save(draw_looks(_looks(held_out, rounds)), folder / "frames.png")
    return LessonReport(folder, text)


def _open(path: Path, drives: EyesDrives) -> Inputs:
    cameras = ",".join(drives.cameras) if drives.cameras else None
    return open_inputs(InputOptions(path, map=drives.map, masks=drives.masks, cameras=cameras, prior=drives.prior))


def _lesson(inputs: Inputs, frames: Sequence) -> Lesson:
    return Lesson(inputs.drive, inputs.map, inputs.masks, tuple(frames), inputs.prior)


def _teaching(inputs: Inputs, drives: EyesDrives, judging: set[str]) -> tuple:
    """The frames of a drive that teach.

    Raises:
        UsageError: there are none.
    """
    frames = tuple(frame for frame in inputs.drive.frames[drives.frames] if frame.id not in judging)
    if not frames:
        raise UsageError(
            f"drive {inputs.drive.name}: all of its frames judge; give other --frames or --held-out-frames"
        )
    return frames


def round_row(number: int, found: Round) -> str:
    """One line of the table."""
    score = found.score
    across, along, heading = (f"{a:.3f} / {b:.2f}" for a, b in zip(score.median, score.p95, strict=True))
    within = " / ".join(f"{100 * share:.0f}" for share in score.within)
    name = str(number) if found.lesson == "labels" else f"{number}, {found.lesson}"
    return (
        f"| {name} | {found.num_poses} | {found.num_distrusted} | {score.num_accepted} of {score.num_frames} "
        f"| {score.num_false} | {across} | {along} | {heading} | {within} |"
    )


def rounds_table(rounds: Sequence[Round], best: int) -> str:
    """Scores of every round on the frames held out."""
    lines = [
        "| round | frames that taught | elements denied | accepted | false | across, median / p95 [m] | along [m] "
        "| heading [deg] | within 1 / 2 / 3 sigma [%] |",
        "|---|---|---|---|---|---|---|---|---|",
        *(round_row(k, found) for k, found in enumerate(rounds)),
        "",
        f"kept: round {best}, {BEST}" if best else "no round was better than what there was: no network is kept",
    ]
    return "\n".join(lines)


def _write_json(path: Path, rounds: Sequence[Round], best: int) -> None:
    content = [
        found.score._asdict()
        | {"num_poses": found.num_poses, "num_distrusted": found.num_distrusted, "lesson": found.lesson}
        for found in rounds
    ]
    write_text(path, json.dumps({"best": best, "rounds": content}, indent=1) + "\n")


def _looks(held_out: Lesson, rounds: Sequence[Round]) -> list[list[RoundLook]]:
    """The same frames of the first camera in every round, one row a round."""
    places = np.linspace(0, len(held_out.frames) - 1, min(_LOOKED_AT, len(held_out.frames))).astype(int)
    frames, rows = [held_out.frames[i] for i in np.unique(places)], []
    for found in rounds:
        masks = held_out.seen_with(found.eyes)
        camera = masks.cameras[0]
        rows.append([RoundLook(frame.image(camera), masks.segment(frame, camera), masks.table) for frame in frames])
    return rows
