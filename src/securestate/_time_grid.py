"""Which column is the time, and on which sample of an even grid every row of a file lies."""

import difflib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from securestate._tables import Table, quoted

JITTER = 0.01  # how far a time may lie off the grid, in sample times
LARGEST_GRID = 1_000_000  # rows; a file may fill in more only up to ten times its own

Array = NDArray[np.float64]


def time_column_of(table: Table, taken: Sequence[str], wanted: str | None) -> str | None:
    """Return the name of the time column, None if there is none."""
    if wanted is not None:
        if wanted not in table.columns:
            raise table.error(f"the time column {wanted!r}", offer(table, [wanted]))
        return wanted
    found = [name for name in table.columns if name.lower() == "time" and name not in taken]
    if len(found) > 1:
        raise table.error("one time column, or its name given", " and ".join(map(repr, found)))
    return found[0] if found else None


def offer(table: Table, wanted: Sequence[str]) -> str:
    """Say which columns there are and which of them may be meant."""
    columns = list(table.columns)
    shown = ", ".join(map(quoted, columns[:20])) + (", ..." if len(columns) > 20 else "")
    near = [f"{quoted(close)} for {name!r}" for name in wanted for close in _near(name, columns)]
    return f"columns {shown}" + (f" (perhaps {', '.join(near)})" if near else "")


def _near(name: str, columns: Sequence[str]) -> list[str]:
    lower = {column.lower(): column for column in columns}
    return [lower[match] for match in difflib.get_close_matches(name.lower(), lower, n=1)]


def seconds(time: NDArray[Any]) -> Array:
    """Return seconds since the first row, shape (T,)."""
    since = time - time[0]
    if since.dtype.kind == "m":
        return np.asarray(since.astype(np.int64) / 1e9, dtype=np.float64)
    return np.asarray(since, dtype=np.float64)


def grid(
    table: Table, clock: str | None, time: NDArray[Any], dt: float, *, first: int = 0
) -> NDArray[np.int64]:
    """Return the sample number of every row, shape (rows,), counted from the first.

    `first` is the table's row at which the times given begin.
    """
    later = time[1:] > time[:-1]
    if not np.all(later):
        row = int(np.argmin(later)) + 1
        raise table.error(f"a time after {time[row - 1]}", str(time[row]), row=first + row, column=clock)
    with np.errstate(over="ignore"):
        samples = seconds(time) / dt
    limit = max(LARGEST_GRID, 10 * table.rows)
    if not samples[-1] < limit:
        row = int(np.argmax(np.diff(samples))) + 1
        expected = f"times that span at most {limit} samples of {dt:g} s"
        raise table.error(expected, f"{time[row]} after {time[row - 1]}", row=first + row, column=clock)
    index = np.rint(samples)
    off = np.abs(samples - index)
    off[1:][np.diff(index) == 0] = 0.5  # two rows on one sample
    if np.any(off > JITTER):
        row = int(np.argmax(off))
        expected = f"the first time, {time[0]}, plus a multiple of {dt:g} s"
        received = f"{time[row]} ({seconds(time)[row]:.9g} s later)"
        raise table.error(expected, received, row=first + row, column=clock)
    return index.astype(np.int64)


def filled(time: NDArray[Any], index: NDArray[np.int64], dt: float) -> NDArray[Any]:
    """Return the time of every sample: the file's own, the grid's where the file has none."""
    since = np.arange(index[-1] + 1) * dt
    whole = time[0] + (np.rint(since * 1e9).astype("timedelta64[ns]") if time.dtype.kind == "M" else since)
    whole[index] = time
    return np.asarray(whole)
