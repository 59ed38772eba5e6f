"""What the terminal shows: a progress bar on stderr, tables and sentences on stdout."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from securestate._words import count
from securestate.estimators import AUTO, Run
from securestate.identification import History
from securestate.reporting import Finding, SensorSummary, Summary
from securestate.reporting.clock import Clock
from securestate.reporting.telling import period, plain_signs, sentences, typical

WIDE = 120  # columns, where the output is no terminal


def output() -> Console:
    """Return the console on stdout: plain text if that is no terminal."""
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="replace")  # its encoding may lack a character of a name
    width = None if sys.stdout.isatty() else WIDE
    return Console(width=width, markup=False, highlight=False, emoji=False, soft_wrap=False)


@contextmanager
def progress(samples: int, *, quiet: bool) -> Iterator[Callable[[int], None]]:
    """Show a bar on stderr if that is a terminal; the function given takes the number of samples done."""
    with steps("estimating", "samples", quiet=quiet) as show:
        counted = 0

        def advance(done: int) -> None:
            nonlocal counted
            counted += done
            show(counted, samples)

        show(0, samples)
        yield advance


@contextmanager
def steps(verb: str, things: str, *, quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """Show a bar on stderr if that is a terminal; the function given takes how many are done, and of all."""
    console = Console(stderr=True)
    bar = Progress(
        TextColumn(verb),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(things),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=quiet or not console.is_terminal,
    )
    with bar:
        task = bar.add_task(verb, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def stages(*, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on stderr if that is a terminal; the function given takes a stage, steps done and of all.

    A stage of one step shows that something goes on.
    """
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[steps]}"),
        console=console,
        transient=True,
        disable=quiet or not console.is_terminal,
    )
    with bar:
        task, shown = bar.add_task("", total=None, steps=""), ""

        def show(stage: str, done: int, total: int) -> None:
            nonlocal task, shown
            if stage != shown:
                bar.remove_task(task)
                task, shown = bar.add_task(stage, total=None, steps=""), stage
            if total > 1:
                bar.update(task, completed=done, total=total, steps=f"{done}/{total}")

        yield show


@contextmanager
def working(verb: str, *, quiet: bool) -> Iterator[None]:
    """Show on stderr that something goes on, if that is a terminal."""
    console = Console(stderr=True)
    if quiet or not console.is_terminal:
        yield
        return
    with console.status(verb):
        yield


def record(history: History) -> str:
    """Say how large a record is."""
    parts = count(len(history.segments), "segment")
    gaps = f", {_share(history.missing)[:-1]} % of the readings missing" if history.missing else ""
    return f"{count(history.samples, 'sample')} in {parts}, one every {history.dt:g} s{gaps}"


def table(*headings: str) -> Table:
    """Return an empty table whose cells fold instead of losing text."""
    grid = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for heading in headings:
        grid.add_column(heading, overflow="fold")
    return grid


def show_summary(run: Run, summary: Summary, remarks: Sequence[str], written: Iterable[Path]) -> None:
    """Print who lies, how the method fared, what was done to the data, and the files written."""
    console, clock = output(), Clock.of(run)
    console.print(f"{summary.plant or 'Plant'}, {summary.estimator}, {summary.samples} samples, {clock.span}")
    console.print()
    console.print(_sensors(summary, clock))
    console.print()
    console.print(Text(summary.verdict, style="bold red" if summary.liars else "bold"))
    for sentence in sentences(summary.findings, clock):
        console.print(_hanging(plain_signs(sentence), console.width), soft_wrap=True)
    console.print()
    for line in [*([summary.caveat] if summary.caveat else []), *_method(summary, clock), *remarks]:
        console.print(line)
    for path in written:
        console.print(f"wrote {path}", soft_wrap=True)


def _hanging(sentence: str, width: int) -> str:
    """A sentence set in, its further lines deeper."""
    return textwrap.fill(
        sentence, width, initial_indent="  ", subsequent_indent="    ", break_long_words=False
    )


def _sensors(summary: Summary, clock: Clock) -> Table:
    complete = all(sensor.missing == 0 for sensor in summary.sensors)
    missing = () if complete else ("missing",)
    grid = table("sensor", "verdict", "suspected", *missing, "lies since", "estimated injection")
    found = list(dict.fromkeys(f.sensor for f in summary.findings.found))
    rank = {name: place for place, name in enumerate(found)}
    for sensor in sorted(summary.sensors, key=lambda s: (rank.get(s.name, len(rank)), -s.suspected)):
        findings = summary.findings.of(sensor.name)
        grid.add_row(
            _name(sensor),
            _verdict(sensor, findings),
            _share(sensor.suspected),
            *(() if complete else (_share(sensor.missing),)),
            clock.text(sensor.since.index) if sensor.since else "-",
            "\n".join(_injections(findings)) or "-",
            style="bold red" if sensor.lies else None,
        )
    return grid


def _name(sensor: SensorSummary) -> str:
    if sensor.protected:
        return f"{sensor.name} (protected)"
    return f"{sensor.name} (cannot be checked)" if sensor.uncheckable and sensor.first_alarm else sensor.name


def _verdict(sensor: SensorSummary, findings: Sequence[Finding]) -> str:
    if sensor.lies:
        blamed = [f for f in findings if f.lies]
        if not blamed:
            return "contradicts"
        return "LIES" if any(f.ongoing for f in blamed) else "LIED"
    if sensor.first_alarm:
        faint = any(f.verdict == "faint" for f in findings)
        return "faint alarms" if faint else "brief alarms" if findings else "isolated alarms"
    return "cannot be checked" if sensor.uncheckable else "-"


def _share(share: float) -> str:
    """Return a share in percent that shows neither a small one as none nor a large one as all."""
    if share in (0.0, 1.0):
        return f"{share:.0%}"
    return f"{min(max(100 * share, 0.1), 99.9):.1f}%"


def _injections(findings: Sequence[Finding]) -> Iterator[str]:
    """Yield what a sensor adds to each of its channels in its first finding, as far as that is known."""
    for course in findings[0].courses if findings else ():
        if course.known:
            name = f"{course.channel}: " if len(findings[0].courses) > 1 else ""
            yield plain_signs(f"{name}{typical(course)}")


def _method(summary: Summary, clock: Clock) -> Iterator[str]:
    """Say how the steps ended, when numbers did not mean what they say, and what the method cannot do."""
    counts = ", ".join(f"{status.name} {status.count}" for status in summary.statuses)
    yield f"Steps: {counts}."
    yield from (plain_signs(period(p, clock)) for p in summary.findings.periods)
    if summary.fast_path is not None:
        yield f"Fast path (the answer is the Kalman filter's): {_share(summary.fast_path)} of the samples."
    if summary.estimator == "KalmanFilter":
        yield f"--method {AUTO} looks for liars."
