"""`semloc simulate`: write a small rendered drive with exact truth (room: cli)."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from semloc_jax.cli.main import OK
from semloc_jax.errors import SemlocError

if TYPE_CHECKING:
    from semloc_jax.cameras import Rig
    from semloc_jax.simulation import SimulationConfig


@dataclass(frozen=True)
class Options:
    """Render a seeded drive: images, exact masks, masks like a network's, sensors, maps and truth.

    With --map the drive is on a real map: along its lanes, or along its markings where it has no lanes. The length
    and the speed decide the number of frames.

    --epoch K is the same world later, with elements removed, moved, added and repainted (changes.json lists them);
    --drive D is another drive of the same world: other traffic, sensor errors, mounting and mask errors.

    Every value of the simulation is an option too, e.g. --num-frames 60 --wear-share 0.3 --sensors.gnss-bias-m 2:
    'semloc config simulate' prints them all.
    """

    out: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
    """Folder to write: empty, absent, or with the same drive that was interrupted, which is then finished."""
    kind: Literal["road", "country", "loop", "garage", "lot", "targets"] = "road"
    """road: one front camera in a town; country: the same on a crowned road of two lanes with lines, dashes and posts
    only; loop: a closed town road with two look-alike intersections, driven --laps N times; garage: four fisheyes in a
    straight aisle, or with --laps N in a hall with rings of aisles that ends in a parking slot; lot: an open parking
    lot; targets: no drive, but boards before every fisheye and surveyed mats on the ground for semloc calibrate
    --targets. Without --map."""
    noise_px: float = 0.0
    """With --kind targets: standard deviation of the place of a corner in a picture."""
    map: Path | None = None
    """Drive on this map: Lanelet2, OpenDRIVE, Argoverse 2, GeoJSON ..., whatever 'semloc inspect' reads."""
    start: str | None = None
    """With --map: place to start from in metres of the map frame, as X,Y; default: the seed chooses."""
    heading: float | None = None
    """With --map: direction to start in [deg], counter-clockwise from x; default: that of the lane."""
    length_m: float = 150.0
    """With --map: distance to drive."""
    path: Path | None = None
    """With --map: the way itself, a TUM trajectory or a csv file with columns x and y."""
    seed: int = 0
    """Everything random follows from it."""
    rig: Path | None = None
    """Other cameras: a calibration file (calib.yaml of a drive, Kalibr, ROS ...)."""
    obstacles: bool = False
    """Ground locks, no-parking signs and cones on free slots: of a lot, and of a garage with --laps."""
    masks_only: bool = False
    """No images: takes a fraction of the time and is enough for all that works on masks."""
    config: Path | None = None
    """YAML file with values of the simulation."""


def default_settings() -> "SimulationConfig":
    """The default configuration of a simulation."""
    from semloc_jax.simulation import SimulationConfig

    return SimulationConfig()


def run(options: Options) -> int:
    """Render the drive and say what was written."""
    from semloc_jax.cameras.io import read_calibration
    from semloc_jax.simulation import RouteWish, is_begun, simulate, simulate_on_map
    from semloc_jax.storage import sweep

    sweep(options.out)  # a folder in which a kill left nothing but an unfinished file is empty
    is_empty = not options.out.exists() or (options.out.is_dir() and not any(options.out.iterdir()))
    if not is_empty and not is_begun(options.out):
        raise SemlocError(f"{options.out}: is not an empty folder; give a new one, nothing is overwritten")
    rig = None if options.rig is None else read_calibration(options.rig)
    if options.kind == "targets" and options.map is None:
        return _simulate_targets(options, rig)
    settings = replace(options.settings, has_images=False) if options.masks_only else options.settings
    settings = replace(settings, has_obstacles=True) if options.obstacles else settings
    if options.map is not None:
        wish = RouteWish(_place(options.start), options.heading, options.length_m, options.path)
        drive = simulate_on_map(options.map, options.seed, options.out, wish, settings, rig)
    else:
        _refuse_without_map(options)
        drive = simulate(options.kind, options.seed, options.out, settings, rig)
    cameras = ", ".join(drive.rig.names)
    print(f"{options.out}: {len(drive)} frames, cameras {cameras}, maps {', '.join(drive.maps)}")
    # Under a roof no satellites say where to look.
    prior = " --prior truth" if drive.gnss is None else ""
    print(f"localize it with: semloc localize {options.out} --masks sem_net --frames ::5{prior}")
    return OK


def _simulate_targets(options: Options, rig: "Rig | None") -> int:
    from semloc_jax.simulation.targets import TargetPlan, simulate_targets

    if not 0.0 <= options.noise_px <= 2.0:
        raise SemlocError(f"--noise-px {options.noise_px:g}: expected 0 to 2 px")
    truth = simulate_targets(options.out, options.seed, TargetPlan(noise_px=options.noise_px), rig)
    print(f"{options.out}: boards and mats of {', '.join(truth.names)}; the truth is in truth/calib.yaml")
    print(f"calibrate with: semloc calibrate --targets {options.out}")
    return OK


def _place(text: str | None) -> tuple[float, float] | None:
    """The place in `X,Y`."""
    from semloc_jax.errors import UsageError

    if text is None:
        return None
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"--start '{text}': expected X,Y in metres of the map frame, e.g. 12.5,-3") from error
    if not abs(x) + abs(y) < float("inf"):
        raise UsageError(f"--start '{text}': expected two finite numbers")
    return x, y


def _refuse_without_map(options: Options) -> None:
    from semloc_jax.errors import UsageError

    for name in ("start", "heading", "path"):
        if getattr(options, name) is not None:
            raise UsageError(f"--{name} says where to drive on a map; give --map FILE too")
