"""What the drives of one cell make, as bytes that any process can send and keep (room: mapping; host).

In: MergedSights. Out: CellMap, and its bytes; the same bytes for the same map.
"""

import hashlib
import json
import lzma
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.mapping.crowd.changes import CrowdChange
from semloc_jax.mapping.crowd.fusion import Distrusted, Fused
from semloc_jax.mapping.crowd.merged import Known, MergedSights, Rate, summed_rates
from semloc_jax.maps import Belief
from semloc_jax.maps.versions.records import element_of, json_bytes, record_of
from semloc_jax.storage import reading

_MAGIC = b"SCEL\x02"
_HASH_BYTES, _PRESET, _LARGEST_BYTES = 32, 1, 1 << 28
_CHANGE = ("id", "change", "existence", "moved_m", "drive", "num_seen", "num_missed")


class DriveRow(NamedTuple):
    """How one drive lies in a cell."""

    drive: str
    things: int
    shared: int
    """Things that are those of the map."""
    shift_x_m: float
    shift_y_m: float
    turn_deg: float
    scale: float
    noise: float
    """How much larger its errors are than it says."""
    bent: float
    """How many times as much as usual its way may bend; 1 where it does as those of the others do."""
    distrusted: str
    """Why it counts less; empty where it does not."""


@dataclass(frozen=True)
class CellMap:
    """The map of a cell and its halo.

    Attributes:
        known: elements and how sure they are.
        changes, distrusted, rates: see `MergedMap`.
        drives: how each drive lies, a base map first where there is one.
        sigma_place_m: how far all of it may be off together.
        num_drives: so many drives made it.
    """

    known: tuple[Known, ...]
    changes: tuple[CrowdChange, ...]
    distrusted: tuple[Distrusted, ...]
    rates: dict[str, Rate]
    drives: tuple[DriveRow, ...]
    sigma_place_m: float
    num_drives: int

    @classmethod
    def of(cls, made: MergedSights) -> "CellMap":
        """The map that was made; a drive that fits nowhere counts for nothing."""
        fused = made.fused
        own = [drive.sights for k, drive in enumerate(fused.drives) if k not in fused.distrusted]
        sigma_m = float(np.sum([each.sigma_place_m**-2.0 for each in own])) ** -0.5
        num = sum(0 if each.is_base and each.num_drives == 1 else each.num_drives for each in own)
        return cls(made.known, made.changes, made.distrusted, made.rates, drive_rows(fused), sigma_m, max(num, 1))

    def after(self, before: "CellMap") -> "CellMap":
        """The same, with what the blocks before have told of their drives and changes."""
        return replace(
            self,
            changes=(*before.changes, *self.changes),
            distrusted=(*before.distrusted, *self.distrusted),
            rates=summed_rates(before.rates, self.rates),
            drives=(*before.drives, *self.drives),
        )

    def to_bytes(self) -> bytes:
        """The bytes of a file."""
        document = [
            [[e.id, record_of(e), list(astuple(b))] for e, b in self.known],
            [[record_of(c.element), *(getattr(c, name) for name in _CHANGE)] for c in self.changes],
            [list(astuple(d)) for d in self.distrusted],
            {kind: list(astuple(rate)) for kind, rate in self.rates.items()},
            [list(row) for row in self.drives],
            self.sigma_place_m,
            self.num_drives,
        ]
        packed = lzma.compress(json_bytes(document), preset=_PRESET)
        return _MAGIC + hashlib.sha256(packed).digest() + packed

    @classmethod
    def from_bytes(cls, content: bytes, where: str) -> "CellMap":
        """The map of the bytes of a file.

        Raises:
            SemlocError: no such bytes, cut short, or altered.
        """
        begin = len(_MAGIC) + _HASH_BYTES
        if not content.startswith(_MAGIC) or hashlib.sha256(content[begin:]).digest() != content[len(_MAGIC) : begin]:
            raise SemlocError(f"{where}: is not what was written (cut short or altered); delete it")
        with reading(where):
            text = lzma.LZMADecompressor().decompress(content[begin:], max_length=_LARGEST_BYTES)
            known, changes, distrusted, rates, drives, sigma_m, num = json.loads(text)
            return cls(
                tuple((element_of(name, record), Belief(*belief)) for name, record, belief in known),
                tuple(_change(*row) for row in changes),
                tuple(Distrusted(*row) for row in distrusted),
                {str(kind): Rate(*rate) for kind, rate in rates.items()},
                tuple(DriveRow(*row) for row in drives),
                float(sigma_m),
                int(num),
            )


def drive_rows(fused: Fused) -> tuple[DriveRow, ...]:
    """How each drive lies in what all of them make."""
    rows = []
    for k, (drive, seen) in enumerate(zip(fused.drives, fused.seen, strict=True)):
        x_m, y_m, turn, scale = (float(v) for v in drive.value[:4])
        placed = [round(v, 5) for v in (x_m, y_m, float(np.degrees(turn)), 1.0 + scale)]
        reason = fused.distrusted[k].reason if k in fused.distrusted else ""
        noise = round(float(seen.factor.max()), 2)
        told = noise, round(drive.bent, 2), reason
        rows.append(DriveRow(drive.sights.name, len(drive.sights.things), len(seen.pairs), *placed, *told))
    return tuple(rows)


def _change(record: Mapping[str, Any], *values: Any) -> CrowdChange:
    stated = dict(zip(_CHANGE, values, strict=True))
    return CrowdChange(element=element_of(str(stated["id"]), record), **stated)
