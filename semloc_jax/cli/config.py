"""`semloc config`: print a configuration with every default filled in (room: cli)."""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from semloc_jax.cli.main import OK

Configured = Literal[
    "localize", "track", "map", "odometry", "explain", "landscape", "calibrate", "learn", "survey", "simulate"
]


@dataclass(frozen=True)
class Options:
    """Print a configuration as YAML with every default filled in: a file to start from.

    The output is a valid --config file: 'semloc config > mine.yaml', then 'semloc localize DRIVE --config mine.yaml'.
    One file serves every verb: its top level describes the scene, a section named after a verb (track, calibrate,
    learn, survey) is for that verb alone; the others ignore it. map, odometry and simulate have files of their own,
    without the scene. You do not need one: every value has a default, and every value is an option of the verb too.
    """

    verb: Annotated[tyro.conf.Positional[Configured], tyro.conf.arg(metavar="VERB")] = "localize"
    """The verb whose configuration is printed."""
    config: Path | None = None
    """YAML file over the defaults; wrong keys are refused."""


def run(options: Options) -> int:
    """Print the settings."""
    import yaml

    from semloc_jax.cli.arguments import read_settings
    from semloc_jax.inputs.config_files import to_file

    module = importlib.import_module(f"semloc_jax.cli.{options.verb}")
    settings = module.default_settings()
    if options.config is not None:
        settings, _ = read_settings(str(options.config), module.Options, settings)
    print(yaml.safe_dump(to_file(settings), sort_keys=False, width=120), end="")
    return OK
