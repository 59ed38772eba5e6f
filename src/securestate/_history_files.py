"""Files of attack-free history read into a `History`: rows on a grid, cut into segments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any, final

import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray

from securestate import _checks as check
from securestate._history_parts import Parts, channels_of
from securestate._readers import read_table
from securestate._tables import Table
from securestate._time_grid import JITTER, grid, seconds
from securestate.errors import InputError, MeasurementError
from securestate.identification.history import History

#: Samples without a row that become rows of NaN; after a longer gap a new segment begins, on a new grid.
LONGEST_GAP = 25

NO_CHANNEL = " (if it is no channel, name it in ignore, segment_column or time_column)"

Array = NDArray[np.float64]
Files = str | PathLike[str] | Sequence[str | PathLike[str]]


def read_history(
    path: Files,
    *,
    inputs: Sequence[str] = (),
    ignore: Sequence[str] = (),
    channels: Sequence[str] | None = None,
    segment_column: str | None = None,
    time_column: str | None = None,
    dt: float | None = None,
) -> History:
    r"""Read CSV, Parquet or NetCDF files of a record in which nobody lied, for `identify` or `judge`.

    Files look as in `read_measurements`, but no plant is known: every column that is neither the time nor
    named as something else is a channel. Sample times without a row become rows of NaN. A new segment begins
    with every file, where the value of the segment column changes, and after a gap of more than 25 samples.
    Inputs that miss more than three samples in a row end a segment too.

    Args:
        path: one file or several, each .csv, .tsv, .txt, .parquet, .pq, .nc or .nc4.
        inputs: columns that are inputs of the plant.
        ignore: columns that are none of it, such as remarks.
        channels: the channels, in this order; other columns are then not used. Default: every column that is
            left, in the order of the first file.
        segment_column: its value, number or text, tells runs apart; time may start again in each.
        time_column: exact name of the time column, if it is not "time": seconds or ISO 8601, increasing.
        dt: seconds between samples. Default: the usual time between rows; without a time column 1.
    Raises:
        MeasurementError: names the file, row and column, what was expected and what came.
        InputError: names given for two things at once, or no file.

    Examples:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     file = Path(folder, "history.csv")
        ...     _ = file.write_text("time,flow,level,valve\n0,1.5,20,0\n60,1.6,21,1\n180,1.4,19,1")
        ...     record = read_history(file, ignore=["valve"])
        >>> print(record.channel_names, record.dt, record.samples)
        ('flow', 'level') 60.0 4
    """
    return read_histories([path], inputs, ignore, channels, segment_column, time_column, dt)[0]


def read_histories(
    groups: Sequence[Files],
    inputs: Sequence[str] = (),
    ignore: Sequence[str] = (),
    channels: Sequence[str] | None = None,
    segment_column: str | None = None,
    time_column: str | None = None,
    dt: float | None = None,
) -> list[History]:
    """Read one `History` per group of files, all with the same columns and the same time between samples.

    A column to ignore and the segment column need not be in every file, but in one of all.
    """
    parts = Parts.checked(inputs, ignore, channels, segment_column, time_column)
    if dt is not None:
        dt = check.positive_number("dt", dt, InputError)
    files = [_listed(group) for group in groups]
    tables = [[read_table(file, parts.known) for file in group] for group in files]
    every = [table for group in tables for table in group]
    parts.refuse_unknown(every)
    names = channels_of(every, parts)
    logs = [[_Log.of(table, parts) for table in group] for group in tables]
    step = dt if dt is not None else _usual_step([log for group in logs for log in group])
    return [
        _history([log.segments(names, parts, step) for log in group], names, parts, step) for group in logs
    ]


@final
@dataclass(frozen=True, eq=False)
class _Log:
    """One file, with its time.

    Attributes:
        clock: name of the time column. time: of every row, None if there is none.
        runs: first row of every run, and the number of rows at the end.
    """

    table: Table
    clock: str | None
    time: NDArray[Any] | None
    runs: tuple[int, ...]

    @classmethod
    def of(cls, table: Table, parts: Parts) -> _Log:
        """Read the time, which increases within a run."""
        runs, clock = _runs(table, parts.segment_column), parts.clock(table)
        time = None if clock is None else table.times(clock)
        if time is not None:
            stays = time[1:] <= time[:-1]
            stays[np.array(runs[1:-1], dtype=np.int64) - 1] = False
            if stays.any():
                row = int(np.argmax(stays)) + 1
                expected = f"a time after {time[row - 1]}, or a segment column whose value changes here"
                raise table.error(expected, str(time[row]), row=row, column=clock)
        return cls(table, clock, time, runs)

    def steps(self) -> Iterator[Array]:
        """Seconds from row to row, of every run."""
        if self.time is not None:
            for start, stop in pairwise(self.runs):
                yield np.diff(seconds(self.time[start:stop]))

    def segments(self, channels: Sequence[str], parts: Parts, dt: float) -> list[tuple[Array, Array]]:
        """Measurements and inputs on the grid, one pair per segment."""
        y = _columns(self.table, channels, NO_CHANNEL if parts.channels is None else "")
        u = _columns(self.table, parts.inputs)
        pieces = []
        for start, stop in self._stretches(dt):
            index = self._index(start, stop, dt)
            pieces.append((_placed(y[start:stop], index), _placed(u[start:stop], index)))
        return pieces

    def _stretches(self, dt: float) -> Iterator[tuple[int, int]]:
        """First and last row, less one, of every stretch without a long gap."""
        for start, stop in pairwise(self.runs):
            edges = [start, stop]
            if self.time is not None:
                long = np.diff(seconds(self.time[start:stop])) > (LONGEST_GAP + 1 + JITTER) * dt
                edges[1:1] = (start + 1 + np.flatnonzero(long)).tolist()
            yield from pairwise(edges)

    def _index(self, start: int, stop: int, dt: float) -> NDArray[np.int64]:
        if self.time is None:
            return np.arange(stop - start)
        return grid(self.table, self.clock, self.time[start:stop], dt, first=start)


def _listed(group: Files) -> list[Path]:
    """The files, at least one."""
    files = [group] if isinstance(group, str | PathLike) else list(group)
    if not files:
        raise InputError("path", "a file, or a list of files", "none")
    return [Path(file) for file in files]


def _columns(table: Table, names: Sequence[str], hint: str = "") -> Array:
    """Columns of numbers, shape (rows, names)."""
    numbers = np.empty((table.rows, len(names)))
    for j, name in enumerate(names):
        try:
            numbers[:, j] = table.numbers(name)
        except MeasurementError as reason:
            raise MeasurementError(reason.argument, reason.expected + hint, reason.received) from None
    return numbers


def _placed(rows: Array, index: NDArray[np.int64]) -> Array:
    """Rows on the grid, NaN between them."""
    whole = np.full((int(index[-1]) + 1, rows.shape[1]), np.nan)
    whole[index] = rows
    return whole


def _runs(table: Table, column: str | None) -> tuple[int, ...]:
    """First row of every run of the same value, and the number of rows at the end."""
    if column is None or column not in table.columns:
        return (0, table.rows)
    absent = table.absent(column)
    if absent.any():
        raise table.error("a value in every row", "an empty cell", row=int(np.argmax(absent)), column=column)
    codes = np.asarray(pc.dictionary_encode(table.columns[column].combine_chunks()).indices)
    return (0, *(np.flatnonzero(np.diff(codes)) + 1).tolist(), table.rows)


def _usual_step(logs: Sequence[_Log]) -> float:
    """Seconds between samples: the median between rows, made more precise by the length of the record.

    It is rounded to six digits if no time moves by more than the grid allows.
    """
    timed = [log for log in logs if log.time is not None]
    if not timed:
        return 1.0
    steps = np.concatenate([step for log in timed for step in log.steps()] or [np.zeros(0)])
    if not len(steps):
        raise timed[0].table.error("at least two times, or dt given", "one", column=timed[0].clock)
    usual = float(np.sort(steps)[(len(steps) - 1) // 2])
    samples = np.rint(steps / usual)
    regular = (samples > 0) & (np.abs(steps / usual - samples) <= 3 * JITTER)
    steps, samples = steps[regular], samples[regular]
    precise = float(steps.sum() / samples.sum())
    short = float(f"{precise:.6g}")
    return short if abs(short - precise) * samples.sum() <= JITTER * precise else precise


def _history(
    segments: Sequence[list[tuple[Array, Array]]], channels: tuple[str, ...], parts: Parts, dt: float
) -> History:
    pairs = [pair for file in segments for pair in file]
    if not any(np.isfinite(u).all(axis=1).any() for _, u in pairs):
        raise MeasurementError("inputs", "a sample with all inputs", "none")
    return History.of(
        [y for y, _ in pairs],
        [u for _, u in pairs] if parts.inputs else None,
        dt=dt,
        channel_names=channels,
        input_names=parts.inputs or None,
    )
