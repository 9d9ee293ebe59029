"""Tables, triggers and reference systems of a GeoPackage with one table of map elements (room: maps; host).

In: an open connection of sqlite3. Out: an empty GeoPackage 1.3 with an R-tree, or one line that says what is broken.
"""

import itertools
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import GeoOrigin

APPLICATION_ID = 0x47504B47
"""`GPKG` in ASCII."""
LAYER = "elements"
INDEX = "rtree_elements_geom"
LOCAL_SRS = 100_001
"""Number of our own reference system: metres about the origin of the map."""
UNKNOWN_SRS = -1
_NO_TIME = "1970-01-01T00:00:00.000Z"
"""The standard wants a time; the clock would make two files of one map differ."""
_WRITER_AT, _WRITER_BYTES = 96, 4
"""Where an SQLite file names the version of the library that wrote it; readers do not look at it."""
_LONGEST_BLOB = 64 << 20
_STEP = 1_000_000
_MOST_STEPS = 1_000
"""Millions of instructions of SQLite's machine that one statement may take: what runs for ever ends here."""
_MOST_ROWS = 5_000_000

_TABLES = """
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY, organization TEXT NOT NULL,
  organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '', last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER,
  CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL UNIQUE, column_name TEXT NOT NULL,
  geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
  CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name));
CREATE TABLE gpkg_extensions (table_name TEXT, column_name TEXT, extension_name TEXT NOT NULL, definition TEXT NOT NULL,
  scope TEXT NOT NULL, CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name));
CREATE TABLE semloc_map (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE elements (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom GEOMETRY, id TEXT NOT NULL,
  class TEXT NOT NULL, style TEXT NOT NULL, shape TEXT NOT NULL, closed BOOLEAN NOT NULL, width DOUBLE NOT NULL,
  radius DOUBLE NOT NULL, radius_top DOUBLE NOT NULL, height DOUBLE NOT NULL, normal_x DOUBLE, normal_y DOUBLE,
  normal_z DOUBLE, true_start BOOLEAN NOT NULL, true_end BOOLEAN NOT NULL, has_height BOOLEAN NOT NULL,
  attributes TEXT NOT NULL);
CREATE VIRTUAL TABLE rtree_elements_geom USING rtree(id, minx, maxx, miny, maxy);
INSERT INTO gpkg_extensions VALUES ('elements', 'geom', 'gpkg_rtree_index',
  'http://www.geopackage.org/spec120/#extension_rtree', 'write-only');
INSERT INTO gpkg_spatial_ref_sys VALUES
  ('Undefined Cartesian', -1, 'NONE', -1, 'undefined', NULL),
  ('Undefined geographic', 0, 'NONE', 0, 'undefined', NULL),
  ('WGS 84', 4326, 'EPSG', 4326, 'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
   || 'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]', NULL);
"""
_BOX = "ST_MinX(NEW.geom), ST_MaxX(NEW.geom), ST_MinY(NEW.geom), ST_MaxY(NEW.geom)"
_FULL, _EMPTY = "(NEW.geom NOTNULL AND NOT ST_IsEmpty(NEW.geom))", "(NEW.geom ISNULL OR ST_IsEmpty(NEW.geom))"
_TRIGGERS = f"""
CREATE TRIGGER {INDEX}_insert AFTER INSERT ON elements WHEN {_FULL}
  BEGIN INSERT OR REPLACE INTO {INDEX} VALUES (NEW.fid, {_BOX}); END;
CREATE TRIGGER {INDEX}_update1 AFTER UPDATE OF geom ON elements WHEN OLD.fid = NEW.fid AND {_FULL}
  BEGIN INSERT OR REPLACE INTO {INDEX} VALUES (NEW.fid, {_BOX}); END;
CREATE TRIGGER {INDEX}_update2 AFTER UPDATE OF geom ON elements WHEN OLD.fid = NEW.fid AND {_EMPTY}
  BEGIN DELETE FROM {INDEX} WHERE id = OLD.fid; END;
CREATE TRIGGER {INDEX}_update3 AFTER UPDATE ON elements WHEN OLD.fid != NEW.fid AND {_FULL}
  BEGIN DELETE FROM {INDEX} WHERE id = OLD.fid; INSERT OR REPLACE INTO {INDEX} VALUES (NEW.fid, {_BOX}); END;
CREATE TRIGGER {INDEX}_update4 AFTER UPDATE ON elements WHEN OLD.fid != NEW.fid AND {_EMPTY}
  BEGIN DELETE FROM {INDEX} WHERE id IN (OLD.fid, NEW.fid); END;
CREATE TRIGGER {INDEX}_delete AFTER DELETE ON elements WHEN OLD.geom NOT NULL
  BEGIN DELETE FROM {INDEX} WHERE id = OLD.fid; END;
"""


def create(path: Path) -> sqlite3.Connection:
    """Returns a connection to a new, empty GeoPackage; the caller fills, finishes and closes it."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.executescript("PRAGMA journal_mode=OFF; PRAGMA synchronous=OFF;")
    connection.executescript(f"PRAGMA application_id={APPLICATION_ID}; PRAGMA user_version=10300;")
    connection.executescript(_TABLES)
    connection.execute("BEGIN")
    return connection


def finish(connection: sqlite3.Connection, name: str, box: tuple[float, ...], origin: GeoOrigin | None) -> None:
    """Writes the contents and the reference system, and the triggers that keep the R-tree in other programs.

    Args:
        connection: from `create`, with its elements in.
        name: identifier of the layer.
        box: min x, min y, max x, max y of the layer [m].
        origin: place of the local frame; other programs get it as a transverse Mercator grid about that place, which
            lies within 1 mm of the frame up to 5 km from the origin.
    """
    srs = UNKNOWN_SRS if origin is None else LOCAL_SRS
    if origin is not None:
        import pyproj

        grid = f"+proj=tmerc +lat_0={origin.lat_deg!r} +lon_0={origin.lon_deg!r} +k_0=1 +x_0=0 +y_0=0 +datum=WGS84"
        text = pyproj.CRS.from_proj4(f"{grid} +units=m +type=crs").to_wkt("WKT1_GDAL")
        row = ("local metres of the map", LOCAL_SRS, "NONE", LOCAL_SRS, text, "heights are up in the frame of the map")
        connection.execute("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", row)
    connection.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, last_change, min_x, min_y, max_x, max_y, srs_id)"
        " VALUES (?, 'features', ?, ?, ?, ?, ?, ?, ?)",
        (LAYER, name, _NO_TIME, *box, srs),
    )
    connection.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', 'GEOMETRY', ?, 2, 0)", (LAYER, srs))
    connection.execute("COMMIT")
    connection.executescript(_TRIGGERS)


def forget_writer(path: Path) -> None:
    """Takes the version of the SQLite library out of a file that is closed: equal maps shall be equal files."""
    with path.open("r+b") as stream:
        stream.seek(_WRITER_AT)
        stream.write(bytes(_WRITER_BYTES))


class GuardedConnection(sqlite3.Connection):
    """A connection with a limit on the work of a query: a broken or hostile file costs seconds, not hours."""

    def guard(self) -> None:
        """Sets the bounds; call it once."""
        self._steps = 0
        self.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST_BLOB)
        self.set_progress_handler(self._count, _STEP)
        for pragma in ("query_only=ON", "trusted_schema=OFF", "cell_size_check=ON", "mmap_size=268435456"):
            self.execute(f"PRAGMA {pragma}")

    def ask(self, query: str, values: Iterable[object] = ()) -> list[tuple]:
        """Returns all rows of a query, at most five million."""
        self._steps = 0
        return self.execute(query, tuple(values)).fetchmany(_MOST_ROWS)

    def walk(self, query: str, values: Iterable[object] = ()) -> Iterator[tuple]:
        """Yields the rows of a query one by one, at most five million."""
        self._steps = 0
        yield from itertools.islice(self.execute(query, tuple(values)), _MOST_ROWS)

    def is_table(self, name: str) -> bool:
        """Returns whether `name` is a real table: a view could hide anything."""
        return [kind for (kind,) in self.ask("SELECT type FROM sqlite_master WHERE name = ?", (name,))] == ["table"]

    def _count(self) -> int:
        self._steps += 1
        return int(self._steps > _MOST_STEPS)


def connect(path: Path) -> GuardedConnection:
    """Returns a read-only connection to a GeoPackage, safe for untrusted files.

    Raises:
        SemlocError: not a database.
    """
    with path.open("rb") as stream:
        if stream.read(16) != b"SQLite format 3\0":
            raise SemlocError(f"map {path.name}: not an SQLite file; expected a GeoPackage")
    connection = sqlite3.connect(
        f"{path.resolve().as_uri()}?mode=ro",
        uri=True,
        isolation_level=None,
        check_same_thread=False,
        factory=GuardedConnection,
    )
    connection.guard()
    return connection
