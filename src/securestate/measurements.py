"""Measurement files in, results out: columns matched to a plant by name, rows put on its time grid."""

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from securestate._readers import read_table
from securestate._results import write_run
from securestate._tables import Table, quoted
from securestate.plant import Plant

__all__ = ["JITTER", "Measurements", "read_measurements", "write_run"]

JITTER = 0.01  # how far a time may lie off the grid, in sample times
LARGEST_GRID = 1_000_000  # rows; a file may fill in more only up to ten times its own

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measurements:
    """What a file holds of a plant, one row per sample time.

    Attributes:
        y: measurements, shape (T, m), file units; NaN is missing.
        u: inputs, shape (T, p), file units; None for a plant without inputs.
        time: shape (T,), seconds (float64) or UTC instants (datetime64[ns]); None if the file has no time.
            A row of the file keeps its own time; an inserted row has the time of the grid.
        extra: columns of the file that were not used.
        absent: channels without a column; all NaN in y.
        gaps: samples inserted where the file has none; all NaN in y.
        held: samples whose inputs are the last known ones; 0 unless holding was asked for.
    """

    y: Array
    u: Array | None
    time: NDArray[Any] | None
    extra: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()
    gaps: int = 0
    held: int = 0


def read_measurements(
    path: str | PathLike[str],
    plant: Plant,
    *,
    time_column: str | None = None,
    allow_missing: bool = False,
    hold_inputs: bool = False,
) -> Measurements:
    """Read CSV, Parquet or NetCDF and put it on the plant's grid of sample times.

    Columns are matched to channels and inputs by exact name, blanks at the ends aside. Empty cells, NaN, NA,
    N/A and null are missing. A text file may be separated by commas, semicolons or tabs; with the latter two,
    decimal commas are read where no other reading is possible.

    Time is a column called "time" (in any case), in seconds or as ISO 8601; with a time zone it becomes UTC.
    It must increase, in multiples of `plant.dt` after the first row within 1 % of `plant.dt`; sample times
    without a row become rows of NaN. Without such a column the rows are consecutive samples, and
    `Measurements.time` is None.

    Args:
        path: .csv, .tsv, .txt, .parquet, .pq, .nc or .nc4.
        plant: names the channels and inputs, and gives the sample time in seconds.
        time_column: exact name of the time column, if it is not "time".
        allow_missing: let channels without a column be missing throughout, instead of an error.
        hold_inputs: let an input that is missing keep its last value, instead of an error. An estimate is
            wrong by what an unknown input did meanwhile, so this has to be asked for.

    Raises:
        MeasurementError: names the file, row and column, what was expected and what came.
    """
    channels, inputs = plant.channel_names, plant.input_names
    table = read_table(Path(path), frozenset((*channels, *inputs, time_column or "time")))
    clock = _clock(table, (*channels, *inputs), time_column)
    absent = _absent(table, channels, inputs, allow_missing)
    time = None if clock is None else table.times(clock)
    index = np.arange(table.rows) if time is None else _grid(table, clock, time, plant.dt)
    size = int(index[-1]) + 1
    y = np.full((size, len(channels)), np.nan)
    for j, name in enumerate(channels):
        if name not in absent:
            y[index, j] = table.numbers(name)
    u, held = _inputs(table, inputs, index, hold_inputs)
    unused = set(table.columns) - {*channels, *inputs, clock}
    return Measurements(
        y=y,
        u=u,
        time=None if time is None else _filled(time, index, plant.dt),
        extra=tuple(name for name in table.columns if name in unused),
        absent=absent,
        gaps=size - table.rows,
        held=held,
    )


def _clock(table: Table, taken: Sequence[str], wanted: str | None) -> str | None:
    """Return the name of the time column, None if there is none."""
    if wanted is not None:
        if wanted not in table.columns:
            raise table.error(f"the time column {wanted!r}", _offer(table, [wanted]))
        return wanted
    found = [name for name in table.columns if name.lower() == "time" and name not in taken]
    if len(found) > 1:
        raise table.error("one time column, or its name given", " and ".join(map(repr, found)))
    return found[0] if found else None


def _absent(
    table: Table, channels: tuple[str, ...], inputs: tuple[str, ...], allowed: bool
) -> tuple[str, ...]:
    """Return the channels without a column; refuse those that are not allowed."""
    absent = tuple(name for name in channels if name not in table.columns)
    needed = [name for name in inputs if name not in table.columns]
    if absent and not allowed:
        needed = [*absent, *needed]
    if needed:
        raise table.error(f"a column for each of {', '.join(map(repr, needed))}", _offer(table, needed))
    if channels and len(absent) == len(channels):
        raise table.error("a column for at least one channel of the plant", _offer(table, absent))
    return absent


def _offer(table: Table, wanted: Sequence[str]) -> str:
    """Say which columns there are and which of them may be meant."""
    columns = list(table.columns)
    shown = ", ".join(map(quoted, columns[:20])) + (", ..." if len(columns) > 20 else "")
    near = [f"{quoted(close)} for {name!r}" for name in wanted for close in _near(name, columns)]
    return f"columns {shown}" + (f" (perhaps {', '.join(near)})" if near else "")


def _near(name: str, columns: Sequence[str]) -> list[str]:
    lower = {column.lower(): column for column in columns}
    return [lower[match] for match in difflib.get_close_matches(name.lower(), lower, n=1)]


def _seconds(time: NDArray[Any]) -> Array:
    """Return seconds since the first row, shape (T,)."""
    since = time - time[0]
    if since.dtype.kind == "m":
        return np.asarray(since.astype(np.int64) / 1e9, dtype=np.float64)
    return np.asarray(since, dtype=np.float64)


def _grid(table: Table, clock: str | None, time: NDArray[Any], dt: float) -> NDArray[np.int64]:
    """Return the sample number of every row, shape (rows,), counted from the first."""
    later = time[1:] > time[:-1]
    if not np.all(later):
        row = int(np.argmin(later)) + 1
        raise table.error(f"a time after {time[row - 1]}", str(time[row]), row=row, column=clock)
    with np.errstate(over="ignore"):
        samples = _seconds(time) / dt
    limit = max(LARGEST_GRID, 10 * table.rows)
    if not samples[-1] < limit:
        row = int(np.argmax(np.diff(samples))) + 1
        expected = f"times that span at most {limit} samples of {dt:g} s"
        raise table.error(expected, f"{time[row]} after {time[row - 1]}", row=row, column=clock)
    index = np.rint(samples)
    off = np.abs(samples - index)
    off[1:][np.diff(index) == 0] = 0.5  # two rows on one sample
    if np.any(off > JITTER):
        row = int(np.argmax(off))
        expected = f"the first time, {time[0]}, plus a multiple of {dt:g} s"
        raise table.error(expected, f"{time[row]} ({_seconds(time)[row]:.9g} s later)", row=row, column=clock)
    return index.astype(np.int64)


def _filled(time: NDArray[Any], index: NDArray[np.int64], dt: float) -> NDArray[Any]:
    """Return the time of every sample: the file's own, the grid's where the file has none."""
    since = np.arange(index[-1] + 1) * dt
    whole = time[0] + (np.rint(since * 1e9).astype("timedelta64[ns]") if time.dtype.kind == "M" else since)
    whole[index] = time
    return np.asarray(whole)


def _inputs(
    table: Table, names: tuple[str, ...], index: NDArray[np.int64], hold: bool
) -> tuple[Array | None, int]:
    """Return the inputs on the grid and how many samples of them are held."""
    if not names:
        return None, 0
    given = np.column_stack([table.numbers(name) for name in names])
    _complete(table, names, given, hold)
    if not hold and np.any(np.diff(index) > 1):
        row = int(np.argmax(np.diff(index) > 1)) + 1
        expected = "no gap in time, because inputs are unknown in it (hold_inputs keeps the last ones)"
        raise table.error(
            expected, f"{index[row] - index[row - 1] - 1} samples without a row before it", row=row
        )
    u = np.full((int(index[-1]) + 1, len(names)), np.nan)
    u[index] = given
    missing = np.isnan(u)
    last = np.maximum.accumulate(np.where(missing, 0, np.arange(len(u))[:, None]), axis=0)
    return np.take_along_axis(u, last, axis=0), int(missing.any(axis=1).sum())


def _complete(table: Table, names: tuple[str, ...], given: Array, hold: bool) -> None:
    """Refuse a missing input, or with `hold` one that has no earlier value."""
    missing = np.isnan(given[:1] if hold else given)
    if np.any(missing):
        row, column = (int(i) for i in np.argwhere(missing)[0])
        expected = "an input in the first row" if hold else "an input (hold_inputs keeps the last one)"
        raise table.error(expected, "an empty cell", row=row, column=names[column])
