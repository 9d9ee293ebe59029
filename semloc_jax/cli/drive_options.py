"""Options of every verb that works on a drive, and several drives in one command line (room: cli)."""

import contextlib
import dataclasses
import importlib
import io
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from semloc_jax.cli.main import FAILED, LOST, OK
from semloc_jax.inputs.drive_inputs import InputOptions, Inputs

if TYPE_CHECKING:
    from semloc_jax.reports.fleet import FleetPlace, FleetRow


NOT_KEPT = ("drive", "config", "out", "resume", "rrd", "settings", "others", "jobs", "ray")
"""Options that say where things are, and the configuration, which is kept beside the options."""


@dataclass(frozen=True)
class DriveOptions(InputOptions):
    """Options of every verb that works on a drive."""

    drive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE")]
    """The drive: a folder or a bag (.bag, .db3, .mcap), its type is guessed."""

    def kept(self, inputs: Inputs) -> dict:
        """The options that config.yaml keeps, with the defaults that the drive resolved."""
        given = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        resolved = {"masks": inputs.masks.name, "cameras": ",".join(inputs.masks.cameras)}
        kept = {key: value for key, value in (given | resolved).items() if key not in NOT_KEPT}
        return {key: value for key, value in kept.items() if value is not None and value is not False}


@dataclass(frozen=True)
class FleetOptions(DriveOptions):
    """Options of verbs that take several drives."""

    others: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="[DRIVE...]")] = ()
    """More drives: each is run as if alone, into a folder of --out with its name; fleet.csv and the console say how it
    went, and --resume DIR continues with the drives that are not finished."""
    jobs: int = 1
    """Drives that are run at the same time, each in a process of its own."""
    ray: bool = False
    """On a Ray cluster (RAY_ADDRESS, else one on this machine) instead of processes; needs the extra [ray]."""


def run_each(verb: str, options: Any) -> int:
    """Run a verb with every drive of its options; the exit code is that of the worst."""
    from semloc_jax.errors import UsageError
    from semloc_jax.reports import fleet

    if options.jobs < 1:
        raise UsageError(f"--jobs {options.jobs}: expected 1 or more")
    if getattr(options, "rrd", None) is not None:
        raise UsageError(f"--rrd {options.rrd}: one recording holds one drive; give one drive")
    own = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}
    work = partial(_run_one, verb, own)
    drives = (options.drive, *options.others)
    report = fleet.report_fleet(work, drives, options.out, options.resume, options.jobs, options.ray)
    print(report.text)
    print(f"results: {report.folder}")
    return FAILED if report.has(fleet.FAILED) else LOST if report.has(fleet.LOST) else OK


def _run_one(verb: str, own: dict[str, Any], place: "FleetPlace") -> "FleetRow":
    """Run the verb with one drive; what it says goes into a file beside its results."""
    from semloc_jax.cli.arguments import with_settings
    from semloc_jax.errors import SemlocError
    from semloc_jax.reports.fleet import DONE, TEXT, FleetRow, num_frames
    from semloc_jax.reports.fleet import FAILED as IS_FAILED
    from semloc_jax.reports.fleet import LOST as IS_LOST
    from semloc_jax.runtime.prepare import prepare_jax
    from semloc_jax.storage import write_text

    prepare_jax()
    module = importlib.import_module(f"semloc_jax.cli.{verb}")
    where = {"out": None, "resume": place.out} if place.is_begun else {"out": place.out, "resume": None}
    options = with_settings(module.Options, {**own, "drive": place.drive, "others": (), **where})
    said, why, begun_s = io.StringIO(), "", time.process_time()
    try:
        with contextlib.redirect_stdout(said):
            result = IS_LOST if module.run(options) == LOST else DONE
    except (SemlocError, OSError) as error:
        result, why = IS_FAILED, " ".join(str(error).split())
    place.out.mkdir(parents=True, exist_ok=True)
    write_text(place.out / TEXT, said.getvalue() + why + "\n")
    return FleetRow(place.out.name, result, num_frames(place.out), round(time.process_time() - begun_s, 2), why)
