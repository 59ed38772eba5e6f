"""A list of the channels of a plant: which sensor owns them, and in which unit they are."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import final

from securestate._readers import read_table
from securestate._tables import Table
from securestate.errors import MeasurementError

COLUMNS = ("channel", "sensor", "unit")


@final
@dataclass(frozen=True)
class Tags:
    """What a list of channels says.

    Attributes:
        channels: in the order of the list.
        sensors: channels by sensor; a channel without a sensor is one of its own.
        units: one per channel; may be empty.
    """

    channels: tuple[str, ...]
    sensors: dict[str, list[str]]
    units: tuple[str, ...]


def read_tags(path: str | PathLike[str]) -> Tags:
    """Read a list of channels: columns `channel` and, as far as known, `sensor` and `unit`; others are not
    used.

    Args:
        path: .csv, .tsv or .txt, .parquet.
    Raises:
        MeasurementError: names the file, row and column.
    """
    table = read_table(Path(path), frozenset(COLUMNS))
    if "channel" not in table.columns:
        raise table.error("a column 'channel'", f"{', '.join(table.columns)}")
    cells = {name: _texts(table, name) for name in COLUMNS}
    sensors: dict[str, list[str]] = {}
    for row, (channel, sensor) in enumerate(zip(cells["channel"], cells["sensor"], strict=True)):
        if not channel:
            raise table.error("the name of a channel", "an empty cell", row=row, column="channel")
        sensors.setdefault(sensor or channel, []).append(channel)
    repeated = [channel for channel in cells["channel"] if cells["channel"].count(channel) > 1]
    if repeated:
        raise MeasurementError(table.source, "every channel once", f"{repeated[0]!r} twice")
    return Tags(tuple(cells["channel"]), sensors, tuple(cells["unit"]))


def _texts(table: Table, name: str) -> list[str]:
    """A column as text; empty where nothing is said."""
    if name not in table.columns:
        return [""] * table.rows
    return ["" if cell is None else str(cell) for cell in table.columns[name].to_pylist()]
