"""Which drives a map was merged of, kept beside it (room: mapping; host).

In: a map file, packed drives. Out: the base and all drives that the next merge starts from; the record of it.
MAP.gpkg.history/ holds drives/HASH.slocal, roots/HASH.gpkg and, for each version, HASH.drives.json: base and drives.
With these the map is made anew from the set of its drives: the same for any order and any grouping of merges.
"""

import hashlib
import json
import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from semloc_jax.errors import SemlocError
from semloc_jax.maps import BeliefMap, SemanticMap
from semloc_jax.maps.io.packed_drive import PackedDrive, unpacked
from semloc_jax.maps.versions.history import history_of, versions_of
from semloc_jax.maps.versions.records import record_of
from semloc_jax.maps.versions.state import MapState, read_state, write_state
from semloc_jax.storage import json_document, reading, write_bytes, write_text, writing


@dataclass(frozen=True)
class Ledger:
    """What a map was made of.

    Attributes:
        root: the map before any drive; None where there was none.
        drives: content of each packed drive, by its SHA-256.
    """

    root: MapState | None
    drives: dict[str, bytes]

    @cached_property
    def base(self) -> BeliefMap | None:
        """The map before any drive, with its beliefs."""
        return None if self.root is None else BeliefMap.of(self.root.map)

    def written(self, beliefs: BeliefMap) -> SemanticMap:
        """A map with its beliefs as a file has them; what is as it was before any drive, as it was written then."""
        held = beliefs.as_map()
        if self.root is None or self.base is None:
            return held
        first = {e.id: e for e in self.root.map.elements}
        bare = {e.id: record_of(e) for e in self.base.map.elements}
        return held.with_elements(
            first[e.id] if self.base.beliefs.get(e.id) == beliefs.beliefs[e.id] and bare[e.id] == record_of(own) else e
            for e, own in zip(held.elements, beliefs.map.elements, strict=True)
        )

    @property
    def version(self) -> int:
        """Number of the version that these drives make: it grows by one with each."""
        return (0 if self.root is None else self.root.version) + len(self.drives)

    def unpacked(self) -> list[tuple[PackedDrive, str]]:
        """The drives and their hashes, in the order of the hashes."""
        return [(unpacked(self.drives[digest], f"drive {digest[:12]}"), digest) for digest in sorted(self.drives)]

    def joined(self, contents: list[bytes]) -> "Ledger":
        """With more drives; those that are in it already, and the one that the root was made of, add nothing."""
        found = dict(self.drives)
        for content in contents:
            drive = unpacked(content, "drive")
            if self.root is None or not drive.source or not self.root.content.startswith(drive.source):
                found[hashlib.sha256(content).hexdigest()] = content
        return Ledger(self.root, found)


def ledger_of(path: Path) -> Ledger:
    """What the map of a file was made of; a map that was never merged is the root of what comes.

    Raises:
        SemlocError: it was merged, and its drives are not beside it.
    """
    state, folder = read_state(path), history_of(path)
    record = _record(folder, state.digest)
    if not record.is_file():
        if state.num_drives:
            raise SemlocError(
                f"map {path}: was merged of {state.num_drives} drives, which are not in {folder.name} beside it (a map "
                "that came by pull or apply has none): merge into the map that was merged, or copy its folder too"
            )
        return Ledger(state, {})
    document = json_document(record.read_bytes(), f"record {record}")
    with reading(f"record {record}"):
        root = None if document["root"] is None else read_state(folder / "roots" / f"{document['root']}.gpkg")
        drives = {str(digest): (folder / "drives" / f"{digest}.slocal").read_bytes() for digest in document["drives"]}
        if any(hashlib.sha256(content).hexdigest() != digest for digest, content in drives.items()):
            raise ValueError("a drive is not what was merged")
    return Ledger(root, drives)


def write_ledger(ledger: Ledger, state: MapState, path: Path) -> None:
    """Keeps what a version was made of beside the map; to be written before the map."""
    folder = history_of(path)
    (folder / "drives").mkdir(parents=True, exist_ok=True)
    for digest, content in ledger.drives.items():
        if not (folder / "drives" / f"{digest}.slocal").is_file():
            write_bytes(folder / "drives" / f"{digest}.slocal", content)
    if ledger.root is not None:
        (folder / "roots").mkdir(exist_ok=True)
        write_state(ledger.root, folder / "roots" / f"{ledger.root.digest}.gpkg")
    root = None if ledger.root is None else ledger.root.digest
    write_text(_record(folder, state.digest), json.dumps({"root": root, "drives": sorted(ledger.drives)}) + "\n")


def copy_record(source: Path, digest: str, path: Path, new: str) -> None:
    """The record of a version, for the same content under another number, or beside another file."""
    before, folder = _record(history_of(source), digest), history_of(path)
    if not before.is_file():
        return
    document = json_document(before.read_bytes(), f"record {before}")
    names = [f"drives/{d}.slocal" for d in document["drives"]]
    names += [f"roots/{document['root']}.gpkg"] if document["root"] else []
    for name in names:
        if not (folder / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            with writing(folder / name) as partial:
                shutil.copyfile(history_of(source) / name, partial)
    write_text(_record(folder, new), json.dumps(document) + "\n")


def copy_records(source: Path, path: Path) -> None:
    """The records of all versions of a map beside another file: who goes back there to one of them can merge on."""
    if history_of(source) != history_of(path):
        for row in versions_of(source):
            copy_record(source, row.digest, path, row.digest)


def inbox_of(path: Path) -> Path:
    """The folder where uploads to a served map wait for a merge."""
    return history_of(path) / "inbox"


def waiting_drives(path: Path) -> list[Path]:
    """Uploads to a served map that wait for a merge."""
    return sorted(inbox_of(path).glob("*.slocal"))


def _record(folder: Path, digest: str) -> Path:
    return folder / f"{digest}.drives.json"
