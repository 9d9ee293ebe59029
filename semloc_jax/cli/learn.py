"""`semloc learn`: class weights, ramp, tilt and noise learned through the solve from drives with truth (room: cli)."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from semloc_jax.cli.main import OK

if TYPE_CHECKING:
    from semloc_jax.alignment.frame_localizer import LocalizeConfig
    from semloc_jax.inputs.drive_inputs import Inputs
    from semloc_jax.learning import Accuracy, Fit, LearningConfig

LEARNED = "learned.yaml"
_COLUMNS = (("position_m", 100, 2), ("p95_m", 100, 1), ("heading_deg", 1, 3), ("nees", 1, 2), ("nees_median", 1, 2))
"""Of the report: name, factor, digits."""


@dataclass(frozen=True)
class Options:
    """Learn from drives with truth what the localizer assumes: a weight for each class of map elements, the finest ramp
    (where the robust kernel lets go), how far the vehicle tilts against the road, and the length of contour that is one
    observation.

    What is minimised is the negative log-likelihood of the true poses, with derivatives through the solve: accuracy and
    honesty of the covariance together. Drives for validation decide when to stop and how wide the covariance is. Writes
    learned.yaml, which every verb takes as its --config, report.md and report.json with the errors on every drive
    before and after, and config.yaml.

    Judge it by the drives that are held out. Every value of the configuration is an option too, e.g. --num-frames 30.
    """

    drives: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DRIVE...")]
    """Drives to learn from: folders with maps, masks and truth, all with the same classes in their masks."""
    validation: tuple[Path, ...] = ()
    """Drives that say when to stop, and how wide the covariance is; default: those that are learned from."""
    held_out: tuple[Path, ...] = ()
    """Drives to judge by only."""
    maps: tuple[str, ...] = ()
    """Names of maps of every drive (exact, errors): each drive is taken once with each of them; default: its own."""
    masks: str = "sem_net"
    """Mask folder of every drive: masks like those that will be localized with."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "LearningConfig":
    """How is learned if nothing is said."""
    from semloc_jax.learning import LearningConfig

    return LearningConfig()


def run(options: Options) -> int:
    """Learn, judge, write; returns the exit code.

    Raises:
        UsageError: there is nothing to learn from.
    """
    from tqdm import tqdm

    from semloc_jax.errors import UsageError
    from semloc_jax.learning import (
        calibrated,
        fit,
        learned_config,
        learned_values,
        training_frames,
    )
    from semloc_jax.reports import results

    if not options.drives:
        raise UsageError("no drives to learn from; expected DRIVE ..., folders with map, masks and truth")
    config = options.settings
    every = (*options.drives, *options.validation, *options.held_out)
    inputs = {(path, name): _open(path, options.masks, name) for path in every for name in options.maps or (None,)}
    table = _common_table(inputs)
    folder = results.make_folder(options.out)
    frames, validation = [], []
    for number, ((path, _), given) in enumerate(tqdm(inputs.items(), unit="drive", desc="frames", disable=None)):
        if path not in options.held_out:
            kept = validation if path in options.validation else frames
            kept += training_frames(given.drive, given.map, given.masks, config, number)
    with tqdm(unit="step", desc="learning", disable=None) as bar:

        def told(loss: float) -> None:
            bar.update()
            bar.set_postfix(loss=f"{loss:.3f}")

        found = fit(frames, len(table.channels), config, validation, told)
    asked = options.validation or options.drives
    drives = [(given.drive, given.map, given.masks) for (path, _), given in inputs.items() if path in asked]
    values = calibrated(learned_values(found.parameters, table, config), drives, config)
    learned = learned_config(values, config.scene)
    rows = [
        (_name(path, name), _role(path, options), *_judged(given, (config.scene, learned), config))
        for (path, name), given in tqdm(inputs.items(), unit="drive", desc="judging", disable=None)
    ]
    _write_learned(folder / LEARNED, config.scene, learned, options)
    others = {"validation": [str(p) for p in options.validation], "held_out": [str(p) for p in options.held_out]}
    results.write_record(folder, config, {"masks": options.masks, "maps": list(options.maps)} | others)
    text = _report(found, rows)
    (folder / "report.md").write_text(text + "\n", encoding="utf-8")
    _write_json(folder / "report.json", found, rows)
    print(text)
    print(f"use it: semloc localize DRIVE --config {folder / LEARNED}")
    return OK


def _open(path: Path, masks: str, name: str | None) -> "Inputs":
    from semloc_jax.inputs.drive_inputs import InputOptions, open_inputs

    return open_inputs(InputOptions(drive=path, masks=masks, prior="truth", map=name))


def _name(path: Path, name: str | None) -> str:
    return path.name if name is None else f"{path.name}, map {name}"


def _role(path: Path, options: Options) -> str:
    if path in options.held_out:
        return "held out"
    return "validation" if path in options.validation else "learned from"


def _common_table(inputs: "dict[tuple[Path, str | None], Inputs]"):
    """The class table of all drives.

    Raises:
        SemlocError: there are several.
    """
    from semloc_jax.errors import SemlocError

    tables = {given.masks.table.name: given.masks.table for given in inputs.values()}
    if len(tables) > 1:
        raise SemlocError(f"learn: the drives have class tables {', '.join(tables)}; expected one; learn one by one")
    return next(iter(tables.values()))


def _judged(given: "Inputs", settings: "tuple[LocalizeConfig, LocalizeConfig]", config: "LearningConfig"):
    from semloc_jax.learning import evaluate

    return [evaluate(given.drive, given.map, given.masks, one, config) for one in settings]


def changes(before: object, after: object) -> dict:
    """What differs between two configurations, as YAML holds it."""
    from semloc_jax.inputs.config_files import is_settings, to_plain

    found = {}
    for name in to_plain(before):
        old, new = getattr(before, name), getattr(after, name)
        if is_settings(old):
            inner = changes(old, new)
            if inner:
                found[name] = inner
        elif old != new:
            found[name] = to_plain(new)
    return found


def _write_learned(path: Path, before: object, after: object, options: Options) -> None:
    import yaml

    from semloc_jax.structs import ElementClass

    order = ", ".join(label.name.lower() for label in ElementClass)
    head = (
        f"# Learned from {', '.join(p.name for p in options.drives)} (masks {options.masks}).\n"
        f"# class_weight in the order {order}.\n"
    )
    content = yaml.safe_dump(changes(before, after), sort_keys=False, default_flow_style=None, width=110)
    path.write_text(head + content, encoding="utf-8")


def _report(found: "Fit", rows: "list[tuple[str, str, Accuracy, Accuracy]]") -> str:
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
        changes = [f"{old.num_far} -> {new.num_far}"]
        for value, scale, digits in _COLUMNS:
            changes.append(f"{scale * getattr(old, value):.{digits}f} -> {scale * getattr(new, value):.{digits}f}")
        inside = [f"{100 * one.within(1):.0f} / {100 * one.within(2):.0f}" for one in (old, new)]
        lines.append(f"| {name} | {role} | {len(old.error)} | {' | '.join([*changes, ' -> '.join(inside)])} |")
    return "\n".join(lines)


def _write_json(path: Path, found: "Fit", rows: "list[tuple[str, str, Accuracy, Accuracy]]") -> None:
    drives = [
        {"drive": name, "role": role, "before": _numbers(old), "after": _numbers(new)} for name, role, old, new in rows
    ]
    content = {"history": list(found.history), "num_used": found.num_used, "drives": drives}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _numbers(accuracy: "Accuracy") -> dict[str, float]:
    names = ("position_m", "p95_m", "heading_deg", "nees", "nees_median", "nll", "num_far")
    return {name: getattr(accuracy, name) for name in names} | {"within": [accuracy.within(k) for k in (1, 2, 3)]}
