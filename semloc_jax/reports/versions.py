"""What `diff`, `apply`, `log` and `rollback` write and say (room: reports; host).

In: map files, differences. Out: files, and the text for people.
"""

import tempfile
from pathlib import Path

from semloc_jax.mapping.crowd.ledger import copy_record
from semloc_jax.maps.versions.difference import MapDifference, applied, difference
from semloc_jax.maps.versions.history import roll_back, rolled_back, version_at, versions_of, write_version
from semloc_jax.maps.versions.sdiff import SdiffFile, sdiff_bytes, write_sdiff
from semloc_jax.maps.versions.state import MapState, read_state, write_state
from semloc_jax.storage import temporary_prefix

_SHORT = 12
"""Digits of a hash that people look at."""


def report_difference(base: Path, target: Path, out: Path | None = None, most_names: int = 20) -> str:
    """The difference of two maps in words; written to `out` where asked.

    Raises:
        SemlocError: no maps, or the file cannot be written.
    """
    old, new = read_state(base), read_state(target)
    step = difference(old, new)
    size = len(sdiff_bytes(step, old)) if out is None else write_sdiff(step, old, out)
    changed = [tile for tile in {*old.tiles, *new.tiles} if old.tiles.get(tile) != new.tiles.get(tile)]
    lines = [
        f"{_named(old)} -> {_named(new)}",
        f"{step.counts}; {len(changed)} of {len({*old.tiles, *new.tiles})} tiles changed; {size / 1000:.2f} kB",
        *_spelled_out(step, most_names),
    ]
    if not _is_canonical(new, target):
        lines.append(
            f"note: {target.name} was not written by this version of the package: apply gives the same map in its own "
            "form (semloc convert writes it)"
        )
    return "\n".join([*lines, f"difference: {out}"] if out is not None else lines)


def report_applied(base: Path, path: Path, out: Path) -> str:
    """Makes the version that a difference leads to.

    Raises:
        SemlocError: it belongs on another version, was cut short or altered; or the file cannot be written.
    """
    old = read_state(base)
    step = SdiffFile.read(path).on(old)
    new = applied(old, step)
    write_version(new, out, old, base, step.note or f"apply {path.name}")
    return f"{_named(old)} -> {_named(new)}: {step.counts}\nmap: {out}"


def report_log(path: Path, tiles: bool = False) -> str:
    """The versions of a map, and its tiles where asked.

    Raises:
        SemlocError: no map, or its history is damaged.
    """
    lines = []
    for row in versions_of(path):
        made_by = f"  {row.made_by}: {row.counts}" if row.counts else ""
        lines.append(f"version {row.version}  {row.digest[:_SHORT]}{made_by}")
    state = read_state(path)
    drives = f", {state.num_drives} drive{'s' * (state.num_drives > 1)}" if state.num_drives else ""
    tiles_held = f"{len(state.tiles)} tile{'s' * (len(state.tiles) != 1)}"
    lines.append(f"{len(state.map.elements)} elements in {tiles_held}{drives}; content {state.content}")
    if tiles:
        lines += [f"tile {x},{y}  {digest}" for (x, y), digest in state.tiles.items()]
    return "\n".join(lines)


def report_rollback(path: Path, version: int, out: Path | None = None) -> str:
    """Goes back to an earlier version.

    Raises:
        SemlocError: the history of the map does not reach back to it.
    """
    before = read_state(path)
    old = version_at(path, version)
    # What it was made of goes with it, before the map itself is there.
    again = old if out is not None else rolled_back(path, version)
    copy_record(path, old.digest, out or path, again.digest)
    state = roll_back(path, version, out)
    if out is not None:
        return f"{_named(state)} as it was: {out}"
    return (
        f"{_named(before)} -> {_named(state)}: the content {state.content[:_SHORT]} of version {version}\nmap: {path}"
    )


def _named(state: MapState) -> str:
    return f"{state.map.name} version {state.version} ({state.digest[:_SHORT]})"


def _spelled_out(step: MapDifference, most: int) -> list[str]:
    moved = set(step.moved())
    rows = [f"  added {name}" for name in step.added] + [f"  removed {name}" for name in step.removed]
    rows += [f"  {'moved' if name in moved else 'modified'} {name}" for name in step.modified]
    more = len(rows) - most
    return rows[:most] + ([f"  ... and {more} more"] if more > 0 else [])


def _is_canonical(state: MapState, path: Path) -> bool:
    """Whether a file is what this package writes for its content."""
    with tempfile.TemporaryDirectory(prefix=temporary_prefix("canonical")) as folder:
        again = Path(folder) / "again.gpkg"
        write_state(state, again)
        return again.read_bytes() == path.read_bytes()
