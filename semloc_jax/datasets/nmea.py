"""NMEA 0183 logs of satellite receivers (room: datasets; host).

In: lines with GGA (and RMC or ZDA, which tell the date), with a time of the logger before them or without.
Out: GnssTrack.
"""

import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from semloc_jax.datasets.sensors import GnssTrack
from semloc_jax.errors import SemlocError

_SENTENCE = re.compile(r"^(?P<before>[^$]*)\$(?P<body>[A-Z]{2}(?:GGA|RMC|ZDA),[^*\s]*)(?:\*(?P<sum>[0-9A-Fa-f]{2}))?")
_ERROR_M = {1: 2.5, 2: 1.0, 3: 1.0, 4: 0.02, 5: 0.25, 6: 10.0, 9: 1.0}
"""Horizontal error [m] at a dilution of one, by quality of the fix (plain, differential, RTK ...); our choice."""
_HEIGHT_FACTOR = 2.0
_DAY_S = 86400.0
_MAX_BYTES = 2_000_000_000


def is_nmea(path: Path) -> bool:
    """Whether a file begins as an NMEA log."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(20_000).decode("ascii", errors="replace")
    return any(_SENTENCE.match(line.strip()) for line in head.splitlines())


def read_nmea(path: str | Path, antenna_base: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> GnssTrack:
    """Fixes of an NMEA log; sentences with a wrong checksum and without a fix are left out.

    A number before the `$` is the time of the logger and is taken, since cameras share its clock; else the time is
    UTC, in seconds since 1970 where the log tells the date, in seconds of the day where it does not.

    Args:
        path: text file.
        antenna_base: where the antenna sits on the vehicle [m].

    Raises:
        SemlocError: the file is missing or holds no fix.
    """
    path = Path(path)
    if not path.is_file() or path.stat().st_size > _MAX_BYTES:
        raise SemlocError(f"NMEA {path}: no such file, or larger than 2 GB; expected a log with GGA sentences")
    rows, day_s, last_s = [], None, None
    with path.open(encoding="ascii", errors="replace") as file:
        for line in file:
            found = _SENTENCE.match(line.strip()[:256])
            if found is None or not _is_intact(found):
                continue
            cells = found["body"].split(",")
            if cells[0].endswith("GGA"):
                row = _fix(cells)
                if row is None:
                    continue
                if last_s is not None and row[0] < last_s - 0.5 * _DAY_S and day_s is not None:
                    day_s += _DAY_S  # midnight
                last_s = row[0]
                rows.append([_logged(found["before"]), row[0], day_s, *row[1:]])
            else:
                day_s = _day(cells) or day_s
    if not rows:
        raise SemlocError(f"NMEA {path}: no fix in it; expected GGA sentences of quality 1 or better")
    return _track(rows, antenna_base)


def _track(rows: list[list], antenna_base: tuple[float, float, float]) -> GnssTrack:
    logged = [row[0] for row in rows]
    first_day = next((row[2] for row in rows if row[2] is not None), 0.0)
    of_day = np.array([row[1] for row in rows])
    days = np.array([first_day if row[2] is None else row[2] for row in rows])
    time_s = np.array(logged, dtype=np.float64) if None not in logged else days + of_day
    table = np.array([row[3:] for row in rows], dtype=np.float64)
    sigma_m = np.column_stack([table[:, 3], table[:, 3], _HEIGHT_FACTOR * table[:, 3]])
    return GnssTrack.from_wgs84(time_s, table[:, :3], sigma_m, antenna_base)


def _fix(cells: list[str]) -> list[float] | None:
    """Second of the day, latitude, longitude, ellipsoidal height, sigma of a GGA; None without a fix."""
    try:
        quality = int(cells[6])
        second = 3600 * int(cells[1][:2]) + 60 * int(cells[1][2:4]) + float(cells[1][4:])
        lat, lon = _degrees(cells[2], 2), _degrees(cells[4], 3)
        dilution = float(cells[8] or 1.0)
        # Heights are above the geoid; its own height is the next but one cell.
        height = float(cells[9] or 0.0) + float(cells[11] or 0.0)
    except (ValueError, IndexError):
        return None
    if (
        quality not in _ERROR_M
        or abs(lat) > 90.0
        or abs(lon) > 180.0
        or not np.isfinite([second, dilution, height]).all()
    ):
        return None
    sigma = _ERROR_M[quality] * max(dilution, 0.5)
    return [second, -lat if cells[3] == "S" else lat, -lon if cells[5] == "W" else lon, height, sigma]


def _degrees(cell: str, digits: int) -> float:
    """Degrees of ddmm.mmmm."""
    return int(cell[:digits]) + float(cell[digits:]) / 60.0


def _day(cells: list[str]) -> float | None:
    """Seconds since 1970 of the midnight before, of RMC or ZDA."""
    try:
        if cells[0].endswith("RMC"):
            day = datetime.strptime(cells[9], "%d%m%y")
        else:
            day = datetime(int(cells[4]), int(cells[3]), int(cells[2]))
    except (ValueError, IndexError, OverflowError):
        return None
    return day.replace(tzinfo=UTC).timestamp()


def _logged(text: str) -> float | None:
    words = text.replace(",", " ").split()
    try:
        return float(words[-1]) if words else None
    except ValueError:
        return None


def _is_intact(found: re.Match) -> bool:
    if found["sum"] is None:
        return True
    total = 0
    for character in found["body"]:
        total ^= ord(character)
    return total == int(found["sum"], 16)
