"""`semloc data`: the drives that the tables of figures name (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import OK


@dataclass(frozen=True)
class Options:
    """Make a drive of the tables from its seed, so that every figure has a command that you can run.

    Without a name: list them, and say where the real data of the other rows comes from and under which licence.
    """

    names: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="NAME")] = ()
    """Names of the drives; all: every one. A drive that is there already is left as it is."""
    out: Path = Path()
    """Parent folder of the drives; default: the current folder."""


def run(options: Options) -> int:
    """List drives, or make them and say what to do with them."""
    from semloc_jax.simulation.named_drives import NAMED_DRIVES, make_named_drive, named_drive

    if not options.names:
        print(_listed())
        return OK
    names = tuple(NAMED_DRIVES) if options.names == ("all",) else options.names
    for name in names:
        print(f"{name}: {named_drive(name).text} ...", flush=True)
        drive = make_named_drive(name, options.out)
        print(f"  {options.out / name}: {len(drive)} frames, cameras {', '.join(drive.rig.names)}")
    place = options.out / names[0]
    print(f"next: semloc track {place} --masks sem_net, or semloc localize {place} --masks sem_net --frames ::5")
    return OK


def _listed() -> str:
    """A line for each drive."""
    from semloc_jax.simulation.named_drives import NAMED_DRIVES, REAL_DRIVES

    lines = ["drives that 'semloc data NAME' makes from a seed:"]
    lines += [f"  {name:13} {drive.text}" for name, drive in NAMED_DRIVES.items()]
    lines.append("recorded data, to be had from its makers:")
    lines += [f"  {name:13} {drive.text}: {drive.address} ({drive.licence})" for name, drive in REAL_DRIVES.items()]
    return "\n".join(lines)
