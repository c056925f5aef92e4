"""Opening of the database, the migration of older versions, of which a copy is kept, and its readers.

Scripts create the tables of the history, and migrate those of older versions. A pool has one read-only connection
for each concurrent reader.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Generator
from contextlib import closing, contextmanager
from pathlib import Path

from beltscape.core.errors import InputError, OutputError
from beltscape.files.atomic import commit_file
from beltscape.files.sqlite_failures import describe_failure, is_damage

_SUMS = """(
    bucket      INTEGER PRIMARY KEY,   -- minutes or hours of wall clock since 1970, shifted by where days begin
    first       INTEGER NOT NULL,      -- smallest and greatest record number in it
    last        INTEGER NOT NULL,
    records     INTEGER NOT NULL,
    volume      REAL NOT NULL,         -- mm³
    mass        REAL NOT NULL,         -- kg, of what has a density
    unweighed   INTEGER NOT NULL,      -- records without
    valid       REAL NOT NULL,         -- mm
    degraded    REAL NOT NULL,
    missing     REAL NOT NULL,
    moved       REAL NOT NULL,         -- mm³ and kg on the belt whose speed is known
    moved_kg    REAL NOT NULL,
    run_mm      REAL NOT NULL,         -- its length, and how long it took
    run_s       REAL NOT NULL,
    known       INTEGER NOT NULL,      -- records whose flow is known
    covered     REAL NOT NULL,         -- coverage × mm
    measured    REAL NOT NULL,         -- mm that coverage is of
    flow_low    REAL,                  -- m³/h
    flow_high   REAL
)"""

_FIRST = f"""
CREATE TABLE runs (
    run         INTEGER PRIMARY KEY,
    wall_ns     INTEGER NOT NULL
);
-- one row: where the ledger ends and, in state, what it adds up to (sums.py)
CREATE TABLE ledger (
    one         INTEGER PRIMARY KEY CHECK (one = 1),
    number      INTEGER NOT NULL,
    run         INTEGER NOT NULL,
    end_mm      REAL,
    shift_ns    INTEGER,                   -- from UTC's midnight to where days begin
    state       TEXT NOT NULL
);
INSERT INTO ledger VALUES (1, 0, 0, NULL, NULL, '');
CREATE TABLE records (
    number      INTEGER PRIMARY KEY,
    run         INTEGER NOT NULL,
    from_mm     REAL NOT NULL,
    to_mm       REAL NOT NULL CHECK (to_mm >= from_mm),
    standing    INTEGER NOT NULL CHECK (standing BETWEEN 0 AND 2),
    reason      TEXT NOT NULL,
    wall_ns     INTEGER NOT NULL,
    run_sigma   REAL,
    cameras     INTEGER NOT NULL,
    frame       TEXT,                      -- NULL: no strip
    time_ns     INTEGER,
    position    REAL,
    strip_from  REAL,
    strip_to    REAL,
    area        REAL,
    volume      REAL,
    sigma       REAL,
    speed       REAL,
    density     REAL,
    coverage    REAL,
    single      REAL,
    quality     INTEGER
);
CREATE TRIGGER contiguous BEFORE INSERT ON records
WHEN NEW.number <> (SELECT number + 1 FROM ledger)
    OR NEW.from_mm <> (SELECT coalesce(end_mm, NEW.from_mm) FROM ledger)
BEGIN
    SELECT RAISE(ABORT, 'the ledger must go on where it ended');
END;
CREATE TRIGGER goes_on AFTER INSERT ON records
BEGIN
    UPDATE ledger SET number = NEW.number, run = NEW.run, end_mm = NEW.to_mm;
END;
CREATE TABLE grids (
    grid        INTEGER PRIMARY KEY,
    x           BLOB NOT NULL UNIQUE       -- float32, mm
);
CREATE TABLE sections (
    number      INTEGER PRIMARY KEY,
    grid        INTEGER NOT NULL,
    height      BLOB NOT NULL
);
CREATE TABLE minutes {_SUMS};
CREATE TABLE hours {_SUMS};
CREATE TABLE events (
    event       INTEGER PRIMARY KEY AUTOINCREMENT,
    wall_ns     INTEGER NOT NULL,
    kind        TEXT NOT NULL,
    name        TEXT NOT NULL,
    text        TEXT NOT NULL,
    by          TEXT NOT NULL
);
CREATE INDEX events_wall ON events (wall_ns);
CREATE TABLE files (
    name        TEXT PRIMARY KEY,
    day         INTEGER NOT NULL,          -- since 1970
    first       INTEGER NOT NULL,          -- record numbers: all of that day from first to last
    last        INTEGER NOT NULL,
    since_ns    INTEGER NOT NULL,          -- wall clock of the earliest and of the latest
    until_ns    INTEGER NOT NULL,
    records     INTEGER NOT NULL,
    bytes       INTEGER NOT NULL,
    sha256      TEXT NOT NULL,
    summed      INTEGER NOT NULL,          -- up to which number its records are in the sums above
    pruned      INTEGER NOT NULL           -- some of its records are no longer in the table above
);
CREATE INDEX files_day ON files (day);
"""

_OFFSET = "ALTER TABLE records ADD COLUMN offset_mm REAL NOT NULL DEFAULT 0"

_FINDINGS = """
ALTER TABLE events ADD COLUMN parameters TEXT NOT NULL DEFAULT '';   -- JSON object; empty: none
CREATE TABLE checks (
    series      INTEGER PRIMARY KEY,
    name        TEXT NOT NULL,
    subject     TEXT NOT NULL,             -- camera; empty: the whole system
    unit        TEXT NOT NULL,
    UNIQUE (name, subject, unit)
);
CREATE TABLE findings (
    finding     INTEGER PRIMARY KEY AUTOINCREMENT,
    series      INTEGER NOT NULL,
    wall_ns     INTEGER NOT NULL,
    value       REAL,                      -- NULL: not measured
    sigma       REAL,
    bound       REAL,                      -- limit; NULL: none
    effect      INTEGER NOT NULL CHECK (effect BETWEEN 0 AND 2),
    text        TEXT NOT NULL              -- empty: no fault
);
CREATE INDEX findings_series ON findings (series, wall_ns);
CREATE TABLE finding_sums (
    series      INTEGER NOT NULL,
    bucket      INTEGER NOT NULL,          -- ten minutes of wall clock since 1970
    count       INTEGER NOT NULL,          -- findings with a value
    total       REAL NOT NULL,             -- of their values
    low         REAL,
    high        REAL,
    sigma       REAL NOT NULL,             -- sum of their σ where known
    sigmas      INTEGER NOT NULL,          -- number of these
    bound       REAL,                      -- greatest limit
    effect      INTEGER NOT NULL,          -- worst effect
    faults      INTEGER NOT NULL,
    PRIMARY KEY (series, bucket)
) WITHOUT ROWID;
CREATE TABLE finding_files (
    name        TEXT PRIMARY KEY,
    day         INTEGER NOT NULL,          -- since 1970
    last        INTEGER NOT NULL,          -- greatest number of a finding in it; 0: another database's
    bytes       INTEGER NOT NULL,
    pruned      INTEGER NOT NULL           -- its findings are (being) removed from the table above
)"""

_PRODUCTION = """
ALTER TABLE records ADD COLUMN product TEXT NOT NULL DEFAULT '';     -- empty: none
ALTER TABLE records ADD COLUMN batch INTEGER NOT NULL DEFAULT 0;     -- 0: none
ALTER TABLE records ADD COLUMN common_sigma REAL;                    -- NULL: not known
ALTER TABLE records ADD COLUMN density_sigma REAL;
CREATE TABLE product_changes (
    change      INTEGER PRIMARY KEY AUTOINCREMENT,
    wall_ns     INTEGER NOT NULL,
    product     TEXT NOT NULL,
    by          TEXT NOT NULL
);
CREATE TABLE batches (
    batch       INTEGER PRIMARY KEY,       -- greater than all before
    name        TEXT NOT NULL,
    started_ns  INTEGER NOT NULL,
    started_by  TEXT NOT NULL,
    ended_ns    INTEGER,                   -- NULL: open
    ended_by    TEXT NOT NULL DEFAULT ''
);
CREATE UNIQUE INDEX batches_open ON batches (ended_ns IS NULL) WHERE ended_ns IS NULL;
CREATE TABLE production_sums (
    minute      INTEGER NOT NULL,          -- of wall clock since 1970
    product     TEXT NOT NULL,
    batch       INTEGER NOT NULL,
    records     INTEGER NOT NULL,
    volume_mm3  REAL NOT NULL,
    variance_mm6 REAL NOT NULL,            -- of the strips' own errors
    common_mm3  REAL NOT NULL,             -- sum of the common parts of their sigma
    weighed_kg  REAL NOT NULL,
    unweighed   INTEGER NOT NULL,          -- records with a load of unknown density
    mass_variance_kg2 REAL NOT NULL,
    mass_common_kg REAL NOT NULL,
    density_common_kg REAL NOT NULL,
    valid_mm    REAL NOT NULL,
    degraded_mm REAL NOT NULL,
    missing_mm  REAL NOT NULL,
    PRIMARY KEY (minute, product, batch)
) WITHOUT ROWID;
CREATE INDEX production_batches ON production_sums (batch) WHERE batch > 0;
CREATE TABLE scale_readings (
    wall_ns     INTEGER PRIMARY KEY,
    kg          REAL NOT NULL,
    source      TEXT NOT NULL,
    by          TEXT NOT NULL
)"""

_PROVENANCE = (
    "ALTER TABLE runs ADD COLUMN provenance TEXT NOT NULL DEFAULT '{}'"  # JSON object; empty: not known
)

_PARTS = """
ALTER TABLE records ADD COLUMN edges_sigma REAL;                     -- parts of common_sigma, mm³; NULL: not known
ALTER TABLE records ADD COLUMN holes_sigma REAL;
ALTER TABLE records ADD COLUMN drift_sigma REAL;
ALTER TABLE records ADD COLUMN faults_sigma REAL;
ALTER TABLE production_sums ADD COLUMN edges_mm3 REAL NOT NULL DEFAULT 0;
ALTER TABLE production_sums ADD COLUMN holes_mm3 REAL NOT NULL DEFAULT 0;
ALTER TABLE production_sums ADD COLUMN drift_mm3 REAL NOT NULL DEFAULT 0;
ALTER TABLE production_sums ADD COLUMN faults_mm3 REAL NOT NULL DEFAULT 0;
ALTER TABLE production_sums ADD COLUMN unsplit_mm3 REAL NOT NULL DEFAULT 0;  -- of common_mm3: parts not known
UPDATE production_sums SET unsplit_mm3 = common_mm3"""

_SCALE = """
ALTER TABLE records ADD COLUMN scale_sigma REAL;                     -- mm³; NULL: not known, or among faults_sigma
ALTER TABLE production_sums ADD COLUMN scale_mm3 REAL NOT NULL DEFAULT 0"""

_DRIFT = """
CREATE TABLE rig_drift (
    estimate    INTEGER PRIMARY KEY AUTOINCREMENT,
    wall_ns     INTEGER NOT NULL,          -- of the last frame
    rig         TEXT NOT NULL,             -- SHA-256 of its rig.json
    document    TEXT NOT NULL              -- JSON object
);
CREATE INDEX rig_drift_rig ON rig_drift (rig, estimate)"""

MIGRATIONS: tuple[str, ...] = (
    _FIRST,
    _OFFSET,
    _FINDINGS,
    _PRODUCTION,
    _PROVENANCE,
    _PARTS,
    _SCALE,
    _DRIFT,
)
"""The script at index n migrates version n to n + 1; scripts are only added, never changed."""

COPIES = "before_update"
"""Folder beside a database of its copies from before a newer program changed its tables."""
BUSY_S = 10.0
"""Time to wait for another program that holds the database; a commit of a script takes less. Chosen."""
APPLICATION_ID = 0x62656C74
"""Identifies the program's files: "belt" in ASCII."""


def open_writer(path: Path) -> sqlite3.Connection:
    """Open the only writing connection and migrate the tables; sqlite3.DatabaseError if the file is damaged.

    Raises
    ------
    InputError
        When a newer version of the program wrote the file, or it is another program's.
    """
    connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=BUSY_S)
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA temp_store = MEMORY")
        connection.execute("PRAGMA cache_size = -16384")
        connection.execute("PRAGMA journal_size_limit = 16777216")
        _migrate(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


def open_reader(path: Path) -> sqlite3.Connection:
    """Open a read-only connection, which never blocks the writer."""
    connection = sqlite3.connect(
        f"{path.absolute().as_uri()}?mode=ro",
        uri=True,
        check_same_thread=False,
        isolation_level=None,
        timeout=BUSY_S,
    )
    connection.execute("PRAGMA query_only = ON")
    connection.execute("PRAGMA temp_store = MEMORY")
    return connection


def require_known(connection: sqlite3.Connection, path: Path) -> int:
    """Return the version of a history; InputError if it is too new, or another program's database."""
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if connection.execute("PRAGMA application_id").fetchone()[0] not in (0, APPLICATION_ID):
        raise InputError(f"{path}: another program's database; give beltscape a data folder of its own")
    if version > len(MIGRATIONS):
        raise InputError(
            f"{path}: its version is {version}, this program knows up to {len(MIGRATIONS)}; "
            f"install the version that wrote it{_describe_copies(path)}"
        )
    return version


def keep_copy(connection: sqlite3.Connection, path: Path, version: int) -> Path:
    """Copy a database before it is migrated, for a return to the program that wrote it; return the copy's path.

    Raises
    ------
    OutputError
        If it cannot be written; then nothing has changed.
    """
    target = path.parent / COPIES / f"{path.stem}.v{version}.db"
    part = target.with_suffix(".part")
    try:
        target.parent.mkdir(exist_ok=True)
        part.unlink(missing_ok=True)
        with closing(sqlite3.connect(part)) as copy:
            connection.backup(copy)
            copy.execute("PRAGMA journal_mode = DELETE")
        commit_file(part, target)
    except (OSError, sqlite3.Error) as error:
        part.unlink(missing_ok=True)
        if isinstance(error, sqlite3.Error) and is_damage(error):
            raise  # the history is repaired instead
        size = path.stat().st_size / 2**20
        raise OutputError(
            f"{target}: cannot be written ({error}); the update copies the history of {size:.0f} MiB first: free "
            "that much there"
        ) from error
    return target


def _describe_copies(path: Path) -> str:
    """Return how to return to this program by a copy from before the update; empty without a copy."""
    copies = [
        path.parent / COPIES / f"{path.stem}.v{version}.db" for version in range(len(MIGRATIONS), 0, -1)
    ]
    copy = next((one for one in copies if one.is_file()), None)
    return (
        "" if copy is None else f", or restore a backup of before the update ({copy} is the history of then)"
    )


def _migrate(connection: sqlite3.Connection, path: Path) -> None:
    version = require_known(connection, path)
    if 0 < version < len(MIGRATIONS):
        keep_copy(connection, path, version)
    for step in range(version, len(MIGRATIONS)):
        # a script is one transaction: a crash leaves the old version
        connection.executescript(
            f"BEGIN IMMEDIATE; {MIGRATIONS[step]}; PRAGMA application_id = {APPLICATION_ID}; "
            f"PRAGMA user_version = {step + 1}; COMMIT;"
        )


_IDLE = 8
"""Number of idle connections that are kept open: as many readers as a busy page has."""


def locate_suspect_marker(path: Path) -> Path:
    """Return the marker file that makes the next start check the whole database."""
    return path.with_name(f"{path.stem}.suspect")


class ReaderPool:
    """Lends connections to threads; no connection is used by two at once."""

    def __init__(self, path: Path) -> None:
        """Create the pool of the database at ``path``, which must exist when a connection is borrowed."""
        self._path = path
        self._lock = threading.Lock()
        self._idle: list[sqlite3.Connection] = []
        self._age = 0
        self._closed = False

    @contextmanager
    def borrow(self) -> Generator[sqlite3.Connection]:
        """Lend a connection with one consistent view of the data until the block ends.

        Raises
        ------
        InputError
            When the database cannot be read, or is closed.
        """
        with self._lock:
            if self._closed:
                raise InputError(f"{self._path}: the historian is closed")
            age, connection = self._age, self._idle.pop() if self._idle else None
        try:
            connection = open_reader(self._path) if connection is None else connection
            connection.execute("BEGIN")
            yield connection
            connection.execute("COMMIT")
        except sqlite3.Error as error:
            if is_damage(error):
                locate_suspect_marker(self._path).touch()
            raise InputError(f"{self._path}: not read: {describe_failure(self._path, error)}") from error
        finally:
            self._take_back(connection, age)

    def _take_back(self, connection: sqlite3.Connection | None, age: int) -> None:
        if connection is None:
            return
        with self._lock:
            if (
                not connection.in_transaction
                and age == self._age
                and len(self._idle) < _IDLE
                and not self._closed
            ):
                self._idle.append(connection)
                return
        connection.close()

    def reset(self) -> None:
        """Close the idle connections because the file was replaced."""
        with self._lock:
            self._age += 1
            idle, self._idle = self._idle, []
        for connection in idle:
            connection.close()

    def close(self) -> None:
        """Refuse new readers; present ones finish."""
        with self._lock:
            self._closed = True
        self.reset()
