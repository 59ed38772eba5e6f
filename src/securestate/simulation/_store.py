"""Where results of a comparison are kept: in memory, or in one file that survives an interruption."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from securestate.errors import InputError

#: Name of the file in the folder of a comparison.
FILE = "results.sqlite"
#: Written into the file: the layout of its table.
LAYOUT = 1


@dataclass(frozen=True)
class Kept:
    """One estimator on one group of runs; `cell` identifies scenario, estimator and code."""

    cell: str
    group: int
    runs: int
    scores: bytes
    refusal: str
    microseconds: float | None


class Store(Protocol):
    """Results by cell and group."""

    def get(self, cell: str) -> list[Kept]:
        """Everything kept of a cell, by group."""

    def put(self, results: Iterable[Kept]) -> None:
        """Keep results, all or none of them."""

    def close(self) -> None:
        """Let go of the file."""


class MemoryStore:
    """Results that live as long as this object."""

    def __init__(self) -> None:
        self._cells: dict[str, dict[int, Kept]] = {}

    def get(self, cell: str) -> list[Kept]:
        """See `Store`."""
        return [kept for _, kept in sorted(self._cells.get(cell, {}).items())]

    def put(self, results: Iterable[Kept]) -> None:
        """See `Store`."""
        for kept in results:
            self._cells.setdefault(kept.cell, {})[kept.group] = kept

    def close(self) -> None:
        """See `Store`."""


class FileStore:
    """Results in an SQLite file; each `put` is one transaction, which survives a crash or never happened."""

    def __init__(self, folder: Path) -> None:
        """Open the file in `folder`, or make it.

        Raises:
            InputError: it is not such a file, is damaged, or another comparison is writing to it.
        """
        self.path = folder / FILE
        try:
            self._db = sqlite3.connect(self.path, timeout=5.0, isolation_level=None)
            self._db.execute("PRAGMA locking_mode = EXCLUSIVE")
            self._db.execute("BEGIN IMMEDIATE")
            self._db.execute(
                "CREATE TABLE IF NOT EXISTS results (cell TEXT, grp INTEGER, runs INTEGER, scores BLOB, "
                "refusal TEXT, microseconds REAL, PRIMARY KEY (cell, grp)) WITHOUT ROWID"
            )
            (layout,) = self._db.execute("PRAGMA user_version").fetchone()
            if layout not in (0, LAYOUT):
                raise InputError("out", f"results of layout {LAYOUT}", f"layout {layout} in {self.path}")
            self._db.execute(f"PRAGMA user_version = {LAYOUT}")
            self._db.execute("COMMIT")
        except sqlite3.DatabaseError as error:
            busy = "locked" in str(error)
            expected = "no other comparison writing to it" if busy else "a folder with sound results, or none"
            raise InputError("out", expected, f"{self.path}: {error}") from None

    def get(self, cell: str) -> list[Kept]:
        """See `Store`."""
        rows = self._db.execute("SELECT * FROM results WHERE cell = ? ORDER BY grp", (cell,))
        return [Kept(*row) for row in rows]

    def put(self, results: Iterable[Kept]) -> None:
        """See `Store`."""
        rows = [(k.cell, k.group, k.runs, k.scores, k.refusal, k.microseconds) for k in results]
        self._db.execute("BEGIN IMMEDIATE")
        self._db.executemany("INSERT OR REPLACE INTO results VALUES (?, ?, ?, ?, ?, ?)", rows)
        self._db.execute("COMMIT")

    def close(self) -> None:
        """See `Store`."""
        self._db.close()
