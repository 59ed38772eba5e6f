"""The work of `securestate judge`, and how a verdict looks on the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table
from rich.text import Text

from securestate.cli import console
from securestate.cli.exits import Exit
from securestate.identification import Grade, Verdict, judge
from securestate.measurements import read_history
from securestate.plant import Plant

STYLES = {Grade.GOOD: "bold", Grade.USABLE: "bold", Grade.INADEQUATE: "bold red"}


def run_judgement(
    path: Path, data: Sequence[Path], segment_column: str | None, time_column: str | None, *, quiet: bool
) -> Exit:
    """Read plant and record, judge, print."""
    plant = Plant.load(path)
    record = read_history(
        data,
        channels=plant.channel_names,
        inputs=plant.input_names,
        segment_column=segment_column,
        time_column=time_column,
        dt=plant.dt,
    )
    with console.working("judging", quiet=quiet):
        verdict = judge(plant, record)
    if not quiet:
        print(f"{plant.name or path.name}, {console.record(record)}:")
        show_verdict(verdict)
    return verdict_exit(verdict)


def verdict_exit(verdict: Verdict) -> Exit:
    """4 if nothing should be judged by this model."""
    return Exit.DESIGN if verdict.grade is Grade.INADEQUATE else Exit.CLEAN


def show_verdict(verdict: Verdict, remarks: Sequence[str] = ()) -> None:
    """Print the verdict's sentences, remarks, and the evidence per sensor."""
    shown = console.output()
    first, *others = verdict.sentences()
    shown.print(Text(first, style=STYLES[verdict.grade]), soft_wrap=True)
    for line in (*others, *remarks):
        shown.print(line, soft_wrap=True)
    shown.print()
    shown.print(_evidence(verdict))


def _evidence(verdict: Verdict) -> Table:
    """One line per sensor, in the plant's order."""
    grid = console.table(
        "sensor",
        "can be\nchecked",
        "explained\nby others",
        "at\nleast",
        "errors ×\nclaimed",
        "repeat",
        "noise\nshare",
    )
    for sensor in verdict.sensors:
        grid.add_row(
            sensor.name,
            "yes" if sensor.verifiable else "no",
            _percent(sensor.explained),
            _percent(sensor.explained_least),
            _number(sensor.variance),
            _number(sensor.repeat),
            _percent(sensor.noise),
        )
    return grid


def _percent(share: float) -> str:
    """A share in percent; one below zero, a prediction worse than the mean, is none."""
    if math.isnan(share):
        return "-"
    return "100 %" if share == 1 else f"{min(max(100 * share, 0.0), 99.9):.1f} %"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{round(value, 2) + 0.0:.2f}"  # no minus before 0.00
