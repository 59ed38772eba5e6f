"""CSV, Parquet and NetCDF files read into a `Table`; a damaged file is always a `MeasurementError`."""

import csv
import re
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as arrow_csv
import pyarrow.parquet as parquet

from securestate._tables import NUMBER, Table, Values, nameless, quoted
from securestate.errors import MeasurementError

TEXT_SUFFIXES = (".csv", ".tsv", ".txt")
PARQUET_SUFFIXES = (".parquet", ".pq")
NETCDF_SUFFIXES = (".nc", ".nc4")
SEPARATORS = (",", ";", "\t")

COMMA_NUMBER = r"^[+-]?\d*,\d+([eE][+-]?\d+)?$"
THOUSANDS = r"^[+-]?[1-9]\d{0,2},\d{3}$"  # 1,234: one thousand and more, or one and a bit?

Known = frozenset[str]


def read_table(path: Path, known: Known) -> Table:
    """Read a whole file; the suffix says what it is.

    Args:
        path: .csv, .tsv, .txt; .parquet, .pq; .nc, .nc4.
        known: names that the caller looks for; they tell the separator of a text file from its header.

    Raises:
        MeasurementError: no such file, unknown suffix, or the file is damaged.
    """
    reader = _reader(path)
    try:
        data = path.read_bytes()
    except OSError as reason:
        raise MeasurementError(path.name, "a readable file", reason.strerror or str(reason)) from None
    if not data.strip():
        raise MeasurementError(path.name, "a file of measurements", "an empty file")
    return reader(path, data, known)


def _reader(path: Path) -> Callable[[Path, bytes, Known], Table]:
    suffix = path.suffix.lower()
    if suffix in TEXT_SUFFIXES:
        return _read_text
    if suffix in PARQUET_SUFFIXES:
        return _read_parquet
    if suffix in NETCDF_SUFFIXES:
        return _read_netcdf
    known = ", ".join(TEXT_SUFFIXES + PARQUET_SUFFIXES + NETCDF_SUFFIXES)
    raise MeasurementError(path.name, f"a file name ending in one of {known}", suffix or "no suffix")


def _read_text(path: Path, data: bytes, known: Known) -> Table:
    head, body = _head_and_body(path.name, data)
    separator = _separator(head, known)
    names = _distinct(path.name, _cells(path.name, head, separator))
    if not body:
        raise MeasurementError(path.name, "at least one row of measurements", "only a header")
    columns = _parse_body(path.name, body, separator, len(names))
    if separator != ",":
        columns = _decimal_points(columns)
    return Table(path.name, dict(zip(names, columns, strict=True)), body.count(b"\n") + 1, "line", 2)


def _head_and_body(source: str, data: bytes) -> tuple[str, bytes]:
    """Split off the header line; the body comes with one newline between its lines and none at its end."""
    if b"\0" in data:
        raise MeasurementError(source, "UTF-8 text", "binary data or another encoding (zero bytes)")
    lines = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    try:
        lines.decode()
    except UnicodeDecodeError as reason:
        line = lines.count(b"\n", 0, reason.start) + 1
        raise MeasurementError(
            f"{source}, line {line}", "UTF-8 text", f"the byte {lines[reason.start]:#x}"
        ) from None
    head, _, body = lines.partition(b"\n")
    return head.decode(), body.rstrip(b"\n")


def _separator(head: str, known: Known) -> str:
    """Return the separator that finds most of the known names in the header, then most names."""

    def found(separator: str) -> tuple[int, int]:
        names = [name.strip().strip('"').strip() for name in head.split(separator)]
        return len(known.intersection(names)), len(names)

    return max(SEPARATORS, key=found)


def _cells(source: str, head: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([head], delimiter=separator, strict=True, skipinitialspace=True), [])
    except csv.Error as reason:
        raise MeasurementError(f"{source}, line 1", "names of columns", str(reason)) from None


def _distinct(source: str, names: list[str]) -> list[str]:
    """Return names without blanks at their ends; a column without a name is called by its number."""
    clean = [name.strip() or nameless(i + 1) for i, name in enumerate(names)]
    twice = sorted({name for name in clean if clean.count(name) > 1})
    if twice:
        raise MeasurementError(source, "columns with names that differ", f"{quoted(twice[0])} more than once")
    return clean


def _parse_body(source: str, body: bytes, separator: str, count: int) -> list[Values]:
    wrong: list[tuple[int, int]] = []

    def remember(row: Any) -> str:
        wrong.append((row.number, row.actual_columns))
        return "error"

    try:
        table = _arrow_text(body, separator, [str(i) for i in range(count)], remember)
    except (pa.ArrowException, ValueError) as reason:
        raise _ragged(source, count, wrong) or _damaged(source, "text in columns", reason) from None
    if table.num_rows != body.count(b"\n") + 1:
        raise MeasurementError(source, "one line per row", "a cell with a line break, or a quote left open")
    return [pc.utf8_trim_whitespace(column) for column in table.columns]


def _arrow_text(body: bytes, separator: str, names: list[str], on_wrong_row: Callable[[Any], str]) -> Any:
    return arrow_csv.read_csv(
        BytesIO(body),
        read_options=arrow_csv.ReadOptions(column_names=names, use_threads=False, block_size=1 << 24),
        parse_options=arrow_csv.ParseOptions(
            delimiter=separator, ignore_empty_lines=False, invalid_row_handler=on_wrong_row
        ),
        convert_options=arrow_csv.ConvertOptions(
            column_types={name: pa.string() for name in names}, strings_can_be_null=False
        ),
    )


def _ragged(source: str, count: int, wrong: list[tuple[int, int]]) -> MeasurementError | None:
    if not wrong:
        return None
    row, received = wrong[0]
    return MeasurementError(f"{source}, line {row + 1}", f"{count} cells as in the header", f"{received}")


def _decimal_points(columns: list[Values]) -> list[Values]:
    """Turn decimal commas into points where no other reading is possible.

    That is so if no number has a point and at least one, such as 0,5 or 12,25, cannot be thousands.
    """
    with_comma = any(_has_plain_comma(column) for column in columns)
    with_point = any(_any(_keep(column, r"\."), NUMBER) for column in columns)
    if not with_comma or with_point:
        return columns
    return [
        pc.replace_substring_regex(column, r"^([+-]?\d*),(\d+([eE][+-]?\d+)?)$", r"\1.\2")
        for column in columns
    ]


def _any(column: Values, pattern: str) -> bool:
    return bool(pc.any(pc.match_substring_regex(column, pattern)).as_py())


def _keep(column: Values, pattern: str) -> Values:
    return pc.filter(column, pc.match_substring_regex(column, pattern))


def _has_plain_comma(column: Values) -> bool:
    """Tell whether some number with a comma cannot be a count of thousands."""
    numbers = _keep(column, COMMA_NUMBER)
    return bool(pc.any(pc.invert(pc.match_substring_regex(numbers, THOUSANDS))).as_py())


def _read_parquet(path: Path, data: bytes, _: Known) -> Table:
    try:
        table = parquet.read_table(BytesIO(data))
        columns = [_plain(column) for column in table.columns]
    except Exception as reason:  # a damaged file raises anything
        raise _damaged(path.name, "a Parquet file", reason) from None
    names = _distinct(path.name, list(table.column_names))
    return _with_rows(Table(path.name, dict(zip(names, columns, strict=True)), table.num_rows))


def _plain(column: Values) -> Values:
    if pa.types.is_dictionary(column.type):
        column = pc.cast(column, column.type.value_type)
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        return pc.utf8_trim_whitespace(column)
    return column


def _read_netcdf(path: Path, data: bytes, _: Known) -> Table:
    from securestate._netcdf import columns_of  # xarray takes a second to import

    try:
        columns = columns_of(data)
        values = [_plain(pa.chunked_array([pa.array(column)])) for column in columns.values()]
    except Exception as reason:  # a damaged file raises anything
        raise _damaged(path.name, "a NetCDF file", reason) from None
    names = _distinct(path.name, list(columns))
    rows = len(values[0]) if values else 0
    return _with_rows(Table(path.name, dict(zip(names, values, strict=True)), rows))


def _with_rows(table: Table) -> Table:
    if not table.rows:
        raise table.error("at least one row of measurements", "no rows")
    return table


def _damaged(source: str, expected: str, reason: Exception) -> MeasurementError:
    text = re.sub(r"\s+", " ", str(reason)).strip() or type(reason).__name__
    return MeasurementError(source, expected, f"a file that cannot be read as such ({text[:160]})")
