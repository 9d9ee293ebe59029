"""What `pack` and `merge` write and say (room: reports; host).

In: folders of maps, packed drives, a base map. Out: files, and the text for people.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from tqdm import tqdm

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import MapComparison, Metric, compare_maps, write_metrics
from semloc_jax.mapping.crowd.cell_map import DriveRow
from semloc_jax.mapping.crowd.kept_cells import KeptCells
from semloc_jax.mapping.crowd.ledger import Ledger, copy_records, ledger_of, write_ledger
from semloc_jax.mapping.crowd.pack import packed, trimmed
from semloc_jax.mapping.crowd.seed_rule import replaced
from semloc_jax.mapping.crowd.time_order import in_order
from semloc_jax.mapping.crowd.whole import Crew, WholeMap, merge_whole
from semloc_jax.maps import read_map
from semloc_jax.maps.io.packed_drive import PackedDrive, read_packed, write_packed
from semloc_jax.maps.versions.history import write_version
from semloc_jax.maps.versions.state import MapState, read_state
from semloc_jax.reports.crowd_curve import judged_changes, write_curve
from semloc_jax.reports.folder import make_folder
from semloc_jax.reports.tables import write_csv
from semloc_jax.viz import changes_from_above, existence_from_above, save

_NOWHERE_M = 1e3


@dataclass(frozen=True)
class Judge:
    """What a merged map is judged by.

    Attributes:
        truth: a reference map.
        worlds: the folder of the simulated drives, with the exact world of each; None leaves what changed unjudged.
        curve: whether the report shows how the error falls with the number of drives.
    """

    truth: Path | None = None
    worlds: Path | None = None
    curve: bool = False


def report_packed(
    folder: Path, out: Path, when: str | None = None, name: str | None = None, trim_m: float = 0.0
) -> str:
    """Packs the results of `semloc map`.

    Raises:
        SemlocError: the folder holds none, or the file cannot be written.
    """
    if out.suffix.lower() != ".slocal":
        raise SemlocError(f"--out {out}: expected a name that ends in .slocal")
    if not trim_m >= 0.0:
        raise SemlocError(f"--trim {trim_m}: expected metres, 0 or more")
    drive = trimmed(packed(folder, when), trim_m)
    drive = drive if name is None else replace(drive, name=name)
    size = write_packed(drive, out)
    return f"{_in_words(drive)}\n{out}: {size / 1000:.2f} kB, {size / max(drive.length_m, 1.0):.2f} kB/km"


def _in_words(drive: PackedDrive) -> str:
    date = "no date" if drive.when_s is None else f"{datetime.fromtimestamp(drive.when_s, UTC):%Y-%m-%d %H h UTC}"
    placed = "no place" if drive.sigma_place_m > _NOWHERE_M else f"placed within {drive.sigma_place_m:.1f} m"
    num = len(drive.beliefs.beliefs)
    return f"drive {drive.name}: {num} elements along {drive.length_m:.0f} m, {date}, {placed}"


def report_merged(
    base: Path | None,
    packed_paths: Sequence[Path],
    out: Path,
    report: Path | None = None,
    judge: Judge | None = None,
    crew: Crew | None = None,
) -> str:
    """Merges packed drives into a map and writes it, with its history beside it.

    Args:
        base: the map before; None where there is none.
        packed_paths: files of `semloc pack`.
        out: the .gpkg file to write.
        report: folder for tables and pictures; None for none.
        judge: what to judge it by; None for nothing.
        crew: who works; None for this process.

    Raises:
        SemlocError: a file is broken, no drive fits any other, or the map cannot be written.
    """
    if out.suffix.lower() != ".gpkg":
        raise SemlocError(f"--out {out}: versions are kept in GeoPackages; give a name that ends in .gpkg")
    before = None if base is None else read_state(base)
    held = Ledger(None, {}) if base is None else ledger_of(base)
    contents = []
    for path in packed_paths:
        read_packed(path)  # names the file where it is broken
        contents.append(path.read_bytes())
    ledger = held.joined(contents)
    new = len(ledger.drives) - len(held.drives)
    if base is not None:
        copy_records(base, out)
    if before is not None and not new:
        write_ledger(held, before, out)
        write_version(before, out, before, base)
        return f"{before.map.name} version {before.version}: holds these drives already; nothing changes\nmap: {out}"
    kept = KeptCells(out, base)
    found = merge_whole(ledger, crew=crew, kept=kept, progress=lambda items, name: tqdm(items, desc=name))
    version = ledger.version if before is None else max(ledger.version, before.version + new)
    state = MapState(ledger.written(found.beliefs), version, len(ledger.drives), found.datum)
    write_ledger(ledger, state, out)
    write_version(state, out, before, base, f"merge of {_counted(new, 'drive')}")
    kept.drop_others()
    judge, drives = judge or Judge(), in_order(ledger.unpacked())
    judged = {} if judge.truth is None else _judged(state, drives, judge.truth)
    if report is not None:
        folder = make_folder(report)
        _write_report(found, len(drives), judged, folder)
        if judge.curve and judge.truth is not None:
            write_curve(ledger.base, drives, read_map(judge.truth), folder)
    lines = _merge_in_words(found, state, ledger, new, judged)
    if judge.worlds is not None:
        gone = [change.element for change in found.changes if change.change == "removed"]
        figures, length_m = judged_changes(state.map.elements, gone, drives, ledger.base, judge.worlds)
        lines.append(figures.to_text(length_m))
    return "\n".join([*lines, f"map: {out}"])


def _judged(state: MapState, drives: Sequence[PackedDrive], truth: Path) -> dict[str, MapComparison]:
    """The map against a reference, and beside it what the rule of the literature makes of the same drives."""
    reference, by_rule = read_map(truth).elements, replaced(drives, state.map.origin).elements
    return {
        "map": compare_maps(state.map.elements, reference, "se2"),
        "absolute": compare_maps(state.map.elements, reference, "none"),
        "seed_rule": compare_maps(by_rule, reference, "se2"),
    }


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


_TITLES = {
    "map": "against the reference, after one motion in the plane:",
    "absolute": "against the reference, as it lies:",
    "seed_rule": "for comparison, replace within 5 m if more confident, after one motion in the plane:",
}


def _merge_in_words(
    found: WholeMap, state: MapState, ledger: Ledger, new: int, judged: dict[str, MapComparison]
) -> list[str]:
    counts = Counter(element.label.name.lower() for element in state.map.elements)
    changes = Counter(change.change for change in found.changes)
    rates = [f"{name} {100 * rate:.0f} %" for name, rate in found.detected.items()]
    drives = _counted(len(ledger.drives), "drive")
    lines = [
        f"{state.map.name} version {state.version}: {new} new of {drives}; content {state.content}",
        f"map: {', '.join(f'{count} {name}' for name, count in counts.items())}",
        f"a drive shows what it passes: {', '.join(rates)}",
        f"changes: {', '.join(f'{changes[word]} {word}' for word in ('removed', 'moved', 'added'))}",
        *(
            f"alone: drive {name}: no other and no base map knows its road; that part is its own"
            for name in found.alone
        ),
        *(f"not trusted: drive {drive.name}: {drive.reason}" for drive in found.distrusted),
        *(
            f"bent: drive {row.drive}: its way may bend {row.bent:g} times as far as those of the others: they say how "
            "the road runs"
            for _, row in found.drives
            if row.bent > 1.0
        ),
    ]
    for name, comparison in judged.items():
        lines += [_TITLES[name], comparison.to_text()]
    return lines


def _write_report(found: WholeMap, num_drives: int, judged: dict[str, MapComparison], folder: Path) -> None:
    """changes.csv, drives.csv, metrics.json, pictures."""
    columns = ("id", "change", "class", "x_m", "y_m", "moved_m", "existence", "num_seen", "num_missed", "drive")
    rows = []
    for c in found.changes:
        x_m, y_m = c.element.points[:, :2].mean(axis=0).round(3).tolist()
        name = c.element.label.name.lower()
        rows.append((c.id, c.change, name, x_m, y_m, round(c.moved_m, 3), round(c.existence, 4)))
        rows[-1] += (c.num_seen, c.num_missed, c.drive)
    write_csv(folder / "changes.csv", columns, rows)
    rows = [(cell, *row) for cell, row in found.drives]
    write_csv(folder / "drives.csv", ("cell", *DriveRow._fields), rows)
    metrics = [Metric("drives", float(num_drives), "drives", "report")]
    for word in ("removed", "moved", "added"):
        count = sum(c.change == word for c in found.changes)
        metrics.append(Metric(f"changes.{word}", float(count), "elements", "report"))
    metrics += [metric for name, comparison in judged.items() for metric in comparison.metrics(name)]
    write_metrics(metrics, folder / "metrics.json")
    elements, beliefs = found.beliefs.map.elements, found.beliefs.beliefs
    gone = [c.element for c in found.changes if c.change == "removed"]
    moved = {c.id: c.change for c in found.changes if c.change != "removed"}
    save(changes_from_above(elements, gone, moved, "what changed"), folder / "changes.png")
    save(existence_from_above(elements, beliefs, "how sure the map is"), folder / "existence.png")
