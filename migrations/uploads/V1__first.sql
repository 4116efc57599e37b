-- The catalog of uploads in progress (DB/uploads/catalog.sqlite). Forward only: a released migration is never edited.

-- A row comes before its folder does, and goes after it: a folder without a row is a leftover.
CREATE TABLE upload (
    operation  TEXT PRIMARY KEY,       -- the caller's id
    header     BLOB NOT NULL,          -- the message UploadHeader that began it
    bytes      INTEGER NOT NULL,       -- room that its folder may take in the end
    touched_at INTEGER NOT NULL        -- seconds since 1970-01-01 UTC of the last sign of life
) WITHOUT ROWID;

-- Grids that were committed with a hash, so that the same delivery need not be sent again. May be lost.
CREATE TABLE delivered (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    grid   BLOB NOT NULL UNIQUE,       -- what the grid is and what its rows hash to, 32 bytes (docs/format.md)
    tile   BLOB NOT NULL               -- key of the tile that it became, 16 bytes
);
