"""`semloc surround`: the metric top view of all cameras around a vehicle (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from semloc_jax.cli.main import OK, log_to_console


@dataclass(frozen=True)
class Options:
    """Stitch the cameras around a vehicle to one metric top view.

    Gains and white balance of all cameras are found in one least squares over the overlaps. Writes top_view/FRAME.png,
    metrics.json (surveyed corners where the drive has a true map, disagreement of neighbouring cameras in the
    overlaps, step of grey levels across the seams) and config.yaml.

    Four pictures and a calibration are enough: `semloc surround FOLDER --calib calib.yaml`, where FOLDER has one
    picture for each camera with the camera's name in its own.
    """

    drive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE|FOLDER")]
    """A drive of any kind, or a folder with one picture for each camera."""
    calib: Path | None = None
    """Calibration file or folder; default: the drive's own."""
    blend: Literal["gaussian", "linear", "hard"] = "gaussian"
    """How pictures meet at the seams: normal distribution over the distance to the seam, a ramp, or a cut."""
    height_aware: bool = False
    """Where two cameras contradict each other, since something stands up there, show one of them alone: no ghosts."""
    size_m: float = 12.0
    """Side of the square around the car."""
    metres_per_px: float = 0.012
    """Size of a pixel."""
    bowl_from_deg: float | None = None
    """Also show the surroundings on a bowl, where what stands stands up: seen from behind (0), the right (90), ahead
    (180) or the left (270). Writes bowl/FRAME.png."""
    frames: str = ":"
    """Which frames, as a Python slice: ::5, 10:20, 7."""
    cameras: str | None = None
    """Names of cameras, separated by commas; default: all."""
    masks: str | None = None
    """Masks of the drive that are laid out as well: sem, sem_net ... Writes masks_NAME/FRAME.png."""
    own_car: str | None = None
    """Ends of the car as REAR,FRONT,RIGHT,LEFT in metres of the vehicle frame; default: the rectangle of its cameras.
    Write --own-car=-0.9,3.8,-1,1: the first number is negative."""
    video: bool = False
    """Write surround.mp4 (and bowl.mp4)."""
    no_check: bool = False
    """Go on where pictures and calibration contradict each other."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def run(options: Options) -> int:
    """Make the top views, print how well they fit together."""
    from semloc_jax.inputs.choices import parse_names, parse_own_car, parse_slice
    from semloc_jax.reports.surround import SurroundSettings, report_surround

    log_to_console()
    settings = SurroundSettings(
        options.blend, options.size_m, options.metres_per_px, options.height_aware, options.bowl_from_deg
    )
    car = None if options.own_car is None else parse_own_car(options.own_car)
    text = report_surround(
        options.drive,
        options.calib,
        settings,
        parse_slice(options.frames),
        parse_names(options.cameras),
        options.masks,
        car,
        options.video,
        not options.no_check,
        options.out,
    )
    print(text)
    return OK
