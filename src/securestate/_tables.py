"""Named columns of a file, turned into numbers and times; a complaint names file, row, column and text."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from securestate.errors import MeasurementError

MISSING = ["", "nan", "na", "n/a", "null"]  # compared without case
NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
INFINITE = r"^[+-]?([iI][nN][fF]|[iI][nN][fF][iI][nN][iI][tT][yY])$"
ZONED = r"\d[T ]\d.*([Zz]|[+-]\d{2}(:?\d{2})?)$"

Values = Any  # a pyarrow ChunkedArray: pyarrow brings no types
Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of equal length.

    Attributes:
        source: the file's name, for messages.
        columns: Arrow arrays by name, in file order; text comes without blanks at its ends.
        rows: how many.
        unit, first: how messages count: in a text file lines from 2 (the header is line 1), else rows from 1.
    """

    source: str
    columns: dict[str, Values]
    rows: int
    unit: str = "row"
    first: int = 1

    def error(
        self, expected: str, received: str, *, row: int | None = None, column: str | None = None
    ) -> MeasurementError:
        """Return the exception about a cell, a row, a column or the whole file."""
        where = [self.source]
        where += [f"{self.unit} {row + self.first}"] if row is not None else []
        where += [f"column {column!r}"] if column is not None else []
        return MeasurementError(", ".join(where), expected, received)

    def numbers(self, name: str) -> NDArray[np.float64]:
        """Return a column as finite numbers, shape (rows,); NaN where a cell is missing.

        Raises:
            MeasurementError: a cell holds text or an infinite number.
        """
        values = self.columns[name]
        numbers = self._parse(name) if _is_text(values) else self._convert(name)
        self._refuse(np.isinf(numbers), name, "a finite number or an empty cell")
        return numbers

    def absent(self, name: str) -> Flags:
        """Return which cells of a column are missing, shape (rows,)."""
        values = self.columns[name]
        values = without_missing(values) if _is_text(values) else values
        return np.asarray(pc.is_null(values, nan_is_null=True), dtype=np.bool_)

    def times(self, name: str) -> NDArray[Any]:
        """Return a column as seconds (float64) or UTC instants (datetime64[ns]), shape (rows,).

        Raises:
            MeasurementError: a cell is missing, is no time, or mixes times with and without a zone.
        """
        values = self.columns[name]
        kind = values.type
        if pa.types.is_timestamp(kind) or pa.types.is_date(kind):
            return self._instants(name, values)
        if pa.types.is_duration(kind):
            return self._durations(name)
        if _is_text(values) and not _starts_with_number(values):
            return self._iso(name)
        seconds = self.numbers(name)
        self._refuse(np.isnan(seconds), name, "a time in every row")
        return seconds

    def _convert(self, name: str) -> NDArray[np.float64]:
        kind = self.columns[name].type
        families = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_null)
        if not any(family(kind) for family in families):
            raise self.error("numbers", str(kind), column=name)
        return _floats(self.columns[name])

    def _parse(self, name: str) -> NDArray[np.float64]:
        values = without_missing(self.columns[name])
        self._refuse(_matches(values, INFINITE), name, "a finite number or an empty cell")
        self._refuse(~(_matches(values, NUMBER) | _is_null(values)), name, "a number or an empty cell")
        return _floats(pc.replace_substring_regex(values, r"^\+", ""))

    def _iso(self, name: str) -> NDArray[Any]:
        values = without_missing(self.columns[name])
        self._refuse(_is_null(values), name, "a time in every row")
        zoned = _matches(values, ZONED)
        rest = "with" if zoned[0] else "without"
        self._refuse(zoned != zoned[0], name, f"a time {rest} a time zone, like the first")
        return self._instants(name, values, pa.timestamp("ns", "UTC") if zoned[0] else pa.timestamp("ns"))

    def _instants(self, name: str, values: Values, kind: Any = None) -> NDArray[Any]:
        self._refuse(_is_null(values), name, "a time in every row")
        kind = kind or pa.timestamp("ns", getattr(values.type, "tz", None))
        try:
            ticks = pc.cast(pc.cast(values, kind), pa.int64())
        except pa.ArrowInvalid:
            bad = np.array([not _castable(cell, kind) for cell in values])
            self._refuse(bad, name, "seconds, or an ISO 8601 time between the years 1678 and 2262")
            raise
        return ticks.to_numpy().astype("datetime64[ns]")  # type: ignore[no-any-return]

    def _durations(self, name: str) -> NDArray[np.float64]:
        values = self.columns[name]
        self._refuse(_is_null(values), name, "a time in every row")
        per_second = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[values.type.unit]
        return _floats(pc.cast(values, pa.int64())) / per_second

    def _refuse(self, bad: Flags, name: str, expected: str) -> None:
        if np.any(bad):
            row = int(np.argmax(bad))
            raise self.error(expected, quoted(self.columns[name][row].as_py()), row=row, column=name)


def quoted(cell: object) -> str:
    """Return what a cell holds in at most 60 printable characters."""
    text = "an empty cell" if cell is None or cell == "" else repr(cell)
    return text if len(text) <= 60 else text[:57] + "..."


def nameless(number: int) -> str:
    """Return what a column without a name is called; the first has the number 1."""
    return f"(column {number}: no name)"


def without_missing(values: Values) -> Values:
    """Return text with null in place of every spelling of a missing cell."""
    missing = pc.is_in(pc.utf8_lower(values), value_set=pa.array(MISSING, values.type))
    return pc.if_else(missing, pa.scalar(None, values.type), values)


def _is_text(values: Values) -> bool:
    return bool(pa.types.is_string(values.type) or pa.types.is_large_string(values.type))


def _starts_with_number(values: Values) -> bool:
    first = pc.drop_null(without_missing(values))[:1]
    return len(first) == 0 or bool(_matches(first, NUMBER)[0] or _matches(first, INFINITE)[0])


def _matches(values: Values, pattern: str) -> Flags:
    found = pc.fill_null(pc.match_substring_regex(values, pattern), False)
    return np.asarray(found, dtype=np.bool_)


def _is_null(values: Values) -> Flags:
    return np.asarray(pc.is_null(values), dtype=np.bool_)


def _floats(values: Values) -> NDArray[np.float64]:
    numbers = pc.cast(values, pa.float64(), safe=False)
    return np.array(numbers.to_numpy(), dtype=np.float64)


def _castable(cell: Any, kind: Any) -> bool:
    try:
        pc.cast(cell, kind)
    except pa.ArrowInvalid:
        return False
    return True
