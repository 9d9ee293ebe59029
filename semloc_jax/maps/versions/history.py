"""The versions that a map file has had: kept beside it, listed, gone back to (room: maps; host).

In: a map file, versions. Out: the file in its next version; its list of versions; an earlier one, to the byte.
MAP.gpkg.history/ holds for each version the step back to the one before, named by the digest of the later. A step is
written before the map is: whenever a process is killed, the map is old or new and its history leads on from it.
"""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from semloc_jax.errors import SemlocError
from semloc_jax.maps.versions.difference import applied, difference
from semloc_jax.maps.versions.sdiff import SdiffFile, write_sdiff
from semloc_jax.maps.versions.state import MapState, read_state, write_state
from semloc_jax.storage import writing

_MOST_VERSIONS = 100_000


class VersionRow(NamedTuple):
    """One version of a map."""

    version: int
    digest: str
    made_by: str
    """What made it out of the one before; empty for the first that is known."""
    counts: str
    """What it added, modified and removed."""


def history_of(path: str | Path) -> Path:
    """The folder beside a map that holds what it came from."""
    path = Path(path)
    return path.with_name(path.name + ".history")


def write_version(
    state: MapState, path: str | Path, before: MapState | None = None, kept_at: Path | None = None, note: str = ""
) -> None:
    """Writes a version of a map, and before it the step back to the one it was made of.

    Args:
        state: the version.
        path: the .gpkg file, new or that of the version before.
        before: the version it was made of; None where there is none.
        kept_at: the map file whose history leads back from `before`; None: it has none.
        note: what made it.

    Raises:
        SemlocError: the file is no .gpkg, or cannot be written.
    """
    path = Path(path)
    folder = history_of(path)
    if before is not None:
        folder.mkdir(parents=True, exist_ok=True)
        if kept_at is not None and history_of(kept_at) != folder:
            _copy(history_of(kept_at), folder, before.digest)
    if before is not None and before.digest != state.digest:
        write_sdiff(difference(state, before, note), state, _step_at(folder, state.digest))
    write_state(state, path)


def versions_of(path: str | Path) -> list[VersionRow]:
    """The versions of a map, the newest first.

    A file that states no number, or one that is not greater than that of the version before, gets the next one here:
    numbers only grow.

    Raises:
        SemlocError: no map, or a step of its history is damaged.
    """
    state = read_state(path)
    steps = [step for _, step in _steps_back(history_of(path), state.digest)]
    stated = [state.version, *(step.version for step in steps)]
    numbers = [stated[-1]]
    for version in reversed(stated[:-1]):
        numbers.insert(0, max(version, numbers[0] + 1))
    # A step leads back: what it removes, the newer version had added.
    counts = [f"{s.num_removed} added, {s.num_modified} modified, {s.num_added} removed" for s in steps]
    digests = [state.digest, *(step.target for step in steps)]
    notes = [step.note for step in steps]
    return [VersionRow(*row) for row in zip(numbers, digests, [*notes, ""], [*counts, ""], strict=True)]


def version_at(path: str | Path, version: int) -> MapState:
    """An earlier version of a map, or the newest.

    Raises:
        SemlocError: its history does not reach back to that version.
    """
    rows = versions_of(path)
    digest = next((row.digest for row in rows if row.version == version), None)
    if digest is None:
        raise SemlocError(
            f"map {Path(path).name}: version {version} is not in its history, which knows {rows[-1].version} to "
            f"{rows[0].version}; see `semloc log`"
        )
    state = read_state(path)
    for _, step in _steps_back(history_of(path), state.digest):
        if state.digest == digest:
            break
        state = applied(state, step.on(state))
    return state


def roll_back(path: str | Path, version: int, out: str | Path | None = None) -> MapState:
    """Goes back to an earlier version; numbers of versions only grow.

    Args:
        path: the map file.
        version: which one.
        out: writes that version to this file as it was, to the byte; None makes its content the next version.

    Raises:
        SemlocError: its history does not reach back to that version.
    """
    newest, old = read_state(path), version_at(path, version)
    if out is not None:
        folder = history_of(out)
        if folder != history_of(path):
            folder.mkdir(parents=True, exist_ok=True)
            _copy(history_of(path), folder, old.digest)
        write_version(old, out)
        return old
    again = rolled_back(path, version)
    if again.digest == newest.digest:
        return newest
    write_version(again, path, newest, Path(path), f"rollback to version {version}")
    return again


def rolled_back(path: str | Path, version: int) -> MapState:
    """The content of an earlier version as the next one; the newest stays what it is.

    Raises:
        SemlocError: the history of the map does not reach back to it.
    """
    rows, old = versions_of(path), version_at(path, version)
    return old if old.digest == rows[0].digest else replace(old, version=rows[0].version + 1)


def _steps_back(folder: Path, digest: str) -> Iterator[tuple[Path, SdiffFile]]:
    """Yields the steps from a version back to the first that is known, and their files."""
    for _ in range(_MOST_VERSIONS):
        path = _step_at(folder, digest)
        if not path.is_file():
            return
        step = SdiffFile.read(path)
        if not step.is_on(digest):
            raise SemlocError(f"history {path}: is not the step back from {digest[:12]}; get the folder again")
        yield path, step
        digest = step.target


def _step_at(folder: Path, digest: str) -> Path:
    return folder / f"{digest}.sdiff"


def _copy(source: Path, folder: Path, digest: str) -> None:
    """Copies the steps back from a version into the history of another file."""
    for path, _ in _steps_back(source, digest):
        with writing(folder / path.name) as partial:
            shutil.copyfile(path, partial)
