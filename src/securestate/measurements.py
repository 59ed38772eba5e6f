"""Measurement files in, results out: columns matched to a plant by name, rows put on its time grid."""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from securestate._history_files import read_history
from securestate._readers import read_table
from securestate._results import write_run
from securestate._tables import Table
from securestate._time_grid import JITTER, filled, grid, offer, time_column_of
from securestate.plant import Plant

__all__ = ["JITTER", "Measurements", "read_history", "read_measurements", "write_run"]

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
    clock = time_column_of(table, (*channels, *inputs), time_column)
    absent = _absent(table, channels, inputs, allow_missing)
    time = None if clock is None else table.times(clock)
    index = np.arange(table.rows) if time is None else grid(table, clock, time, plant.dt)
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
        time=None if time is None else filled(time, index, plant.dt),
        extra=tuple(name for name in table.columns if name in unused),
        absent=absent,
        gaps=size - table.rows,
        held=held,
    )


def _absent(
    table: Table, channels: tuple[str, ...], inputs: tuple[str, ...], allowed: bool
) -> tuple[str, ...]:
    """Return the channels without a column; refuse those that are not allowed."""
    absent = tuple(name for name in channels if name not in table.columns)
    needed = [name for name in inputs if name not in table.columns]
    if absent and not allowed:
        needed = [*absent, *needed]
    if needed:
        raise table.error(f"a column for each of {', '.join(map(repr, needed))}", offer(table, needed))
    if channels and len(absent) == len(channels):
        raise table.error("a column for at least one channel of the plant", offer(table, absent))
    return absent


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
