"""`semloc learn eyes`: a network for masks, taught by the map from drives without labels (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from semloc_jax.cli.main import OK, log_to_console
from semloc_jax.errors import UsageError
from semloc_jax.inputs.choices import parse_names, parse_slice

if TYPE_CHECKING:
    from semloc_jax.learning.eyes.teach import EyesConfig


@dataclass(frozen=True)
class Options:
    """Teach a network by the map: no labels, no truth of the drives that teach.

    Each round localizes the drives with the masks that there are, projects the map into their images, trains on it with
    the sigma of pose and map, and localizes frames held out, whose truth judges. The first masks are --masks, e.g.
    classical, a folder or another network. Map elements that the frames contradict are left out.

    Writes round_N.weights, eyes.weights (the last round that was better than all before, if any was), eyes.onnx,
    rounds.json, report.md, rounds.png (errors and honesty by round), frames.png (five frames held out in every round),
    labels.png (five images with what teaches: look at it first) and config.yaml. `semloc localize DRIVE --masks
    OUT/eyes.weights` uses it.

    With --simulated no drive teaches: random streets do, with exact masks, as many cameras, weathers and countries see
    them. Writes eyes.weights, eyes.onnx, classes.csv (recall, precision, errors and honesty on scenes held out),
    loss.csv, loss.png, held_out.png, and scenes/ with manifest.json (seeds and which scenes teach). A lesson that
    stopped goes on where --out names its folder.

    With --through.num-steps N a last lesson follows: N steps for the poses themselves, through the solver
    (through.weights), and beside it as many by the labels alone (labels_alone.weights); both are judged like a round.

    Every value of the configuration is an option too, e.g. --rounds 2, --training.num-steps 3000 or
    --streets.num-streets 100.
    """

    drives: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DRIVE...")] = ()
    """Drives to learn from."""
    simulated: bool = False
    """Learn from random streets in place of drives."""
    begin: Path | None = None
    """Weights to go on with; default: new ones."""
    map: str | None = None
    """Map of all of them: a file, the name of a map of each drive, or sweeps:::2 (PandaSet); default: its own."""
    masks: str = "classical"
    """What there is at the beginning, as for semloc localize."""
    network: str | None = None
    """An ONNX network (FILE.onnx, with its preset FILE.yaml beside it, or the preset) whose scores the eyes see beside
    the colours: a small adapter on top of it is trained, instead of a network of its own."""
    frames: str = ":"
    """Frames to learn from, as a Python slice."""
    held_out: Path | None = None
    """Drive that judges, with truth; default: the first of those to learn from."""
    held_out_frames: str = "::10"
    """Frames of it that judge; those that also would teach are left out of teaching."""
    cameras: str | None = None
    """Names of cameras, separated by commas; default: as for semloc localize."""
    prior: str | None = None
    """First guess of the drives that teach: gnss, truth (plus seeded noise) or a trajectory file; default: gnss where a
    drive has fixes."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "EyesConfig":
    """The configuration of the rounds."""
    from semloc_jax.learning.eyes.teach import EyesConfig

    return EyesConfig()


def run(options: Options) -> int:
    """Teach, print the score of every round."""
    from semloc_jax.inputs.mask_source import network_preset
    from semloc_jax.perception.networks.eyes import Eyes
    from semloc_jax.reports.eyes import EyesDrives, report_eyes
    from semloc_jax.reports.street_eyes import report_street_eyes

    log_to_console()
    begin = None if options.begin is None else Eyes.load(options.begin)
    if options.simulated:
        if options.drives:
            raise UsageError(f"--simulated: learns from no drive, given {options.drives[0]}; leave one of both out")
        report = report_street_eyes(options.settings, begin, options.out)
        print(report.text)
        print(f"results: {report.folder}")
        return OK
    drives = EyesDrives(
        learned_from=options.drives,
        held_out=options.held_out,
        map=options.map,
        masks=options.masks,
        frames=parse_slice(options.frames),
        held_out_frames=parse_slice(options.held_out_frames),
        cameras=parse_names(options.cameras),
        prior=options.prior,
        network=network_preset(Path(options.network)) if options.network is not None else None,
        begin=begin,
    )
    report = report_eyes(drives, options.settings, options.out)
    print(report.text)
    print(f"results: {report.folder}")
    return OK
