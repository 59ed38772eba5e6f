"""A record of the plant while nobody lied: what a plant is learned from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from securestate import _checks as check
from securestate.errors import InputError, MeasurementError, ShapeError
from securestate.identification.forms import Segment

Array = NDArray[np.float64]

#: Missing inputs in a row that keep the last known value.
HELD = 3

#: Larger readings are damage, and their squares would overflow.
HUGE = 1e100


@final
@dataclass(frozen=True, eq=False)
class History:
    """Segments of a record: each an unbroken row of samples, but readings may be missing.

    Attributes:
        segments: pairs of measurements (N, m), NaN where missing, and inputs (N, q), in engineering units.
        channel_names (m), units (m), input_names (q): text.
        dt: seconds between samples; None if not known.
        held: missing inputs that were given their last known value.
    """

    segments: tuple[Segment, ...]
    channel_names: tuple[str, ...]
    units: tuple[str, ...]
    input_names: tuple[str, ...]
    dt: float | None = None
    held: int = 0

    @classmethod
    def of(
        cls,
        y: object,
        u: object = None,
        *,
        dt: float | None = None,
        channel_names: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
    ) -> History:
        """Check arrays or tables and put them into segments.

        Args:
            y: measurements (N, m): an array, or a table with column names such as a DataFrame; or a list of
                these, one per segment. NaN is missing, infinite numbers are an error. Or a `History`, alone.
            u: inputs of the same samples, (N, q), in the same way; None: no inputs. Up to `HELD` missing
                inputs in a row keep the last known value; a longer gap ends a segment.
            dt: seconds between samples; None: not known.
            channel_names, input_names: default: those of the tables, else y1, y2, ... and u1, u2, ...
            units: one per channel; default: none.
        Raises:
            ShapeError: arrays that do not fit each other.
            MeasurementError: an infinite number, or no sample.
            InputError: something beside a `History`, which has its own.
        """
        if isinstance(y, History):
            beside = {"u": u, "dt": dt, "channel_names": channel_names, "units": units}
            for argument, value in {**beside, "input_names": input_names}.items():
                if value is not None:
                    raise InputError(
                        argument, "nothing beside a History, which has its own", type(value).__name__
                    )
            return y
        ys = _listed("y", y)
        channels = _names("channel_names", channel_names, ys, "y")
        us = [None] * len(ys) if u is None else _listed("u", u)
        if len(us) != len(ys):
            raise ShapeError("u", f"{len(ys)} segments, as y has", f"{len(us)}")
        inputs = () if u is None else _names("input_names", input_names, us, "u")
        segments: list[Segment] = []
        held = 0
        for i, (part, driven) in enumerate(zip(ys, us, strict=True)):
            at = f"[{i}]" if len(ys) > 1 else ""
            measured = _numbers(f"y{at}", part, len(channels))
            entered = (
                np.zeros((len(measured), 0)) if driven is None else _numbers(f"u{at}", driven, len(inputs))
            )
            if len(entered) != len(measured):
                raise ShapeError(f"u{at}", f"{len(measured)} samples, as y has", f"{len(entered)}")
            entered, filled = _held(entered)
            held += filled
            segments += _unbroken(measured, entered)
        if not segments:
            raise MeasurementError("y", "samples", "none")
        return cls(
            tuple(segments),
            channels,
            ("",) * len(channels)
            if units is None
            else check.labels("units", units, len(channels), InputError, empty=True),
            inputs,
            None if dt is None else check.positive_number("dt", dt, InputError),
            held,
        )

    def select(self, channels: Sequence[str], inputs: Sequence[str]) -> History:
        """The same samples with these channels and inputs only, in this order.

        Raises:
            InputError: one is not there.
        """
        rows = _positions("y", channels, self.channel_names)
        columns = _positions("u", inputs, self.input_names)
        return History(
            tuple((y[:, rows], u[:, columns]) for y, u in self.segments),
            tuple(channels),
            tuple(self.units[i] for i in rows),
            tuple(inputs),
            self.dt,
            self.held,
        )

    @property
    def samples(self) -> int:
        """Number of samples."""
        return sum(len(y) for y, _ in self.segments)

    @property
    def missing(self) -> float:
        """Share of readings that are missing."""
        absent = sum(int(np.isnan(y).sum()) for y, _ in self.segments)
        return absent / sum(y.size for y, _ in self.segments)


def numbered(letter: str, width: int) -> tuple[str, ...]:
    """Names of columns that have none: y1, y2, ..."""
    return tuple(f"{letter}{i + 1}" for i in range(width))


def _positions(argument: str, wanted: Sequence[str], names: Sequence[str]) -> list[int]:
    missing = [name for name in wanted if name not in names]
    if missing:
        raise InputError(argument, f"a column {missing[0]!r}", ", ".join(names) or "no column")
    return [names.index(name) for name in wanted]


def _listed(name: str, value: Any) -> list[Any]:
    """One table or array per segment."""
    if isinstance(value, (list, tuple)) and len(value) and np.ndim(value[0]) == 2:
        return list(value)
    if np.ndim(value) != 2:
        raise ShapeError(name, "shape (N, channels), or a list of such arrays", f"shape {np.shape(value)}")
    return [value]


def _names(argument: str, given: Sequence[str] | None, tables: Sequence[Any], letter: str) -> tuple[str, ...]:
    """Names of the columns, which must agree between segments."""
    columns = [tuple(map(str, table.columns)) for table in tables if hasattr(table, "columns")]
    for other in columns[1:]:
        if other != columns[0]:
            raise InputError(
                letter, f"the columns {', '.join(columns[0])} in every segment", ", ".join(other)
            )
    width = np.shape(tables[0])[1]
    if given is None:
        given = columns[0] if columns else numbered(letter, width)
    names = check.labels(argument, given, width, InputError)
    check.distinct(argument, names, InputError)
    return names


def _numbers(argument: str, value: Any, width: int) -> Array:
    table = value.to_numpy() if hasattr(value, "columns") else value
    try:
        numbers = np.array(table, dtype=np.float64)
    except (TypeError, ValueError) as reason:
        raise InputError(argument, "an array of real numbers", str(reason)) from None
    if numbers.ndim != 2 or numbers.shape[1] != width:
        raise ShapeError(argument, f"shape (N, {width})", f"shape {numbers.shape}")
    if np.any(np.abs(numbers) > HUGE):
        row, column = np.argwhere(np.abs(numbers) > HUGE)[0]
        expected = f"finite numbers up to {HUGE:g}, NaN where missing"
        raise MeasurementError(argument, expected, f"{numbers[row, column]} at [{row}, {column}]")
    return numbers


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Where flags are set: beginning and end of every run.

    Examples:
        >>> runs(np.array([True, True, False, True]))
        [(0, 2), (3, 4)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def _held(u: Array) -> tuple[Array, int]:
    """Inputs with short gaps filled by the last known value, and how many were missing there."""
    missing = np.isnan(u)
    if not missing.any():
        return u, 0
    filled = u.copy()
    for j in np.flatnonzero(missing.any(axis=0)):
        for start, stop in runs(missing[:, j]):
            if start > 0 and stop - start <= HELD:
                filled[start:stop, j] = filled[start - 1, j]
    return filled, int(missing.sum() - np.isnan(filled).sum())


def _unbroken(y: Array, u: Array) -> list[Segment]:
    """The stretches in which every input is known."""
    known = np.asarray(np.isfinite(u).all(axis=1))
    if known.all():
        return [(y, u)] if len(y) else []
    return [(y[a:b], u[a:b]) for a, b in runs(known)]
