"""Where results of a comparison are kept: in memory, or in one file that survives an interruption."""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Protocol

from securestate.errors import InputError

#: Name of the file in the folder of a comparison.
FILE = "results.sqlite"
#: Written into the file: the layout of its table.
LAYOUT = 1
TABLE = (
    "CREATE TABLE IF NOT EXISTS results (cell TEXT, grp INTEGER, runs INTEGER, scores BLOB, refusal TEXT, "
    "microseconds REAL, checksum INTEGER, PRIMARY KEY (cell, grp, runs)) WITHOUT ROWID"
)
#: Seconds to wait for another process to let go of the file.
PATIENCE = 5.0
#: What is expected where SQLite complains, by a word of its complaint.
SOUND = "a folder with sound results, or without any"
COMPLAINTS = (
    ("locked", "no other comparison at work in this folder"),
    ("unable to open", "a folder that can be written"),
    ("readonly", "a folder that can be written"),
    ("full", "a disk with space left"),
    ("disk I/O", "a disk that can be read and written"),
)


@dataclass(frozen=True)
class Kept:
    """One estimator on one group of runs; `cell` identifies scenario, estimator and code.

    The last group of a scenario may have fewer runs than it has in a longer comparison; both are kept.
    """

    cell: str
    group: int
    runs: int
    scores: bytes
    refusal: str
    microseconds: float | None


class Store(Protocol):
    """Results by cell and group."""

    def get(self, cell: str) -> list[Kept]:
        """Everything kept of a cell, by group and its number of runs."""

    def put(self, results: Iterable[Kept]) -> None:
        """Keep results, all or none of them."""

    def close(self) -> None:
        """Let go of the file."""


class MemoryStore:
    """Results that live as long as this object."""

    def __init__(self) -> None:
        self._cells: dict[str, dict[tuple[int, int], Kept]] = {}

    def get(self, cell: str) -> list[Kept]:
        """See `Store`."""
        return [kept for _, kept in sorted(self._cells.get(cell, {}).items())]

    def put(self, results: Iterable[Kept]) -> None:
        """See `Store`."""
        for kept in results:
            self._cells.setdefault(kept.cell, {})[kept.group, kept.runs] = kept

    def close(self) -> None:
        """See `Store`."""


class FileStore:
    """Results in an SQLite file; each `put` is one transaction, which survives a crash or never happened.

    Every method raises `InputError` if the file is damaged or cannot be read or written.
    """

    def __init__(self, folder: Path) -> None:
        """Open the file in `folder`, or make it.

        Raises:
            InputError: it is not such a file, is damaged, or another comparison is writing to it.
        """
        self.path = folder / FILE
        with self._told():
            self._db = sqlite3.connect(self.path, timeout=PATIENCE, isolation_level=None)
        try:
            with self._told():
                self._prepare()
        except BaseException:
            self.close()
            raise

    def _prepare(self) -> None:
        """Lock the file until it is closed, and make the table in a new one."""
        self._db.execute("PRAGMA locking_mode = EXCLUSIVE")
        with self._transaction():
            (layout,) = self._db.execute("PRAGMA user_version").fetchone()
            (tables,) = self._db.execute("SELECT count(*) FROM sqlite_master").fetchone()
            if (layout, tables) != (0, 0) and layout != LAYOUT:
                raise InputError("out", f"results of layout {LAYOUT}", f"layout {layout} in {self.path}")
            self._db.execute(TABLE)
            self._db.execute(f"PRAGMA user_version = {LAYOUT}")

    def get(self, cell: str) -> list[Kept]:
        """See `Store`."""
        with self._told():
            rows = self._db.execute("SELECT * FROM results WHERE cell = ? ORDER BY grp, runs", (cell,))
            return [self._checked(Kept(*row), checksum) for *row, checksum in rows]

    def put(self, results: Iterable[Kept]) -> None:
        """See `Store`."""
        rows = [(*astuple(kept), _checksum(kept)) for kept in results]
        with self._told(), self._transaction():
            self._db.executemany("INSERT OR REPLACE INTO results VALUES (?, ?, ?, ?, ?, ?, ?)", rows)

    def close(self) -> None:
        """See `Store`."""
        self._db.close()

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """All of the block or nothing of it, whatever stops it."""
        with self._db:
            self._db.execute("BEGIN IMMEDIATE")
            yield

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Say in our words what SQLite complains about."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            expected = next((told for word, told in COMPLAINTS if word in str(error)), SOUND)
            raise InputError("out", expected, f"{self.path}: {error}") from None

    def _checked(self, kept: Kept, checksum: object) -> Kept:
        if checksum != _checksum(kept):
            raise InputError("out", SOUND, f"{self.path}: damaged")
        return kept


def _checksum(kept: Kept) -> int:
    return zlib.crc32(repr(astuple(kept)).encode())
