"""`semloc explain`: which map elements hold the pose, and how far it moves where one of them is wrong (room: cli)."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_jax.cli.drive_options import DriveOptions
from semloc_jax.cli.main import LOST, OK
from semloc_jax.errors import UsageError
from semloc_jax.inputs.drive_inputs import Inputs, open_inputs

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
    from semloc_jax.alignment.pose_prior import PosePrior
    from semloc_jax.alignment.result import LocalizationResult
    from semloc_jax.analysis.explain_check import Check
    from semloc_jax.analysis.explain_drive import ElementRole
    from semloc_jax.analysis.explanation import Explanation, Holder
    from semloc_jax.cameras import Rig


@dataclass(frozen=True)
class Options(DriveOptions):
    """Which map elements hold the pose of a frame, and how far it moves where one of them is wrong.

    Writes explain.csv and explain.json (every element in view, every class, the prior), explain.png (the elements in
    the image, coloured and named by their share), explain_map.png (from above, with arrows to where the vehicle goes)
    and config.yaml. Exit code 3 where the frame cannot be localized.
    With --every K it asks every K-th frame instead and writes drive.csv: which elements hold the drive, and which of
    them nothing can stand in for.
    """

    frame: int = 0
    """Index of the frame."""
    shift_cm: float = 10.0
    """How far each element is taken to be wrong."""
    check: int = 0
    """Localize again with each of so many of the strongest elements moved, and left out, and print what happened."""
    top: int = 12
    """Number of elements that are printed."""
    posterior: bool = False
    """Print all modes of the pose and the 95 % intervals of their mixture; residual correlation taken into account."""
    scatter: int = 0
    """Solve the frame with so many draws of a network's noise on its exact masks, and print how far the pose scatters;
    the drive needs truth."""
    every: int | None = None
    """Explain every K-th frame of the drive instead of one."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "LocalizeConfig":
    """The configuration of `semloc localize`."""
    from semloc_jax.alignment.frame_localizer import LocalizeConfig

    return LocalizeConfig()


def run(options: Options) -> int:
    """Explain one frame, or many."""
    every = 1 if options.every is None else options.every
    if not 0 < options.shift_cm <= 100 or min(options.check, options.scatter) < 0 or min(options.top, every) < 1:
        raise UsageError("--shift-cm: expected 0 to 100; --check, --scatter: 0 or more; --top, --every: 1 or more")
    search = dataclasses.replace(options.settings.search, seed=options.seed)
    settings = dataclasses.replace(options.settings, search=search)
    return _frame(options, settings) if options.every is None else _drive(options, settings)


def _frame(options: Options, settings: "LocalizeConfig") -> int:
    import json

    from semloc_jax import viz
    from semloc_jax.alignment.frame_localizer import FrameLocalizer
    from semloc_jax.analysis.explain import ExplainConfig, explain_frame
    from semloc_jax.analysis.explain_check import leave_one_out
    from semloc_jax.reports import pictures, results
    from semloc_jax.viz.explain import explained_image, explained_map

    inputs = open_inputs(options)
    frame = inputs.frame(options.frame)
    localizer = FrameLocalizer(inputs.map, inputs.masks.table, settings)
    given = (
        inputs.masks.masks(frame),
        inputs.prior(frame),
        inputs.masks.seen_by(frame.rig.select(inputs.masks.cameras)),
    )
    result = localizer.localize(frame, *given)
    if not result.localized:
        print(f"frame {frame.id} is not localized: {'; '.join(result.reasons)}; give another --frame or --masks")
        return LOST
    found = explain_frame(localizer, result, *given, ExplainConfig(options.shift_cm / 100.0))
    print(table(found, options.top))
    if options.posterior:
        print(_posterior(localizer, result, *given))
    if options.scatter:
        print(_scatter(options, settings, inputs))
    checks = []
    if options.check:
        from tqdm import tqdm

        count = min(options.check, len(found.elements))
        steps = leave_one_out(localizer, result, *given, found, count)
        checks = list(tqdm(steps, total=count, unit="element", disable=None))
        print(check_table(checks))
    folder = results.make_folder(options.out)
    results.write_csv(folder / "explain.csv", COLUMNS, [_row(holder) for holder in (*found.holders, *found.classes)])
    (folder / "explain.json").write_text(json.dumps(_record(frame.id, found, checks), indent=1), encoding="utf-8")
    results.write_record(folder, settings, _kept(options, inputs))
    title = f"{inputs.drive.name} frame {frame.id}, masks {inputs.masks.name}: what holds the pose"
    panels = pictures.element_panels(inputs.map, inputs.masks, frame, found.T_map_base)
    print(f"picture: {viz.save(explained_image(panels, found, title), folder / 'explain.png')}")
    around = inputs.map.query(found.T_map_base[:3, 3], pictures.RADIUS_M).elements
    print(f"picture: {viz.save(explained_map(around, found, title), folder / 'explain_map.png')}")
    print(f"results: {folder}")
    return OK


def _posterior(
    localizer: "FrameLocalizer",
    result: "LocalizationResult",
    masks: "Sequence[np.ndarray]",
    prior: "PosePrior",
    rig: "Rig",
) -> str:
    import numpy as np

    from semloc_jax.analysis.pose_mixture import frame_mixture
    from semloc_jax.geometry.local_frame import LocalFrame
    from semloc_jax.reports.pose_posterior import posterior_text

    sigma = prior.to_solver(result.T_map_prior, LocalFrame(result.T_map_prior[:3, 3]), localizer.config.road).sigma
    return posterior_text(frame_mixture(localizer, result, masks, rig, np.asarray(sigma, np.float64)))


def _scatter(options: Options, settings: "LocalizeConfig", inputs: Inputs) -> str:
    from semloc_jax.analysis.seed_errors import seed_errors
    from semloc_jax.reports.pose_posterior import scatter_text

    frames, masks = [inputs.frame(options.frame)], inputs.masks.name
    return scatter_text(seed_errors(inputs.drive, inputs.map, frames, options.scatter, masks, config=settings))


def _drive(options: Options, settings: "LocalizeConfig") -> int:
    from tqdm import tqdm

    from semloc_jax.analysis.explain import ExplainConfig
    from semloc_jax.analysis.explain_drive import element_roles, explain_frames
    from semloc_jax.reports import results

    inputs = open_inputs(options)
    frames = inputs.drive.frames[:: options.every]
    steps = explain_frames(
        inputs.map, inputs.masks, inputs.prior, frames, settings, ExplainConfig(options.shift_cm / 100.0)
    )
    found = list(tqdm(steps, total=len(frames), unit="frame", disable=None))
    folder = results.make_folder(options.out)
    results.write_record(folder, settings, _kept(options, inputs))
    known = [explanation for _, explanation in found if explanation is not None]
    roles = element_roles(known)
    results.write_csv(folder / "drive.csv", ROLE_COLUMNS, [_role_row(role) for role in roles])
    print(f"explained {len(known)} of {len(found)} frames; {len(roles)} elements were in view")
    print(role_table(roles, len(known), options.top))
    print(f"results: {folder}")
    return OK if known else LOST


def _kept(options: Options, inputs: Inputs) -> dict:
    """Options that a configuration file may hold, with their defaults resolved."""
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(Options)}
    resolved = {"masks": inputs.masks.name, "cameras": ",".join(inputs.masks.cameras)}
    return {k: v for k, v in (given | resolved).items() if k not in ("drive", "config", "out") and v is not None}


DIRECTIONS = ("longitudinal_m", "lateral_m", "heading_deg")
COLUMNS = (
    *("id", "class", "x_m", "y_m", "num_points", "observations", "pull", "residual_px"),
    *(f"share_{name.split('_')[0]}" for name in DIRECTIONS),
    *(f"sigma_without_{name}" for name in DIRECTIONS),
    *("shift_x", "shift_y", "linear_to_m"),
    *(f"linear_{name}" for name in DIRECTIONS),
    *(f"shifted_{name}" for name in DIRECTIONS),
    *(f"removed_{name}" for name in DIRECTIONS),
)
ROLE_COLUMNS = (
    *("id", "class", "frames", "share", "most_share", "frame_of_most_share"),
    *("most_moved_m", "frames_irreplaceable"),
)


def _in_units(direction: "np.ndarray") -> list[float]:
    """Longitudinal [m], lateral [m], heading [deg], rounded."""
    import numpy as np

    return [round(float(value), 5) for value in direction * [1.0, 1.0, np.degrees(1.0)]]


def _row(holder: "Holder") -> list:
    """One line of explain.csv."""
    return [
        holder.id,
        holder.label.name.lower() if holder.label is not None else holder.id,
        *(round(float(value), 3) for value in holder.middle_map[:2]),
        holder.num_samples,
        *(round(value, 4) for value in (holder.observations, holder.pull, holder.residual_px)),
        *(round(float(value), 5) for value in holder.share),
        *_in_units(holder.sigma_without),
        *(round(float(value), 4) for value in holder.worst_map[:2]),
        round(holder.linear_to_m, 4),
        *_in_units(holder.linear),
        *_in_units(holder.shifted),
        *_in_units(holder.removed),
    ]


def _record(frame_id: str, found: "Explanation", checks: "Sequence[Check]") -> dict:
    """What explain.json holds: everything of explain.csv, derivatives, checks."""
    import math

    def holders(some: "Sequence[Holder]") -> list[dict]:
        rows = []
        for holder in some:
            row = dict(zip(COLUMNS, _row(holder), strict=True))
            row = {k: v if not isinstance(v, float) or math.isfinite(v) else None for k, v in row.items()}
            by_shift = {name: _in_units(holder.by_shift[:, k]) for k, name in enumerate("xyz")}
            rows.append(row | {"by_shift_per_m": by_shift, "by_turn_per_deg": _in_units(holder.by_turn / 57.29578)})
        return rows

    return {
        "frame": frame_id,
        "directions": DIRECTIONS,
        "T_map_base": found.T_map_base.tolist(),
        "offset_from_localized": _in_units(found.offset),
        "is_exact": found.is_exact,
        "ramp_px": found.ramp_px,
        "sigma": _in_units(found.sigma),
        "shift_m": found.shift_m,
        "most_missed": found.most_missed.id,
        "holders": holders(found.holders),
        "classes": holders(found.classes),
        "checks": [
            {
                "id": c.holder.id,
                "shifted": _in_units(c.shifted),
                "removed": _in_units(c.removed),
                "localized": c.is_localized,
            }
            for c in checks
        ],
    }


def table(found: "Explanation", top: int) -> str:
    """The strongest holders, all classes and the prior, one line each."""
    shift = f"{100 * found.shift_m:g} cm wrong"
    head = f"{'':42}{'share [%]':>17}  {'if ' + shift + ': solver':^24} {'derivative':^16} {'if missing':^16} linear"
    units = f"{'element':34}{'points':>8}{'lon':>6}{'lat':>6}{'head':>6}  {'lon':>7}{'lat':>7} cm{'head':>7}°"
    units += f"{'lon':>7}{'lat':>7} cm{'lon':>7}{'lat':>7} cm up to"
    lines = [head, units, *(_line(holder) for holder in found.elements[:top])]
    if len(found.elements) > top:
        rest = sum(holder.share for holder in found.elements[top:])
        lines.append(f"{f'... {len(found.elements) - top} more':42}" + "".join(f"{100 * s:6.1f}" for s in rest))
    lines += ["", *(_line(holder, " in all") for holder in found.classes)]
    lines += [_line(holder) for holder in found.holders if not holder.is_element]
    lon, lat, heading = _in_units(found.sigma)
    lines.append(f"sigma: longitudinal {100 * lon:.1f} cm, lateral {100 * lat:.1f} cm, heading {heading:.2f} deg")
    missed = found.most_missed
    moved = _in_units(missed.removed)
    lines.append(
        f"most missed: {missed.id}: without it the pose moves {100 * moved[0]:+.1f} cm longitudinal, "
        f"{100 * moved[1]:+.1f} cm lateral, {moved[2]:+.2f} deg"
    )
    lines += [f"no stand-in: {text}" for text in (_irreplaceable(holder, found) for holder in found.elements) if text]
    if not found.is_exact:
        lines.append("the derivative is that of a pose that is not settled to the last digit: the cost is rough here")
    return "\n".join(lines)


def _line(holder: "Holder", more: str = "") -> str:
    shifted, linear, removed = (_in_units(part) for part in (holder.shifted, holder.linear, holder.removed))
    name = holder.id + more
    if holder.is_element and not more:
        name = f"{holder.label.name.lower():15}{holder.id}"
    to = f"{100 * holder.linear_to_m:7.1f}" if holder.is_element else ""
    text = f"{name[:33]:34}{holder.num_samples or '':>8}" + "".join(f"{100 * share:6.1f}" for share in holder.share)
    text += f"  {100 * shifted[0]:+7.1f}{100 * shifted[1]:+7.1f}{shifted[2]:+11.2f}"
    text += f" {100 * linear[0]:+6.1f}{100 * linear[1]:+7.1f}"
    return f"{text}   {100 * removed[0]:+7.1f}{100 * removed[1]:+7.1f}   {to}"


def _irreplaceable(holder: "Holder", found: "Explanation") -> str | None:
    """What becomes of a direction that an element alone holds well; None where others do."""
    import numpy as np

    from semloc_jax.analysis.explain_drive import is_irreplaceable

    if not is_irreplaceable(holder, found):
        return None
    k = int(np.argmax(holder.sigma_without / np.maximum(found.sigma, 1e-9)))
    with_it, without = _in_units(found.sigma)[k], _in_units(holder.sigma_without)[k]
    scale, unit = (1.0, "deg") if k == 2 else (100.0, "cm")
    name = DIRECTIONS[k].split("_")[0]
    return f"{holder.id}: without it the {name} sigma grows from {scale * with_it:.2g} to {scale * without:.2g} {unit}"


def check_table(checks: "Sequence[Check]") -> str:
    """What was foretold and what happened, one line for each element."""
    head = f"{'localized again with':24}{'moved: foretold':>18}{'found':>16}{'left out: foretold':>20}{'found':>16}"
    lines = [f"{head}   [lon lat cm]"]
    for check in checks:
        parts = (check.holder.shifted, check.shifted, check.holder.removed, check.removed)
        cells = [f"{100 * part[0]:+.1f}  {100 * part[1]:+.1f}" for part in parts]
        note = "" if check.is_localized else "   no longer localized"
        lines.append(f"{check.holder.id[:24]:24}{cells[0]:>18}{cells[1]:>16}{cells[2]:>20}{cells[3]:>16}{note}")
    return "\n".join(lines)


def _role_row(role: "ElementRole") -> list:
    numbers = (role.share, role.most_share, role.most_moved_m)
    share, most, moved = (round(float(value), 5) for value in numbers)
    return [
        role.id,
        role.label.name.lower(),
        role.num_frames,
        share,
        most,
        role.most_share_at,
        moved,
        role.num_irreplaceable,
    ]


def role_table(roles: "Sequence[ElementRole]", num_frames: int, top: int) -> str:
    """The elements that hold a drive, and those that nothing stands in for."""
    lines = [f"{'element':24}{'class':16}{'frames':>7}{'share of the drive':>20}{'most':>7}{'10 cm move it':>16}"]
    for role in roles[:top]:
        lines.append(
            f"{role.id[:23]:24}{role.label.name.lower():16}{role.num_frames:7}{100 * role.share:18.1f} %"
            f"{100 * role.most_share:5.0f} %{100 * role.most_moved_m:13.1f} cm"
        )
    alone = sorted((role for role in roles if role.num_irreplaceable), key=lambda role: -role.num_irreplaceable)
    lines += [f"no stand-in: {role.id} in {role.num_irreplaceable} of {num_frames} frames" for role in alone[:top]]
    return "\n".join(lines)
