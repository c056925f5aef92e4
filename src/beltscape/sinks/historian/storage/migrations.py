"""The scripts that create the tables of the history and migrate those of older versions."""

from __future__ import annotations

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

MIGRATIONS: tuple[str, ...] = (_FIRST, _OFFSET, _FINDINGS, _PRODUCTION, _PROVENANCE)
"""The script at index n migrates version n to n + 1; scripts are only added, never changed."""
