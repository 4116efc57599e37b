-- The catalog of a terrain database. Forward only: a released migration is never edited.

-- Constants fixed when the database is created, as text.
CREATE TABLE constant (
    name  TEXT PRIMARY KEY,
    value TEXT NOT NULL
) WITHOUT ROWID;

-- Segment files that some version names. A file that is not here may be removed by the holder of the writer lock.
CREATE TABLE file (
    number INTEGER PRIMARY KEY,
    length INTEGER NOT NULL            -- bytes; checked before the file is opened
);

-- One row for each commit. A row is never changed.
CREATE TABLE version (
    number    INTEGER PRIMARY KEY,     -- 1, 2, 3, ...
    operation TEXT NOT NULL UNIQUE,    -- the caller's id of the operation
    made_at   INTEGER NOT NULL,        -- seconds since 1970-01-01 UTC
    action    TEXT NOT NULL,           -- what was done, in words
    root      BLOB NOT NULL            -- reference to the root page, 20 bytes (docs/format.md)
);

-- Which files a version reads, and how many of their bytes.
CREATE TABLE version_file (
    version INTEGER NOT NULL REFERENCES version (number),
    file    INTEGER NOT NULL REFERENCES file (number),
    live    INTEGER NOT NULL,
    PRIMARY KEY (version, file)
) WITHOUT ROWID;
CREATE INDEX version_file_by_file ON version_file (file);

-- Operations outlive their versions, so that a repeat is still recognised after prune.
CREATE TABLE operation (
    id      TEXT PRIMARY KEY,
    version INTEGER NOT NULL
) WITHOUT ROWID;

-- Highest numbers ever given, so that none is used twice.
CREATE TABLE counter (
    name  TEXT PRIMARY KEY,
    value INTEGER NOT NULL
) WITHOUT ROWID;
INSERT INTO counter VALUES ('file', 0), ('survey', 0), ('version', 0);
