"""Which column of a history file is what: time, channel, input, the number of a run, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from securestate import _checks as check
from securestate._tables import Table, nameless
from securestate._time_grid import offer, time_column_of
from securestate.errors import InputError, MeasurementError


@final
@dataclass(frozen=True)
class Parts:
    """Which columns are what, as far as the caller says."""

    inputs: tuple[str, ...]
    ignore: tuple[str, ...]
    channels: tuple[str, ...] | None
    segment_column: str | None
    time_column: str | None

    @classmethod
    def checked(
        cls, inputs: object, ignore: object, channels: object, segment_column: object, time_column: object
    ) -> Parts:
        """Refuse what are no names, and a name that stands for two things."""
        lists = {"inputs": inputs, "ignore": ignore, "channels": () if channels is None else channels}
        named = {
            argument: check.labels(argument, names, None, InputError) for argument, names in lists.items()
        }
        for argument, name in (("segment_column", segment_column), ("time_column", time_column)):
            named[argument] = () if name is None else (check.label(argument, name, InputError),)
        taken: dict[str, str] = {}
        for argument, names in named.items():
            check.distinct(argument, names, InputError)
            for name in names:
                if name in taken:
                    raise InputError(argument, f"other columns than {taken[name]}", repr(name))
                taken[name] = argument
        if channels is not None and not named["channels"]:
            raise InputError("channels", "at least one name, or None for every column left", "none")
        return cls(
            named["inputs"],
            named["ignore"],
            None if channels is None else named["channels"],
            next(iter(named["segment_column"]), None),
            next(iter(named["time_column"]), None),
        )

    @property
    def others(self) -> tuple[str, ...]:
        """Names that are neither a channel nor the time."""
        return (*self.inputs, *self.ignore, *(() if self.segment_column is None else (self.segment_column,)))

    @property
    def known(self) -> frozenset[str]:
        """All names that the caller gave."""
        return frozenset((*self.others, *(self.channels or ()), self.time_column or "time"))

    def clock(self, table: Table) -> str | None:
        """Return the name of the time column, None if there is none."""
        return time_column_of(table, (*self.others, *(self.channels or ())), self.time_column)

    def refuse_unknown(self, tables: Sequence[Table]) -> None:
        """Refuse names that are in no file, or for channels and inputs, not in every one."""
        for table in tables:
            missing = [name for name in (*(self.channels or ()), *self.inputs) if name not in table.columns]
            if missing:
                raise _lacking(table, missing)
        anywhere = {name for table in tables for name in table.columns}
        missing = [name for name in self.others if name not in anywhere]
        if missing:
            raise _lacking(tables[0], missing)


def _lacking(table: Table, names: Sequence[str]) -> MeasurementError:
    expected = f"a column for each of {', '.join(map(repr, names))}"
    return table.error(expected, offer(table, names))


def channels_of(tables: Sequence[Table], parts: Parts) -> tuple[str, ...]:
    """The channels, as named or every column that is left; the same in every file."""
    if parts.channels is not None:
        return parts.channels
    first = _left(tables[0], parts)
    if not first:
        raise tables[0].error("a column that is a channel", "time and named columns only")
    for table in tables[1:]:
        here = _left(table, parts)
        missing = [name for name in first if name not in here]
        if missing:
            raise _lacking(table, missing)
        more = [name for name in here if name not in first]
        if more:
            raise table.error(
                f"the columns of {tables[0].source}",
                f"{', '.join(map(repr, more))} too; ignore leaves it out",
            )
    return first


def _left(table: Table, parts: Parts) -> tuple[str, ...]:
    """Columns that may be channels; one without a name is none if it is empty."""
    unknown = [
        name for i, name in enumerate(table.columns) if name == nameless(i + 1) and name not in parts.others
    ]
    for name in unknown:
        if not table.absent(name).all():
            raise table.error("a name for every column, or ignore for one without", repr(name))
    return tuple(name for name in table.columns if name not in {*parts.others, *unknown, parts.clock(table)})
