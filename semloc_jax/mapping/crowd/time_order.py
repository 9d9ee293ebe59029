"""The order of drives in time (room: mapping; host).

In: drives in the order they arrive. Out: the same by date, those without one by name as people count.
"""

from collections.abc import Sequence

from semloc_jax.maps.io.packed_drive import PackedDrive


def in_order(drives: Sequence[tuple[PackedDrive, str]]) -> list[PackedDrive]:
    """Drives in the order of time; see `timed`."""
    return [drive for drive, _ in timed(drives)]


def timed(drives: Sequence[tuple[PackedDrive, str]]) -> list[tuple[PackedDrive, str]]:
    """Drives with the hashes of their files in the order of time: by date, by name as people count, by hash."""

    def key(item: tuple[PackedDrive, str]) -> tuple:
        drive, digest = item
        parts = [(int(p), "") if p.isdigit() else (-1, p) for p in _words(drive.name)]
        return (drive.when_s if drive.when_s is not None else 0.0, parts, digest)

    return sorted(drives, key=key)


def _words(name: str) -> list[str]:
    words, digits = [""], False
    for letter in name:
        is_digit = letter in "0123456789"
        if is_digit != digits:
            words.append("")
        digits = is_digit
        words[-1] += letter
    return words
