"""The report of an explained pose: what `semloc explain` writes (room: reports; host).

In: opened inputs, a frame or many. Out: explain.csv, explain.json and pictures; drive.csv; text.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from semloc_jax import viz
from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.analysis.explain import ExplainConfig, explain_frame
from semloc_jax.analysis.explain_check import ElementEffect, leave_one_out
from semloc_jax.analysis.explain_drive import element_roles, explain_frames
from semloc_jax.analysis.explanation import Explanation
from semloc_jax.analysis.pose_mixture import frame_mixture
from semloc_jax.analysis.seed_errors import errors_by_seed
from semloc_jax.cameras import Rig
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.inputs.drive_inputs import Inputs
from semloc_jax.reports import pictures
from semloc_jax.reports.explain_files import COLUMNS, ROLE_COLUMNS, explanation_record, holder_row, role_row
from semloc_jax.reports.explain_tables import check_table, explained_elements, posterior_text, role_table, scatter_text
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.tables import write_csv
from semloc_jax.storage import write_text
from semloc_jax.viz.explain import explained_image, explained_map


class Extras(NamedTuple):
    """What is computed besides the explanation of a frame.

    Args:
        num_checks: so many of the strongest elements are moved and left out, and the frame is localized again.
        has_posterior: whether all modes and the 95 % intervals of their mixture are listed.
        num_draws: number of draws of mask noise whose poses' scatter is stated; needs exact masks and a truth.
    """

    num_checks: int = 0
    has_posterior: bool = False
    num_draws: int = 0


class ExplainReport(NamedTuple):
    """Explanations that were written.

    Args:
        explanations: of the frames that were localized; empty where none was.
        folder: where everything was written; None where nothing was.
        text: tables for people.
    """

    explanations: tuple[Explanation, ...]
    folder: Path | None
    text: str


def report_explanation(
    inputs: Inputs,
    index: int = 0,
    settings: LocalizeConfig | None = None,
    shift_m: float = 0.1,
    extras: Extras | None = None,
    num_listed: int = 12,
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> ExplainReport:
    """Explain the pose of one frame and write everything about it.

    Args:
        inputs: Drive, map, masks and prior.
        index: Of the frame; negative ones count from the end.
        settings: How the frame is localized; None for the defaults.
        shift_m: How far each element is taken to be wrong [m].
        extras: What is computed besides; None for nothing.
        num_listed: Number of elements in the text.
    """
    settings, extras = settings or LocalizeConfig(), extras or Extras()
    frame = inputs.frame(index)
    localizer = FrameLocalizer(inputs.map, inputs.masks.table, settings)
    rig = inputs.masks.seen_by(frame.rig.select(inputs.masks.cameras))
    given = (inputs.masks.masks(frame), inputs.prior(frame), rig)
    result = localizer.localize(frame, *given)
    if not result.localized:
        reasons = "; ".join(result.reasons)
        text = f"frame {frame.id} is not localized: {reasons}; give another --frame or --masks"
        return ExplainReport((), None, text)
    found = explain_frame(localizer, result, *given, ExplainConfig(shift_m))
    told = f"frame {frame.id} (number {frame.index} of 0 ... {len(inputs.drive) - 1}), masks {inputs.masks.name}"
    lines = [told, explained_elements(found, num_listed)]
    if extras.has_posterior:
        lines.append(_posterior(localizer, result, *given))
    if extras.num_draws:
        drawn = (inputs.drive, inputs.map, [frame], extras.num_draws, inputs.masks.name)
        lines.append(scatter_text(errors_by_seed(*drawn, config=settings)))
    count = min(extras.num_checks, len(found.elements))
    steps = leave_one_out(localizer, result, *given, found, count) if count else ()
    checks = list(tqdm(steps, total=count, unit="element", disable=None if count else True))
    lines += [check_table(checks)] if checks else []
    folder = make_folder(out)
    write_record(folder, settings, options or {})
    _write_files(folder, result, found, checks)
    lines += [f"picture: {path}" for path in _write_pictures(folder, inputs, result, found)]
    return ExplainReport((found,), folder, "\n".join(lines))


def _posterior(
    localizer: FrameLocalizer, result: LocalizationResult, masks: Sequence[np.ndarray], prior: PosePrior, rig: Rig
) -> str:
    local = LocalFrame(result.T_map_prior[:3, 3])
    sigma = prior.to_solver(result.T_map_prior, local, localizer.config.road).sigma
    return posterior_text(frame_mixture(localizer, result, masks, rig, np.asarray(sigma, np.float64)))


def _write_files(folder: Path, result: LocalizationResult, found: Explanation, checks: Sequence[ElementEffect]) -> None:
    write_csv(folder / "explain.csv", COLUMNS, [holder_row(holder) for holder in (*found.holders, *found.classes)])
    record = explanation_record(result.frame.id, found, checks)
    write_text(folder / "explain.json", json.dumps(record, indent=1))


def _write_pictures(folder: Path, inputs: Inputs, result: LocalizationResult, found: Explanation) -> list[Path]:
    """The elements in the image and from above, coloured by their share."""
    title = f"{inputs.drive.name} frame {result.frame.id}, masks {inputs.masks.name}: what holds the pose"
    panels = pictures.element_panels(inputs.map, inputs.masks, result.frame, found.T_map_base)
    around = inputs.map.query(found.T_map_base[:3, 3], pictures.RADIUS_M).elements
    return [
        viz.save(explained_image(panels, found, title), folder / "explain.png"),
        viz.save(explained_map(around, found, title), folder / "explain_map.png"),
    ]


def report_explained_drive(
    inputs: Inputs,
    every: int,
    settings: LocalizeConfig | None = None,
    shift_m: float = 0.1,
    num_listed: int = 12,
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> ExplainReport:
    """Explain every `every`-th frame of a drive and write which elements hold it; arguments as above."""
    settings = settings or LocalizeConfig()
    frames = inputs.drive.frames[::every]
    steps = explain_frames(inputs.map, inputs.masks, inputs.prior, frames, settings, ExplainConfig(shift_m))
    found = list(tqdm(steps, total=len(frames), unit="frame", disable=None))
    folder = make_folder(out)
    write_record(folder, settings, options or {})
    known = tuple(explanation for _, explanation in found if explanation is not None)
    roles = element_roles(known)
    write_csv(folder / "drive.csv", ROLE_COLUMNS, [role_row(role) for role in roles])
    head = f"explained {len(known)} of {len(found)} frames; {len(roles)} elements were in view"
    return ExplainReport(known, folder, f"{head}\n{role_table(roles, len(known), num_listed)}")
