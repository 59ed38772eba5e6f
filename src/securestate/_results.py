"""Results on disk, whole or not at all: a file appears, or replaces an older one, when it is complete."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as arrow_csv
import pyarrow.parquet as parquet
from numpy.typing import NDArray

from securestate._files import whole_file
from securestate.errors import InputError

if TYPE_CHECKING:
    from securestate.estimators import Run


def write_run(run: Run, path: str | PathLike[str]) -> None:
    """Write a run as CSV, Parquet or NetCDF; an existing file is replaced when the new one is complete.

    CSV and Parquet have the columns of `Run.to_pandas`: time, x.<state>, x_std.<state>, trust.<sensor>,
    suspected.<sensor>, attack.<channel>, attack_std.<channel>, innovation.<channel>,
    innovation_std.<channel>, status and the diagnostics; a batch begins with a column run. In CSV an unknown
    number is an empty cell, suspected is 0 or 1, and times are ISO 8601. NetCDF holds the labelled arrays of
    `Run.to_xarray`, covariance included.

    Args:
        path: .csv, .parquet or .nc in a folder that exists.

    Raises:
        InputError: unknown suffix, no such folder, or the place cannot be written.
    """
    check_result_path(path)
    write = _WRITERS[Path(path).suffix.lower()]
    try:
        with whole_file(Path(path)) as part:
            write(run, part)
    except OSError as reason:
        raise InputError("path", "a place that can be written", f"{str(path)!r} ({reason})") from None


def check_result_path(path: str | PathLike[str], argument: str = "path") -> None:
    """Refuse a name that `write_run` cannot write, before anything is computed."""
    if Path(path).suffix.lower() not in _WRITERS:
        raise InputError(argument, f"a file name ending in one of {', '.join(_WRITERS)}", repr(str(path)))
    check_folder(path, argument)


def check_folder(path: str | PathLike[str], argument: str) -> None:
    """Refuse a path whose folder does not exist or which is a folder itself."""
    place = Path(path)
    if place.is_dir():
        raise InputError(argument, "the name of a file", f"the folder {str(place)!r}")
    if not place.absolute().parent.is_dir():
        raise InputError(argument, "a file in a folder that exists", repr(str(place)))


def _columns(run: Run) -> Any:
    return pa.Table.from_pandas(run.to_pandas().reset_index(), preserve_index=False)


def _write_parquet(run: Run, path: Path) -> None:
    parquet.write_table(_columns(run), path)


def _write_csv(run: Run, path: Path) -> None:
    table = _columns(run)
    columns = [_plain(column) for column in table.columns]
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(table.column_names)
    with path.open("wb") as stream:
        stream.write(header.getvalue().encode())
        arrow_csv.write_csv(
            pa.table(columns, names=[str(i) for i in range(len(columns))]),
            stream,
            arrow_csv.WriteOptions(include_header=False, quoting_style="none"),
        )


def _plain(column: Any) -> Any:
    """Return a column as a spreadsheet can read it: booleans as 0 and 1, times as ISO 8601."""
    if pa.types.is_boolean(column.type):
        return column.cast(pa.uint8())
    if pa.types.is_timestamp(column.type):
        return pa.array(iso_times(column.to_numpy()))
    return column


def iso_times(time: NDArray[Any]) -> NDArray[np.str_]:
    """Return instants as text, all with the same number of decimals, as few as lose nothing."""
    ticks = time.astype("datetime64[ns]").astype(np.int64)
    units = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
    unit: Any = next(unit for unit, size in units.items() if not np.any(ticks % size))
    return np.datetime_as_string(time, unit=unit)


def _write_netcdf(run: Run, path: Path) -> None:
    run.to_xarray().to_netcdf(path, engine="h5netcdf")


_WRITERS: dict[str, Callable[[Run, Path], None]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".nc": _write_netcdf,
}
