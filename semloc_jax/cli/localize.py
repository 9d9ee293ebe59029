"""`semloc localize`: where was the vehicle in each frame of a drive (room: cli)."""

import dataclasses
import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_jax.cli.drive_options import DriveOptions
from semloc_jax.cli.main import LOST, OK
from semloc_jax.inputs.choices import parse_slice
from semloc_jax.inputs.drive_inputs import Inputs, open_inputs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from semloc_jax.alignment.frame_localizer import LocalizeConfig
    from semloc_jax.alignment.result import LocalizationResult


@dataclass(frozen=True)
class Options(DriveOptions):
    """Localize frames of a drive in a map, each on its own, and judge every pose.

    Writes trajectory.tum (localized frames), frames.csv (every frame with its status), hypotheses.csv (every mode),
    metrics.json where the drive has a truth, config.yaml (resolved; reads back with --config) and overlays/*.png.

    Every value of the configuration is an option too, e.g. --verdict.max-cost 0.6: 'semloc config' prints them all.
    The exit code is 3 when fewer frames were localized than --min-localized-share asks for.
    """

    frames: str = ":"
    """Which frames, as a Python slice: ::5, 10:20, 7."""
    hypotheses: int | None = None
    """Start poses of the search; default: that of the configuration."""
    min_localized_share: float = 0.5
    """Exit code 3 below this share of localized frames."""
    overlays: int = 6
    """Number of before/after pictures, spread over the frames; 0 for none."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "LocalizeConfig":
    """How a frame is localized if nothing is said."""
    from semloc_jax.alignment.frame_localizer import LocalizeConfig

    return LocalizeConfig()


def run(options: Options) -> int:
    """Localize with the configuration that was parsed."""
    return localize(options, _settings(options, options.settings))


def localize(options: Options, settings: "LocalizeConfig") -> int:
    """Localize, write everything, say how good it is; returns the exit code."""
    from semloc_jax.maps import write_drive_geojson
    from semloc_jax.reports import results

    logging.basicConfig(format="%(message)s")
    logging.getLogger("semloc_jax").setLevel(logging.INFO)
    chosen = parse_slice(options.frames)
    inputs = open_inputs(options)
    folder = results.make_folder(options.out)
    if inputs.is_map_made:
        write_drive_geojson(inputs.map, folder / "map.geojson")
    started = time.perf_counter()
    found = _localize(inputs, chosen, settings)
    wall_s = time.perf_counter() - started

    truth = results.truth_of(inputs.drive, found)
    results.write_tables(found, truth, folder)
    results.write_record(folder, settings, _options_to_keep(options, inputs))
    if truth:
        print(results.write_metrics_of(found, truth, folder))
    if options.overlays > 0:
        from semloc_jax.reports import pictures

        pictures.write_overlays(folder, inputs.map, inputs.masks, found, options.overlays)
    print(_summary(found, wall_s))
    if (shift := results.shift_text(results.shifts(found))) is not None:
        print(shift)
    print(f"results: {folder}")
    share = sum(result.localized for result in found) / len(found)
    return OK if share >= options.min_localized_share else LOST


def _settings(options: Options, settings: "LocalizeConfig") -> "LocalizeConfig":
    """The configuration with what the verb's own options say about it."""
    num = settings.search.num_hypotheses if options.hypotheses is None else options.hypotheses
    search = dataclasses.replace(settings.search, num_hypotheses=num, seed=options.seed)
    return dataclasses.replace(settings, search=search)


def _localize(inputs: Inputs, chosen: slice, settings: "LocalizeConfig") -> "list[LocalizationResult]":
    """One result for each frame, with a progress bar on a terminal."""
    from tqdm import tqdm

    from semloc_jax.localization.frame_by_frame import localize_frames

    with tqdm(total=len(inputs.drive.frames[chosen]), unit="frame", disable=None) as bar:
        return localize_frames(
            inputs.drive,
            inputs.map,
            inputs.masks,
            inputs.prior,
            chosen,
            inputs.masks.cameras,
            settings,
            on_frame=lambda result: bar.update(),
        )


def _options_to_keep(options: Options, inputs: Inputs) -> dict:
    """Options that a configuration file may hold, with their defaults resolved."""
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(Options)}
    resolved = {"masks": inputs.masks.name, "cameras": ",".join(inputs.masks.cameras)}
    dropped = ("drive", "config", "out")
    return {key: value for key, value in (given | resolved).items() if key not in dropped and value is not None}


def _summary(found: "Sequence[LocalizationResult]", wall_s: float) -> str:
    import numpy as np

    num = sum(result.localized for result in found)
    frame_s = [sum(result.times.values()) for result in found]
    lines = [f"localized {num} of {len(found)} frames in {wall_s:.1f} s"]
    if len(found) > 1:
        rest_ms = 1e3 * np.median(frame_s[1:])
        lines.append(f"first frame {frame_s[0]:.1f} s with compilation, then {rest_ms:.0f} ms each")
    lost = [result for result in found if not result.localized]
    lines += [f"not localized: frame {r.frame.id} ({r.status.name}: {'; '.join(r.reasons)})" for r in lost[:5]]
    if len(lost) > 5:
        lines.append(f"... and {len(lost) - 5} more, see frames.csv")
    return "\n".join(lines)
