"""`semloc simulate`: write a small rendered drive with exact truth (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from semloc_jax.cli.main import OK
from semloc_jax.errors import SemlocError

if TYPE_CHECKING:
    from semloc_jax.datasets.synthetic import SimulationConfig


@dataclass(frozen=True)
class Options:
    """Render a seeded drive: images, exact masks, masks like a network's, sensors, maps and truth.

    Every value of the simulation is an option too, e.g. --num-frames 60 --wear-share 0.3 --sensors.gnss-bias-m 2:
    'semloc config simulate' prints them all.
    """

    out: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
    """Folder to write; it must be empty or absent."""
    kind: Literal["road", "garage"] = "road"
    """road: one front camera; garage: four fisheyes."""
    seed: int = 0
    """Everything random follows from it."""
    config: Path | None = None
    """YAML file with values of the simulation."""


def default_settings() -> "SimulationConfig":
    """What a drive is like if nothing is said."""
    from semloc_jax.datasets.synthetic import SimulationConfig

    return SimulationConfig()


def run(options: Options) -> int:
    """Render the drive and say what was written."""
    from semloc_jax.datasets.synthetic import simulate

    if options.out.exists() and (not options.out.is_dir() or any(options.out.iterdir())):
        raise SemlocError(f"{options.out}: is not an empty folder; give a new one, nothing is overwritten")
    drive = simulate(options.kind, options.seed, options.out, options.settings)
    cameras = ", ".join(drive.rig.names)
    print(f"{options.out}: {len(drive)} frames, cameras {cameras}, maps {', '.join(drive.maps)}")
    print(f"localize it with: semloc localize {options.out} --masks sem_net --frames ::5")
    return OK
