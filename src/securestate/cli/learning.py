"""The work of `securestate identify`: read the history, learn a plant, write it, say what it is worth."""

from __future__ import annotations

import shlex
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from securestate._history_files import read_histories
from securestate._history_tags import Tags, read_tags
from securestate._results import check_folder
from securestate.cli import console
from securestate.cli.exits import Exit
from securestate.cli.judgement import show_verdict, verdict_exit
from securestate.errors import InputError, SecurestateWarning
from securestate.identification import Grade, History, Identified, identify


@dataclass(frozen=True, kw_only=True)
class Lesson:
    """What the user asked for."""

    history: Sequence[Path]
    out: Path
    inputs: Sequence[str]
    ignore: Sequence[str]
    channels: Sequence[str] | None
    tags: Path | None
    segment_column: str | None
    time_column: str | None
    dt: float | None
    order: int | Literal["auto"]
    held_out: Sequence[Path]
    feedthrough: bool
    name: str
    report: Path | None
    quiet: bool


def run_lesson(order: Lesson) -> Exit:
    """Do the whole job; nothing is written before all is computed."""
    _check(order)
    tags = None if order.tags is None else read_tags(order.tags)
    history, other = _read(order, tags)
    with _said_once(quiet=order.quiet) as said, console.stages(quiet=order.quiet) as progress:
        found = identify(
            history,
            order=order.order,
            held_out=other,
            feedthrough=order.feedthrough,
            sensors=None if tags is None else _sensors(tags, history),
            name=order.name,
            progress=progress,
        )
        said(found.remarks)
    with console.working("writing", quiet=order.quiet):
        written = list(_write(found, order))
    if not order.quiet:
        _show(found, order, history, written)
    if found.verdict.grade is Grade.INADEQUATE:
        print(f"{order.out} is written, but its model is inadequate: judge no sensor by it", file=sys.stderr)
    return verdict_exit(found.verdict)


def _check(order: Lesson) -> None:
    """Refuse places that cannot be written before anything is computed."""
    if order.out.suffix != ".toml":
        raise InputError("--out", "a file name ending in .toml", repr(str(order.out)))
    check_folder(order.out, "--out")
    if order.report is not None:
        if order.report.suffix.lower() not in (".html", ".htm"):
            raise InputError("--report", "a file name ending in .html", repr(str(order.report)))
        check_folder(order.report, "--report")


def _read(order: Lesson, tags: Tags | None) -> tuple[History, History | None]:
    """The history and, if there is one, the record for the verdict, with the same columns.

    A list of channels says which columns are channels, if no option does.
    """
    groups = [order.history, order.held_out] if order.held_out else [order.history]
    others = {*order.inputs, *order.ignore}
    listed = None if tags is None else [channel for channel in tags.channels if channel not in others]
    histories = read_histories(
        groups,
        inputs=order.inputs,
        ignore=order.ignore,
        channels=order.channels or listed,
        segment_column=order.segment_column,
        time_column=order.time_column,
        dt=order.dt,
    )
    found = [each if tags is None else _with_units(each, tags) for each in histories]
    return found[0], found[1] if order.held_out else None


def _with_units(history: History, tags: Tags) -> History:
    units = dict(zip(tags.channels, tags.units, strict=True))
    return replace(history, units=tuple(units.get(channel, "") for channel in history.channel_names))


def _sensors(tags: Tags, history: History) -> dict[str, list[str]]:
    """The sensors that own a channel of the history."""
    there = set(history.channel_names)
    kept = {sensor: [channel for channel in own if channel in there] for sensor, own in tags.sensors.items()}
    return {sensor: own for sensor, own in kept.items() if own}


@contextmanager
def _said_once(*, quiet: bool) -> Iterator[Callable[[Sequence[str]], None]]:
    """Keep warnings back until the function given gets the remarks that are printed anyway.

    What no remark says is warned of at the end; with `quiet` nothing is printed, so that all is.
    """
    printed: list[str] = []
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", SecurestateWarning)
        try:
            yield printed.extend
        finally:
            said = set() if quiet else {remark.rstrip(".") for remark in printed}
    for each in warned:
        if str(each.message).rstrip(".") not in said:
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)


def _write(found: Identified, order: Lesson) -> Iterator[str]:
    """Write the files; yields what to say about each."""
    found.plant.save(order.out)
    yield f"wrote {order.out}"
    if order.report is not None:
        from securestate.reporting import write_identification

        source = ", ".join(path.name for path in order.history)
        yield f"wrote {write_identification(found, order.report, source=source)}"


def _show(found: Identified, order: Lesson, history: History, written: Sequence[str]) -> None:
    """Print what was learned, what it is worth, the files written, and what to do next."""
    print(found.headline)
    print(f"History: {console.record(history)}.")
    show_verdict(found.verdict, found.remarks)
    print()
    for line in (*written, *_next(found, order)):
        print(line)


def _next(found: Identified, order: Lesson) -> Iterator[str]:
    """What to do with the plant."""
    plant = shlex.quote(str(order.out))
    if found.verdict.grade is Grade.INADEQUATE:
        return
    yield "Next:"
    yield f"  securestate analyse {plant} --tolerance 1e-3"
    yield f"  securestate estimate --plant {plant} --data NEW.csv --report report.html"
