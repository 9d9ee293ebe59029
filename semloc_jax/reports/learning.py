"""The report of what was learned from drives: what `semloc learn` writes (room: reports; host).

In: drives with truth. Out: learned.yaml, report.md, report.json, config.yaml.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from tqdm import tqdm

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.errors import SemlocError, UsageError
from semloc_jax.inputs.config_files import is_settings, to_plain
from semloc_jax.inputs.drive_inputs import InputOptions, Inputs, open_inputs
from semloc_jax.learning import (
    Accuracy,
    Fit,
    LearningConfig,
    calibrated,
    fit,
    learned_config,
    learned_values,
    localizer_accuracy,
    training_frames,
)
from semloc_jax.perception import ClassTable
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.storage import write_text
from semloc_jax.structs import ElementClass

LEARNED = "learned.yaml"
_COLUMNS = (("position_m", 100, 2), ("p95_m", 100, 1), ("heading_deg", 1, 3), ("nees", 1, 2), ("nees_median", 1, 2))
"""Of the report: name, factor, digits."""

Key = tuple[Path, str | None]
"""A drive and the name of one of its maps."""


class LearningDrives(NamedTuple):
    """Drives with truth.

    Args:
        learned_from: the drives to learn from.
        validation: they say when to stop and how wide the covariance is; empty takes those that are learned from.
        held_out: they are judged only.
        maps: names of maps of every drive, each drive is taken once with each; empty takes its own.
        masks: mask folder of every drive.
    """

    learned_from: tuple[Path, ...]
    validation: tuple[Path, ...] = ()
    held_out: tuple[Path, ...] = ()
    maps: tuple[str, ...] = ()
    masks: str = "sem_net"

    def role(self, path: Path) -> str:
        """What a drive is for."""
        if path in self.held_out:
            return "held out"
        return "validation" if path in self.validation else "learned from"


class LearningReport(NamedTuple):
    """Where everything was written, and the table for people."""

    folder: Path
    text: str


class Row(NamedTuple):
    """A drive of the report: its errors before and after."""

    name: str
    role: str
    before: Accuracy
    after: Accuracy


def report_learning(
    drives: LearningDrives, config: LearningConfig | None = None, out: Path | None = None
) -> LearningReport:
    """Learn, judge every drive before and after, write everything.

    Raises:
        UsageError: there is nothing to learn from.
        SemlocError: the drives have several class tables, or one lacks truth, map or masks.
    """
    if not drives.learned_from:
        raise UsageError("no drives to learn from; expected DRIVE ..., folders with map, masks and truth")
    config = config or LearningConfig()
    every = (*drives.learned_from, *drives.validation, *drives.held_out)
    inputs = {(path, name): _open(path, drives.masks, name) for path in every for name in drives.maps or (None,)}
    table = _common_table(inputs)
    folder = make_folder(out)
    found = _fit(inputs, drives, table, config)
    asked = drives.validation or drives.learned_from
    to_calibrate = [(given.drive, given.map, given.masks) for (path, _), given in inputs.items() if path in asked]
    values = calibrated(learned_values(found.parameters, table, config), to_calibrate, config)
    learned = learned_config(values, config.scene)
    rows = [
        Row(_name(path, name), drives.role(path), *_judged(given, (config.scene, learned), config))
        for (path, name), given in tqdm(inputs.items(), unit="drive", desc="judging", disable=None)
    ]
    _write_learned(folder / LEARNED, config.scene, learned, drives)
    others = {"validation": [str(p) for p in drives.validation], "held_out": [str(p) for p in drives.held_out]}
    write_record(folder, config, {"masks": drives.masks, "maps": list(drives.maps)} | others)
    text = table_of(found, rows)
    write_text(folder / "report.md", text + "\n")
    _write_json(folder / "report.json", found, rows)
    return LearningReport(folder, text)


def _open(path: Path, masks: str, name: str | None) -> Inputs:
    return open_inputs(InputOptions(drive=path, masks=masks, prior="truth", map=name))


def _name(path: Path, name: str | None) -> str:
    return path.name if name is None else f"{path.name}, map {name}"


def _common_table(inputs: Mapping[Key, Inputs]) -> ClassTable:
    tables = {given.masks.table.name: given.masks.table for given in inputs.values()}
    if len(tables) > 1:
        raise SemlocError(
            f"learn: the drives have class tables {', '.join(tables)}; expected one for all; learn from drives of one "
            "table at a time"
        )
    return next(iter(tables.values()))


def _fit(inputs: Mapping[Key, Inputs], drives: LearningDrives, table: ClassTable, config: LearningConfig) -> Fit:
    """The parameters with which the true poses of the drives to learn from are most likely."""
    frames, validation = [], []
    for number, ((path, _), given) in enumerate(tqdm(inputs.items(), unit="drive", desc="frames", disable=None)):
        if path not in drives.held_out:
            kept = validation if path in drives.validation else frames
            kept += training_frames(given.drive, given.map, given.masks, config, number)
    with tqdm(unit="step", desc="learning", disable=None) as bar:

        def on_step(loss: float) -> None:
            bar.update()
            bar.set_postfix(loss=f"{loss:.3f}")

        return fit(frames, len(table.channels), config, validation, on_step)


def _judged(given: Inputs, settings: tuple[LocalizeConfig, LocalizeConfig], config: LearningConfig) -> list[Accuracy]:
    return [localizer_accuracy(given.drive, given.map, given.masks, one, config) for one in settings]


def changes(before: object, after: object) -> dict[str, Any]:
    """What differs between two configurations, as YAML holds it."""
    found: dict[str, Any] = {}
    for name in to_plain(before):
        old, new = getattr(before, name), getattr(after, name)
        if is_settings(old):
            inner = changes(old, new)
            if inner:
                found[name] = inner
        elif old != new:
            found[name] = to_plain(new)
    return found


def _write_learned(path: Path, before: object, after: object, drives: LearningDrives) -> None:
    order = ", ".join(label.name.lower() for label in ElementClass)
    head = (
        f"# Learned from {', '.join(p.name for p in drives.learned_from)} (masks {drives.masks}).\n"
        f"# class_weight in the order {order}.\n"
    )
    content = yaml.safe_dump(changes(before, after), sort_keys=False, default_flow_style=None, width=110)
    write_text(path, head + content)


def table_of(found: Fit, rows: Sequence[Row]) -> str:
    """Errors of every drive before and after as a table."""
    lines = [
        f"{found.num_used} of {found.num_frames} frames learned from: loss {found.history[0]:.3f} before, "
        f"{min(found.history):.3f} after",
        "",
        "| drive | | frames | far off | position, mean [cm] | p95 [cm] | heading [deg] | NEES per direction "
        "| median | within 1 / 2 sigma [%] |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, role, old, new in rows:
        cells = [f"{old.num_far} -> {new.num_far}"]
        for value, scale, digits in _COLUMNS:
            cells.append(f"{scale * getattr(old, value):.{digits}f} -> {scale * getattr(new, value):.{digits}f}")
        inside = [f"{100 * one.within(1):.0f} / {100 * one.within(2):.0f}" for one in (old, new)]
        lines.append(f"| {name} | {role} | {len(old.error)} | {' | '.join([*cells, ' -> '.join(inside)])} |")
    return "\n".join(lines)


def _write_json(path: Path, found: Fit, rows: Sequence[Row]) -> None:
    drives = [
        {"drive": row.name, "role": row.role, "before": _numbers(row.before), "after": _numbers(row.after)}
        for row in rows
    ]
    content = {"history": list(found.history), "num_used": found.num_used, "drives": drives}
    write_text(path, json.dumps(content, indent=1) + "\n")


def _numbers(accuracy: Accuracy) -> dict[str, Any]:
    names = ("position_m", "p95_m", "heading_deg", "nees", "nees_median", "nll", "num_far")
    return {name: getattr(accuracy, name) for name in names} | {"within": [accuracy.within(k) for k in (1, 2, 3)]}
