"""The folder of a run and the record of how it came about (room: reports; host).

In: a path or None, the configuration, the options. Out: a folder, config.yaml.
"""

import shlex
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from semloc_jax.errors import SemlocError
from semloc_jax.inputs.config_files import RECORD_KEY, to_file, to_plain
from semloc_jax.inputs.paths import LATEST
from semloc_jax.runtime import prepare as runtime
from semloc_jax.storage import claim, write_text

DEFAULT_ROOT = Path("results")


def make_folder(out: Path | None, resume: Path | None = None) -> Path:
    """The folder for a run: the given one, else `results/<time>`, to which the link `results/latest` then points.

    It is this run's until the verb ends.

    Args:
        out: the given one.
        resume: that of an unfinished run, which must be there; goes before `out`.

    Raises:
        SemlocError: the folder cannot be made, or another run writes to it.
    """
    if resume is not None:
        if not resume.is_dir():
            raise SemlocError(f"--resume {resume}: no such folder; give that of an unfinished run")
        claim(resume)
        return resume
    folder = out or DEFAULT_ROOT / time.strftime("%Y-%m-%d_%H-%M-%S")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        claim(folder)
    except OSError as error:
        raise SemlocError(
            f"output folder {folder}: {error.strerror}; give --out a folder that can be written"
        ) from error
    if out is None:
        latest = DEFAULT_ROOT / LATEST
        try:
            latest.unlink(missing_ok=True)
            latest.symlink_to(folder.name, target_is_directory=True)
        except OSError:  # file systems without links: the folder is named by its time anyway
            pass
    return folder


def write_record(folder: Path, settings: Any, options: Mapping[str, Any]) -> None:
    """Write config.yaml: the resolved configuration, which can be read back, and how the run came about.

    Args:
        settings: The configuration.
        options: Options of the verb that a configuration file may hold too.
    """
    record = {
        "command": shlex.join(["semloc", *sys.argv[1:]]),
        "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "versions": runtime.versions(),
        "device": runtime.device(),
    }
    content = {RECORD_KEY: record, **to_plain(dict(options)), **to_file(settings)}
    write_text(folder / "config.yaml", yaml.safe_dump(content, sort_keys=False, width=120))
